import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses, places
from leapgap.robot.model import DEFAULT_MODEL, Robot

KINDS = effects.known()


def test_places_of_joints_feet_and_the_whole(robot: Robot) -> None:
    at_joints, at_feet = places(KINDS["torque_gain"], robot), places(KINDS["foot_friction"], robot)
    assert next(iter(at_joints)) == "all" and len(at_joints["all"]) == 12
    assert at_joints["calf"] == tuple(j for j in robot.joints if j.endswith("calf"))
    assert at_joints["RR"] == ("RR_hip", "RR_thigh", "RR_calf")
    assert at_joints["RR_calf"] == ("RR_calf",)
    assert len(at_joints) == 1 + 2 + 3 + 4 + 12
    assert set(at_feet) == {"all", "front", "rear", *robot.feet}
    assert places(KINDS["payload"], robot) == {"all": ("all",)}


def test_every_parameter_of_an_effect_is_fitted_together(robot: Robot) -> None:
    h = Hypothesis(KINDS["com_offset"], robot)
    assert h.on("log", np.array([0.01, -0.02])) == effects.effect("com_offset", x_m=0.01, z_m=-0.02)
    assert h.nominal == pytest.approx([0, 0])


def test_an_effect_that_differs_by_log_takes_a_share_of_each_logs_clock(robot: Robot) -> None:
    (h,) = list_hypotheses(["sample_period"], robot, {"a": (1.1,), "b": (1.1, 1.3)})
    assert h.values("b", np.array([0.5])) == {"scale": pytest.approx(1.1)}
    assert h.on("a", h.nominal).is_nominal
    assert h.on("a", np.array([1.0])).profile == ()
    assert h.on("b", np.array([1.0])).profile == pytest.approx((1.1 / 1.2, 1.3 / 1.2))
    planned = h.on("a log that a proposed experiment will make", np.array([1.0]))
    assert planned.scale == pytest.approx(3.5 / 3) and planned.profile == ()
    (shared,) = list_hypotheses(["sample_period"], robot, None)
    assert shared.values("a", np.array([1.05])) == {"scale": 1.05}


def test_a_fit_at_its_bound_is_known_as_such(robot: Robot) -> None:
    gain, damping = (Hypothesis(KINDS[name], robot) for name in ("torque_gain", "joint_damping"))
    assert gain.at_bound(np.array([1.5])) and gain.at_bound(np.array([0.3]))
    assert not gain.at_bound(np.array([0.9]))
    assert not damping.at_bound(np.array([0.0]))  # absent is no bound
    assert damping.at_bound(np.array([4.0]))


def test_the_margin_of_a_bound_is_a_share_of_the_way_there_from_nominal(robot: Robot) -> None:
    """A range that reaches far to one side says nothing of the other: 2 % of 0.7 below 1, of 0.5 above."""
    gain = Hypothesis(KINDS["torque_gain"], robot)
    assert gain.at_bound(np.array([0.3 + 0.019 * 0.7])) and not gain.at_bound(np.array([0.3 + 0.021 * 0.7]))
    assert gain.at_bound(np.array([1.5 - 0.019 * 0.5])) and not gain.at_bound(np.array([1.5 - 0.021 * 0.5]))
    mass = Hypothesis(KINDS["payload"], robot)  # -4.24 to 6 kg
    assert mass.at_bound(np.array([-4.2])) and not mass.at_bound(np.array([-4.1]))


def test_a_joint_that_has_no_friction_left_is_an_answer(robot: Robot) -> None:
    for name, own in (("joint_friction", 0.2), ("joint_damping", 0.01), ("armature", 0.01)):
        h = Hypothesis(KINDS[name], robot)
        assert h.bounds[0] == pytest.approx([-own])
        assert not h.at_bound(h.bounds[0]) and h.at_bound(h.bounds[1])
        assert not h.at_bound(np.array([-0.99 * own]))


def test_numbers_of_a_hypothesis_are_those_of_its_robot(tmp_path) -> None:
    rough = tmp_path / "rough.xml"
    rough.write_text(DEFAULT_MODEL.read_text().replace('friction="0.8 0.02 0.01"', 'friction="1.0 0.02 0.01"'))
    h = Hypothesis(KINDS["foot_friction"], Robot.load(rough), "rear")
    assert h.nominal == pytest.approx([1.0]) and h.moderate == pytest.approx([-0.5])
    assert h.on("log", h.nominal).is_nominal_for(h.robot)
    assert h != Hypothesis(KINDS["foot_friction"], Robot.load(), "rear")
