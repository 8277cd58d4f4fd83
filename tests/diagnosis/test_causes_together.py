"""Causes of one robot that act together at different joints, named from the fit of all effects; plain MuJoCo's logs."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFitSettings, Trial
from leapgap.diagnosis.joint_likelihood import Numbers
from leapgap.diagnosis.joint_search import SearchInParts
from leapgap.diagnosis.joint_sets import at_parts, merge_alike
from leapgap.diagnosis.settings import Settings
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import noisy_logs
from tests.diagnosis.test_best_simulator import KINDS, worn
from tests.diagnosis.two_link_arm import torque_driven_arm

pytestmark = pytest.mark.long

HIDDEN = {
    ("joint_damping", "all"): 0.2,
    ("joint_friction", "L_shoulder"): 0.1,
    ("joint_friction", "L_elbow"): 0.25,
    ("armature", "L_shoulder"): 0.01,
    ("armature", "L_elbow"): 0.03,
    ("link_mass", "L_elbow"): 1.15,
}
"""What ``worn`` hides, an effect that is the same at both joints once."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def found(robot: Robot) -> Diagnosis:
    settings = Settings(effects=KINDS, noise_draws=1, bootstrap_draws=100, best=False)
    return diagnose(noisy_logs(robot.path, worn), robot, settings, threads=2)


def test_causes_at_each_joint_are_named_with_their_numbers(found: Diagnosis) -> None:
    report = found.report
    values = {
        (cause.effect, cause.location): next(iter(cause.parameters.values())).value
        for cause in report.causes[: len(report.answer)]
    }
    assert set(values) == set(HIDDEN)
    for which, true in HIDDEN.items():
        assert values[which] == pytest.approx(true, rel=0.1), which
    assert report.verdict in ("named", "ambiguous")
    assert report.closure_of_answer is not None and report.closure_of_answer.value > 0.95


def test_parts_that_need_no_number_of_their_own_share_one(robot: Robot) -> None:
    """Two joints whose damping is equal within its error, and whose friction is not."""
    every = list_hypotheses(["joint_damping", "joint_friction"], robot, None)
    apart = at_parts(every)
    assert [(h.name, h.location) for h in apart] == [
        (name, joint) for name in ("joint_damping", "joint_friction") for joint in robot.joints
    ]
    numbers, spread = np.array([0.20, 0.23, 0.1, 0.3]), np.array([0.03, 0.01, 0.01, 0.01])
    fit = Candidate(apart, numbers, np.diag(spread**2), numbers[None])
    kept, merged = merge_alike(fit, every, 6.0)
    assert [(h.name, h.location) for h in kept] == [
        ("joint_damping", "all"),
        *(("joint_friction", joint) for joint in robot.joints),
    ]
    weights = 1 / spread[:2] ** 2
    assert merged == pytest.approx([weights @ numbers[:2] / weights.sum(), 0.1, 0.3])


def test_an_effect_stays_where_a_search_found_it_if_that_is_no_part() -> None:
    robot = Robot.load()
    every = list_hypotheses(["joint_damping", "joint_friction"], robot, None)
    leg = next(h for h in every if h.name == "joint_damping" and h.location == "FR")
    chosen = [(h.name, h.location) for h in at_parts(every, [leg])]
    assert chosen == [("joint_damping", "FR"), *(("joint_friction", group) for group in robot.joint_groups)]


def test_a_tool_at_a_link_is_named_beside_friction_elsewhere(robot: Robot, tmp_path: Path) -> None:
    """By default, with every effect: heavier links, their inertia and gains of motors together do nearly the same."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    tool = {"size": [0.005, 0, 0], "pos": [0.25, 0, 0], "mass": 0.3, "contype": 0, "conaffinity": 0}
    spec.body("lower").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, **tool)
    spec.joint("L_shoulder").frictionloss = 0.3
    spec.compile()
    (tmp_path / "with_tool.xml").write_text(spec.to_xml())
    logs = noisy_logs(tmp_path / "with_tool.xml", lambda model: None)
    report = diagnose(logs, robot, Settings(noise_draws=1, bootstrap_draws=100, best=False), threads=2).report
    assert report.verdict == "named"
    found = {(cause.effect, cause.location): cause.parameters for cause in report.causes[: len(report.answer)]}
    assert set(found) == {("link_payload", "L_elbow"), ("joint_friction", "L_shoulder")}
    payload, beyond_com_m = found["link_payload", "L_elbow"], 0.125
    assert payload["mass_kg"].value == pytest.approx(0.3, rel=0.05)
    assert payload["moment_kg_m"].value == pytest.approx(0.3 * beyond_com_m, rel=0.05)
    assert found["joint_friction", "L_shoulder"]["torque_nm"].value == pytest.approx(0.3, rel=0.05)


class FitsAtHand(SearchInParts):
    """A search whose fits of fewer effects are known beforehand, by the indices of those that stay."""

    def fit_part(self, fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
        return self.joint.fits[tuple(kept)]


@pytest.mark.parametrize(
    ("closure", "loss", "held", "sure", "stays"),
    [
        (0.87, 100.0, False, 1.0, False),  # closes nearly as much, and is nearly as likely
        (0.87, 160.0, False, 1.0, True),  # short pieces tell the effect, though whole logs hardly do
        (0.70, 100.0, False, 1.0, True),  # whole logs tell it
        (0.87, 125.0, True, 0.95, True),  # clearly likelier, and nearly all resamples of a held robot's logs say so
        (0.87, 125.0, True, 0.80, False),  # not so surely
        (0.87, 105.0, True, 0.95, False),  # not so clearly
        (0.87, 125.0, False, 0.95, False),  # whole logs of jumps part ways at a landing
    ],
)
def test_a_cause_stays_where_whole_logs_or_short_pieces_tell_it(
    robot: Robot, closure: float, loss: float, held: bool, sure: float, stays: bool
) -> None:
    """The nominal robot has a loss of 480, the fit of both effects 80, closing 88 %."""
    both = tuple(h for h in list_hypotheses(["joint_damping", "armature"], robot, None) if h.location == "all")

    def fit(some: Sequence[int], loss: float, closes: float) -> FullRolloutFit:
        numbers, size = np.full(len(some), 0.1), len(some)
        return FullRolloutFit(
            tuple(both[k] for k in some), numbers, np.eye(size), numbers[None], loss, np.array([closes])
        )

    gap = SimpleNamespace(
        squares=lambda fits: [one.heldout for one in fits],
        closure_value=lambda heldout: heldout[0],
        gap=lambda heldout: 1.0,
        floor=None,
        is_of_held_robot=held,
        share_better=lambda own, other: sure,
    )
    joint = SimpleNamespace(
        plan=JointFitSettings(),
        progress=lambda _: None,
        nominal_loss=480.0,
        judging=gap,
        closes=lambda one: one.heldout[0],
        fits={(0,): fit([0], loss, closure), (1,): fit([1], 300.0, 0.2)},
    )
    fewer = FitsAtHand(joint).with_one_less(fit([0, 1], 80.0, 0.88), none_gap=0.5)
    assert (fewer is None) == stays


@pytest.mark.parametrize("below_v", [17.0, 5.0])
def test_a_limit_that_nothing_meets_at_nominal_is_tried_over_its_range(below_v: float) -> None:
    """Logs that a supply below 17 V explains are found; below 5 V is out of the range, so that nothing is likelier."""
    a1 = Robot.load()
    limit, damping = (
        next(h for h in list_hypotheses([name], a1, None) if h.location == "all")
        for name in ("torque_speed_limit", "joint_damping")
    )
    about = Numbers.of((damping, limit), {})
    numbers, spread = np.array([1.1, limit.nominal[0]]), about.spread * [0.01, 1.0]

    def tried(_: Numbers, several: Sequence[np.ndarray], whole: bool) -> list[Trial]:
        assert whole
        return [Trial(one, [], 20.0 + abs(one[1] - 15) if one[1] < below_v else 100.0) for one in several]

    joint = SimpleNamespace(plan=JointFitSettings(), numbers=lambda _: about, tried=tried)
    fit = FullRolloutFit((damping, limit), numbers, np.diag(spread**2), numbers[None], 100.0, np.zeros(1))
    found = SearchInParts(joint).from_afar(fit)
    if below_v < limit.bounds[0][0]:
        assert found is None
    else:
        assert found is not None
        assert found[0] == 1.1
        assert found[1] == pytest.approx(15, abs=1)
