"""Fits to whole jumps: what acts slowly is found beside a clock."""

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.full_rollouts import Errors, FullRollouts, Slopes
from leapgap.diagnosis.gap import HeldOutGap, candidate_squares, resamples
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis.test_gap import hardware

SLOW = effects.effect("sample_period", scale=1.07)
JUMPS = 4


@pytest.mark.long
def test_a_displaced_mass_is_found_beside_a_slow_clock(robot: Robot, reference: Log) -> None:
    """Four jumps by a slow clock, which checks took for half as slow again."""
    further = effects.effect("com_offset", x_m=0.03, z_m=0.03)
    judged = JudgedLogs.of(hardware(robot, reference, SLOW, further, jumps=JUMPS), robot)
    clock = {jump.name: (1.105,) for jump in judged.logs}
    replayer, folds = Replayer(robot), np.arange(JUMPS)
    both = tuple(list_hypotheses(["sample_period", "com_offset"], robot, clock))
    nominal = candidate_squares(judged, replayer, [[()] * JUMPS])[0]
    draws = resamples(JUMPS, 200, np.random.default_rng(0))
    whole = FullRollouts(HeldOutGap(judged, replayer, folds, nominal, np.full(JUMPS, 1.0), draws))
    alone = whole.fit(both[:1], np.array([1.0]))
    fit = whole.fit(both, np.concatenate([alone.numbers, both[1].nominal]))
    (share,), offset = fit.split()
    assert share == pytest.approx(0.07 / 0.105, abs=0.1)
    assert offset == pytest.approx([0.03, 0.03], abs=0.01)
    assert fit.heldout.sum() < 0.2 * alone.heldout.sum()


def test_a_step_ends_at_the_least_squares_of_a_linear_law() -> None:
    rng = np.random.default_rng(0)
    by_number, true = rng.standard_normal((200, 2)), np.array([0.4, -0.7])
    slopes = Slopes(Errors(by_number @ -true, 0.0), by_number)
    assert slopes.step(0.0) == pytest.approx(true, abs=1e-6)
    assert slopes.step(0.0, np.arange(200) < 50) == pytest.approx(true, abs=1e-6)
    wrong = Slopes(slopes.errors, by_number + 0.5 * rng.standard_normal((200, 2)))
    updated = wrong.broyden_update(true, Errors(np.zeros(200), 0.0))
    assert updated.by_number @ true == pytest.approx(by_number @ true)
