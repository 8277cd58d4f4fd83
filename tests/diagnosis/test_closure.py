"""Shares of a gap, and of none."""

import numpy as np
import pytest

from leapgap.diagnosis.gap import closure, resamples
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.diagnosis.test_gap import hardware


@pytest.fixture(scope="module")
def judged(robot: Robot, reference: Log) -> JudgedLogs:
    return JudgedLogs.of(hardware(robot, reference, jumps=2), robot)


def test_half_of_what_is_above_the_floor(judged: JudgedLogs) -> None:
    draws = resamples(2, 50, np.random.default_rng(0))
    found = closure(np.full(2, 25.0), np.full(2, 9.0), np.full(2, 1.0), judged.value_counts, draws)
    assert found.value == pytest.approx(0.5, abs=0.02)  # jumps differ by a few rows
    assert found.low <= found.value <= found.high


def test_a_gap_at_its_floor_has_nothing_to_close(judged: JudgedLogs) -> None:
    draws = resamples(2, 50, np.random.default_rng(0))
    for nominal in (0.9, 1.0, 1.05):
        found = closure(np.full(2, nominal), np.full(2, 0.5), np.full(2, 1.0), judged.value_counts, draws)
        assert (found.value, found.low, found.high) == (0.0, 0.0, 0.0)
    assert closure(np.zeros(2), np.zeros(2), np.zeros(2), judged.value_counts, draws).value == 0.0
