import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import Hypothesis, hypotheses_of, places
from leapgap.robot.model import Robot

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
    (h,) = hypotheses_of(["sample_period"], robot, {"a": (1.1,), "b": (1.1, 1.3)})
    assert h.values("b", np.array([0.5])) == {"scale": pytest.approx(1.1)}
    assert h.on("a", h.nominal).is_nominal
    assert h.on("a", np.array([1.0])).profile == ()
    assert h.on("b", np.array([1.0])).profile == pytest.approx((1.1 / 1.2, 1.3 / 1.2))
    (shared,) = hypotheses_of(["sample_period"], robot, None)
    assert shared.values("a", np.array([1.05])) == {"scale": 1.05}


def test_a_fit_at_its_bound_is_known_as_such(robot: Robot) -> None:
    gain, damping = (Hypothesis(KINDS[name], robot) for name in ("torque_gain", "joint_damping"))
    assert gain.at_bound(np.array([1.5])) and gain.at_bound(np.array([0.3]))
    assert not gain.at_bound(np.array([0.9]))
    assert not damping.at_bound(np.array([0.0]))  # absent is no bound
    assert damping.at_bound(np.array([4.0]))
