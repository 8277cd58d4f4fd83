"""What follows from a stance that is measured late: the goal, and the way to the other plan."""

import numpy as np
import pytest

from leapgap.jumping.control.goal_shift_jump import LateStance, Transition, ground_pitch
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

GOALS = np.array([[0.5, 0.0, 0.0], [0.6, 0.02, 0.1], [0.8, 0.0, 0.0]])


def test_goals_are_linear_between_those_that_were_chosen_and_none_is_beyond_them() -> None:
    late = LateStance(np.array([-0.2, 0.0, 0.2]), GOALS)
    np.testing.assert_allclose(late.goal(-0.05), [0.575, 0.015, 0.075], atol=1e-12)
    np.testing.assert_allclose(late.goal(0.2), GOALS[2])
    assert late.goal(0.2001) is None and late.goal(-0.21) is None and late.goal(float("nan")) is None


def test_the_way_to_the_other_plan_begins_and_ends_without_a_jump_and_its_rate_is_that_of_the_way() -> None:
    change, shift = np.array([0.1, -0.02, 0.0, 0.05]), np.array([0.01, 0.02, -0.03])
    way = Transition(change, 0.05, 0.04)
    np.testing.assert_allclose(way.move(shift, 0.05), [0.01, 0.02, -0.03, 0.0])
    np.testing.assert_allclose(way.move(shift, 0.2), [0.11, 0.0, -0.03, 0.05])
    for time_s in (0.06, 0.088, 0.095):
        slope = (way.move(shift, time_s + 1e-6) - way.move(shift, time_s - 1e-6)) / 2e-6
        np.testing.assert_allclose(way.rate(np.zeros(3), time_s), slope, atol=1e-6)


def test_the_ground_is_measured_by_feet_and_attitude(robot: Robot) -> None:
    """A robot in one pose that leans by 0.1 rad stands on ground that does."""

    def standing(pitch: float) -> StateEstimate:
        return StateEstimate(
            time_s=0.0,
            base_position=np.array([0.0, 0.0, 0.3]),
            base_quaternion=np.array([np.cos(pitch / 2), 0, np.sin(pitch / 2), 0]),
            base_velocity=np.zeros(3),
            base_angular_velocity=np.zeros(3),
            joint_pos=np.tile([0.0, 0.9, -1.8], 4),
            joint_vel=np.zeros(12),
            foot_contact=np.ones(4, bool),
        )

    legs = LegKinematics(robot)
    level, leaning = (ground_pitch(standing(pitch), legs) for pitch in (0.0, 0.1))
    assert leaning - level == pytest.approx(0.1, abs=1e-9)
