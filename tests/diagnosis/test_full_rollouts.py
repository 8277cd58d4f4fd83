"""The search in whole jumps: what acts slowly is found beside a clock, and nothing where nothing else acts."""

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.closure import resamples
from leapgap.diagnosis.decision import Conclusion, conclude_from
from leapgap.diagnosis.full_rollouts import Errors, FullRollouts, FullRolloutSettings, Slopes
from leapgap.diagnosis.gap import HeldOutGap, candidate_squares
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis.test_gap import hardware

SLOW = effects.effect("sample_period", scale=1.07)
JUMPS = 4


def conclude_on_slow_clock(robot: Robot, reference: Log, *further: Effect) -> Conclusion:
    """Four jumps by a slow clock, which checks took for half as slow again."""
    judged = JudgedLogs.of(hardware(robot, reference, SLOW, *further, jumps=JUMPS), robot)
    clock = {jump.name: (1.105,) for jump in judged.logs}
    replayer, folds = Replayer(robot), np.arange(JUMPS)
    hypotheses = list_hypotheses(["sample_period", "com_offset", "joint_friction", "payload"], robot, clock)
    first = Candidate(hypotheses[:1], np.array([1.0]), np.eye(1), np.ones((JUMPS, 1)))
    nominal = candidate_squares(judged, replayer, [[()] * JUMPS])[0]
    draws = resamples(JUMPS, 200, np.random.default_rng(0))
    plan = FullRolloutSettings(most_causes=2)
    heldout_gap = HeldOutGap(judged, replayer, folds, nominal, np.full(JUMPS, 1.0), draws)
    return conclude_from(FullRollouts(heldout_gap, plan).search(first, hypotheses, 0.05))


@pytest.mark.long
def test_a_displaced_mass_is_found_beside_a_slow_clock(robot: Robot, reference: Log) -> None:
    conclusion = conclude_on_slow_clock(robot, reference, effects.effect("com_offset", x_m=0.03, z_m=0.03))
    assert (conclusion.verdict, conclusion.answer) == ("named", (("sample_period",), ("com_offset",)))
    (share,), offset = conclusion.steps[-1].split()
    assert share == pytest.approx(0.07 / 0.105, abs=0.1)
    assert offset == pytest.approx([0.03, 0.03], abs=0.01)
    assert conclusion.steps[-1].heldout.sum() < 0.2 * conclusion.steps[0].heldout.sum()


@pytest.mark.long
def test_nothing_is_added_to_a_clock_that_explains_all(robot: Robot, reference: Log) -> None:
    conclusion = conclude_on_slow_clock(robot, reference)
    assert conclusion.answer == (("sample_period",),)
    assert conclusion.steps[0].numbers == pytest.approx([0.07 / 0.105], abs=0.1)


def test_a_step_ends_at_the_least_squares_of_a_linear_law() -> None:
    rng = np.random.default_rng(0)
    by_number, true = rng.standard_normal((200, 2)), np.array([0.4, -0.7])
    slopes = Slopes(Errors(by_number @ -true, 0.0), by_number)
    assert slopes.step(0.0) == pytest.approx(true, abs=1e-6)
    assert slopes.step(0.0, np.arange(200) < 50) == pytest.approx(true, abs=1e-6)
    wrong = Slopes(slopes.errors, by_number + 0.5 * rng.standard_normal((200, 2)))
    updated = wrong.broyden_update(true, Errors(np.zeros(200), 0.0))
    assert updated.by_number @ true == pytest.approx(by_number @ true)


def test_only_effects_that_act_everywhere_and_are_not_there_yet_are_tried(robot: Robot, reference: Log) -> None:
    judged = JudgedLogs.of(hardware(robot, reference, jumps=2), robot)
    heldout_gap = HeldOutGap(judged, Replayer(robot), np.arange(2), np.ones(2), np.ones(2), np.zeros((1, 2), int))
    whole = FullRollouts(heldout_gap, FullRolloutSettings())
    hypotheses = list_hypotheses(["payload", "torque_gain"], robot, None)
    base = whole.fit((Hypothesis(effects.known()["payload"], robot),), np.array([0.0]))
    assert [tuple(h.name for h in sets) for sets, _ in whole.rank_extensions(base, hypotheses)] == [
        ("payload", "torque_gain")
    ]
