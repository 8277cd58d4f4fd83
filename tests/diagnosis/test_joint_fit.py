"""All effects fitted together, and parts of other descriptions, on logs that plain MuJoCo simulated."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis import joint_likelihood
from leapgap.diagnosis.candidates import effects_on_logs
from leapgap.diagnosis.descriptions import judge_descriptions
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit, JointFitSettings
from leapgap.diagnosis.joint_likelihood import JointLikelihood, LogErrors
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.robot.model import DEFAULT_MODEL, Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.diagnosis.joint_fits import heldout_gap, noisy_logs, short_rollouts, worn
from tests.diagnosis.two_link_arm import torque_driven_arm
from tests.plain_simulation import Pd

KINDS = ["joint_damping", "joint_friction", "armature", "torque_gain", "command_delay", "encoder_bias"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, HeldOutGap, ShortRollouts]:
    robot = torque_driven_arm(tmp_path_factory.mktemp("arm"))
    gap = heldout_gap(noisy_logs(robot.path, worn), robot)
    return robot, gap, short_rollouts(gap, robot)


def test_three_causes_at_once_are_found_with_their_numbers(arm: tuple[Robot, HeldOutGap, ShortRollouts]) -> None:
    robot, gap, short = arm
    search = JointFit(gap, short, ())
    steps, probabilities = search.search(search.by_pieces(list_hypotheses(KINDS, robot, None)))
    fit = steps[-1]
    found = {name: float(number[0]) for name, number in zip(fit.names, fit.split(), strict=True)}
    assert set(found) == {"joint_damping", "joint_friction", "armature"}
    assert found["joint_damping"] == pytest.approx(0.25, rel=0.1)
    assert found["joint_friction"] == pytest.approx(0.3, rel=0.1)
    assert found["armature"] == pytest.approx(0.02, rel=0.1)
    assert gap.closure_value(fit.heldout) > 0.9
    closes = [gap.closure_value(squares) for squares in gap.squares(steps)]
    assert closes == sorted(closes)
    assert len(probabilities) == 3 and min(probabilities) > 0.9


def test_few_whole_replays_are_in_memory_at_once_and_their_errors_are_the_same(
    arm: tuple[Robot, HeldOutGap, ShortRollouts], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, gap, short = arm
    every = {h.name: h for h in list_hypotheses(["joint_damping"], robot, None) if h.location == "all"}
    sets = effects_on_logs((every["joint_damping"],), [np.array([0.1 * i]) for i in range(5)], gap.names)
    likelihood, logs = JointLikelihood(gap, short), range(4)
    together = likelihood.whole_errors(sets, logs)
    asked: list[int] = []
    original = Replayer.motions

    def counting(self: Replayer, trials: list[Rollout], rows: int | None = None) -> list[Motion]:
        asked.append(len(trials))
        return original(self, trials, rows)

    monkeypatch.setattr(Replayer, "motions", counting)
    monkeypatch.setattr(joint_likelihood, "LOGS_AT_ONCE", 8)
    few = likelihood.whole_errors(sets, logs)
    assert asked == [8, 8, 4]
    assert len(few) == 5 and all(len(of_set) == 4 for of_set in few)
    for one, other in zip(together, few, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(few[0][0], few[1][0])


def test_what_evidence_tells_is_held_and_stays(arm: tuple[Robot, HeldOutGap, ShortRollouts]) -> None:
    """The armature as some evidence has it, half as large as it is: others are fitted around it."""
    robot, gap, short = arm
    told = Evidence("a test", "armature.inertia", 0.01, 0.0005, "kg·m²", {}, "said here")
    plan = JointFitSettings(first_steps=2, all_steps=2, steps=2)
    search = JointFit(gap, short, (told,), plan)
    (*_, fit), _ = search.search(search.by_pieces(list_hypotheses(KINDS, robot, None)))
    at = fit.names.index("armature")
    assert fit.split()[at] == pytest.approx([0.01])
    assert (fit.fold_numbers[:, at] == 0.01).all()
    assert np.sqrt(fit.covariance[at, at]) == pytest.approx(0.0005)


def test_what_evidence_tells_wrongly_goes(arm: tuple[Robot, HeldOutGap, ShortRollouts]) -> None:
    """Encoders that are off by 0.05 rad would move the arm elsewhere than held-out logs say."""
    robot, gap, short = arm
    told = Evidence("a test", "encoder_bias.bias_rad", 0.05, 0.001, "rad", {}, "said here")
    search = JointFit(gap, short, (told,), JointFitSettings(first_steps=2, all_steps=2, steps=2))
    (*_, fit), _ = search.search(search.by_pieces(list_hypotheses(KINDS, robot, None)))
    assert set(fit.names) == {"joint_damping", "joint_friction", "armature"}


def test_the_slope_of_the_likelihood_is_its_derivative() -> None:
    """Finite differences of the loss of errors that answer linearly."""
    rng = np.random.default_rng(2)
    errors, slopes = (
        [LogErrors(rng.normal(size=(40, *of)), rng.normal(size=(5, 12, *of))) for _ in range(2)] for of in ((), (3,))
    )
    likelihood = JointLikelihood(SimpleNamespace(folds=np.arange(2)), SimpleNamespace())  # type: ignore[arg-type]

    def loss(departs: np.ndarray) -> float:
        pairs = zip(errors, slopes, strict=True)
        moved = [LogErrors(a.whole + b.whole @ departs, a.pieces + b.pieces @ departs) for a, b in pairs]
        return likelihood.loss(moved, departs)

    _, slope = likelihood.normal(errors, slopes, np.zeros(3))
    by = 1e-4 * np.eye(3)
    assert slope == pytest.approx([(loss(one) - loss(-one)) / 2e-4 for one in by], rel=0.02, abs=0.02)


def test_the_better_parts_of_another_description_are_found() -> None:
    """An A1 in the air with our lengths, but with joints and masses as the maker's file of 2020 has them.

    Its joint PD acts once a step, as the integrator of that file has it.
    """
    other = Robot.load(DEFAULT_MODEL.with_name("a1_2020.xml"))
    makers = mujoco.MjModel.from_xml_path(str(other.path))

    def joints_and_masses_of_2020(model: mujoco.MjModel) -> None:
        for name in ("dof_damping", "dof_frictionloss", "dof_armature"):
            getattr(model, name)[6:] = getattr(makers, name)[6:]
        for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
            getattr(model, name)[:] = getattr(makers, name)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    motions = [Pd(60, 2.0, 0.1), Pd(60, 2.0, 0.2), Pd(80, 2.0, 0.15), Pd(50, 1.5, 0.1)]
    logs = noisy_logs(DEFAULT_MODEL, joints_and_masses_of_2020, motions, rows=300, lift_m=5.0)
    mix, whole = judge_descriptions([other], heldout_gap(logs, Robot.load()))
    assert mix.robot == "masses, joints, simulation of a1_2020.xml"
    assert mix.closure.value > 0.98 and mix.gap < 0.9 * whole.gap
