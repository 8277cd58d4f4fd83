"""The exported controller measures a stance that was not seen before the jump as the one in Python does."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate
from tests.jumping.export.conftest import GOAL, STANCE, RecordedJump, new_tracker, run_program
from tests.jumping.export.test_export import CLOSE, python_commands

RISE_RAD = np.arctan2(0.05 - 0.02, 0.366)
"""Of the ground from the rear to the front feet, which are 0.366 m apart in the crouch of the A1."""


def test_the_jump_is_one_that_tests_something(late_jump: RecordedJump) -> None:
    """The ground that the feet stand on is found, the goal follows, and it is shifted by centimetres after a kick."""
    tracker = late_jump.tracker
    assert tracker.stance_pitch == pytest.approx(-RISE_RAD, abs=0.01)
    assert tracker.goal[0] > GOAL[0] + 0.03
    assert np.abs(tracker.shifts[:, 0]).max() > 0.02
    assert not tracker.fallbacks


def test_c_sends_the_commands_of_python(late_jump: RecordedJump, late_program: Path) -> None:
    commands = run_program(late_program, late_jump.estimates)
    np.testing.assert_allclose(commands, late_jump.commands, rtol=0, atol=CLOSE)


def leaning(estimates: Sequence[StateEstimate], pitch: float) -> list[StateEstimate]:
    """The same jump of a robot whose trunk leans in the first 50 ms, and the ground as measured with it."""
    half = np.array([np.cos(pitch / 2), 0, np.sin(pitch / 2), 0])
    return [replace(tick, base_quaternion=half) if i < 50 else tick for i, tick in enumerate(estimates)]


@pytest.mark.parametrize("pitch", [-0.25, -0.18, -0.1, 0.03, 0.15, 0.4])
def test_any_stance_gets_the_commands_of_python(
    late_jump: RecordedJump, robot: Robot, late_program: Path, pitch: float
) -> None:
    """Stances between those that were planned for, and two that are not believed."""
    ticks, tracker = leaning(late_jump.estimates[:820], pitch), new_tracker(robot, late=True)
    expected = python_commands(tracker, ticks)
    assert (tracker.stance_pitch == STANCE) == (pitch in (-0.25, 0.4))
    np.testing.assert_allclose(run_program(late_program, ticks), expected, rtol=0, atol=CLOSE)


def test_a_stance_that_was_not_measured_is_the_expected_one(
    late_jump: RecordedJump, robot: Robot, late_program: Path
) -> None:
    """No joints were measured in the first 50 ms, or only some; and some ticks of a jump did not come."""
    nan = np.full(12, np.nan)
    for blind, known in ((range(50), False), (range(5, 30), True)):
        ticks = [replace(t, joint_pos=nan) if i in blind else t for i, t in enumerate(late_jump.estimates[:400])]
        ticks = ticks[:45] + ticks[58:]
        tracker = new_tracker(robot, late=True)
        expected = python_commands(tracker, ticks)
        assert (tracker.stance_pitch != STANCE) == known
        np.testing.assert_allclose(run_program(late_program, ticks), expected, rtol=0, atol=CLOSE)


def test_the_folder_says_that_it_measures_the_stance(late_folder: Path) -> None:
    about = json.loads((late_folder / "controller.json").read_text())
    assert about["stance_is_measured"] and about["numbers"]["MEASURED_UNTIL_S"] == 0.049
