"""A stance that could not be measured before the jump is measured at its beginning, while all feet stand."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS, JumpPlanner
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump, GoalShiftMethod
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.experiments.rig import Bench
from leapgap.jumping.experiments.trial import TrialOutcome, attempt_task
from leapgap.jumping.models.planar import planar_robot
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.sensors import SensorNoise

BLOCK = JumpTask("block", 0.5, block_m=(0.05, 0.05))
FEET_APART_M = 0.366
"""Of the front from the rear feet in the crouch of the A1."""


def outcome(bench: Bench, task: JumpTask) -> TrialOutcome:
    planner = JumpPlanner(planar_robot(bench.robot), limits=AIMING_LIMITS)
    method = GoalShiftMethod(bench.robot, bench.references, planner=planner)
    world = replace(bench.world, sensing=Sensing(SensorNoise(0, 0, 0, 0, 0, 0), base_delay_s=0.0))
    return attempt_task(task, method, bench.level, (), world, np.random.default_rng(0))


@pytest.mark.long
def test_it_lands_where_a_jump_does_whose_stance_was_seen(bench: Bench) -> None:
    """Five centimetres under the front feet move the landing by more than ten where a plan takes them for level."""
    seen, late = (outcome(bench, replace(BLOCK, stance_is_seen=is_seen)) for is_seen in (True, False))
    assert late.landings[0].success
    assert late.landings[0].error_cm == pytest.approx(seen.landings[0].error_cm, abs=3.0)
    (jump,) = late.controllers
    assert isinstance(jump, GoalShiftJump) and not jump.fallbacks
    assert jump.stance_pitch == pytest.approx(-np.arctan2(0.05, FEET_APART_M), abs=0.01)


def test_set_points_do_not_jump_on_the_way_to_the_other_plan(bench: Bench) -> None:
    late = outcome(bench, replace(BLOCK, stance_is_seen=False))
    log, (first,) = late.run.log, late.starts
    position = log.per_joint("cmd_pos", bench.robot.joints)[first : first + 300]
    velocity = log.per_joint("cmd_vel", bench.robot.joints)[first : first + 300]
    step = np.abs(np.diff(position, axis=0)).max()
    assert step < 0.006, step
    # Velocities sent are those of the positions sent, on the way to the other plan as well.
    apart = np.abs(np.diff(position, axis=0) / 0.001 - velocity[:-1])
    assert np.median(apart) < 0.05
    assert np.abs(position[150] - position[50]).max() > 0.01


def test_level_ground_that_was_not_seen_changes_nothing(bench: Bench) -> None:
    level = replace(BLOCK, block_m=(0.0, 0.0))
    seen, late = (outcome(bench, replace(level, stance_is_seen=is_seen)) for is_seen in (True, False))
    assert late.landings[0].error_cm == pytest.approx(seen.landings[0].error_cm, abs=0.5)
