"""Carrying out a shifted plan: what is measured moves the goal the right way, and bad measurements move nothing."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import CalmMotion, GoalShiftConfig
from leapgap.jumping.control.qp import NOT_FINITE
from leapgap.jumping.control.shifted_plan import QUANTITIES, ShiftedPlan
from leapgap.jumping.control.tracking import PhaseGains, Reference
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate
from tests.jumping.control.simple_models import unchanging

UPDATES, FLIGHT_S = 32, 0.4
TARGET = np.array([0.5, 0.0, 0.0])


class Flight:
    """Lands farther by what the trunk is faster than planned, times the length of the flight."""

    authority = np.tile(np.eye(3) / UPDATES, (UPDATES, 1, 1))
    authority_error = np.zeros((1, UPDATES, 3, 3))

    def planned_to(self, goal: np.ndarray) -> "Flight":
        return self

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        return goal

    @property
    def calm(self) -> CalmMotion:
        return unchanging(UPDATES, share=0.05)

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        return np.array([FLIGHT_S * since[3], 0.0, 0.0])


@pytest.fixture(scope="module")
def plan(robot: Robot, reference: Log) -> ShiftedPlan:
    planned = Reference.of(reference, robot)
    return ShiftedPlan(planned, {name: np.zeros((3, *getattr(planned, name).shape)) for name in QUANTITIES})


@pytest.fixture
def tracker(plan: ShiftedPlan, robot: Robot) -> ShiftTracker:
    return ShiftTracker(plan, robot, PhaseGains(), GoalShiftConfig(on_rear_feet=True), TARGET, 0.0, TARGET, Flight())


def follow(
    tracker: ShiftTracker,
    until_s: float,
    faster_m_s: float = 0.0,
    skip: range = range(0),
    blind: range = range(0),
    from_s: float = 0.2,
) -> None:
    """Send what a robot measures that follows the plan but for its forward velocity from some time on, tick by tick."""
    plan = tracker.reference
    for row in range(round(1000 * until_s) + 1):
        if row in skip:
            continue
        x, z, pitch, vx, vz, rate = plan.state[row]
        estimate = StateEstimate(
            time_s=row / 1000,
            base_position=np.array([x, 0, z]),
            base_quaternion=np.array([np.cos(pitch / 2), 0, np.sin(pitch / 2), 0]),
            base_velocity=np.array([vx + faster_m_s * (row >= 1000 * from_s), 0, vz]),
            base_angular_velocity=np.array([0, rate, 0]),
            joint_pos=plan.joint_pos[row],
            joint_vel=plan.joint_vel[row],
            foot_contact=np.ones(4, bool),
        )
        if row in blind:
            estimate = replace(estimate, base_velocity=np.full(3, np.nan))
        command = tracker.command(estimate)
        assert np.isfinite([*command.torque, *command.position, *command.velocity]).all()


def test_a_robot_that_is_suddenly_too_fast_is_sent_to_a_nearer_goal(tracker: ShiftTracker) -> None:
    follow(tracker, 0.6, faster_m_s=0.15)
    assert tracker.recorder.deviations[24, 3] == pytest.approx(0.15, abs=1e-6)
    assert (np.diff(tracker.shifts[:25, 0]) <= 1e-9).all()
    assert tracker.shifts[8, 0] == 0.0
    assert tracker.shifts[24, 0] < -0.02
    assert np.abs(tracker.shifts[:25, 1:]).max() < 1e-6
    assert not tracker.fallbacks


def test_on_the_plan_nothing_is_shifted(tracker: ShiftTracker) -> None:
    follow(tracker, 0.9)
    assert np.abs(tracker.shifts).max() == 0
    assert np.abs(tracker.recorder.deviations).max() < 1e-6


def test_what_cannot_be_measured_holds_the_shift_and_is_counted(tracker: ShiftTracker) -> None:
    follow(tracker, 0.5, faster_m_s=0.15, blind=range(290, 335))
    held = tracker.shifts[11]
    assert held[0] < 0
    assert np.array_equal(tracker.shifts[12], held) and np.array_equal(tracker.shifts[13], held)
    assert tracker.shifts[15, 0] < held[0]
    assert tracker.fallbacks == {NOT_FINITE: 2}
    assert [reason for _, reason in tracker.substituted] == [NOT_FINITE, NOT_FINITE]


def test_a_tick_that_was_missed_does_not_undo_the_shift(tracker: ShiftTracker) -> None:
    follow(tracker, 0.5, faster_m_s=0.15, skip=range(296, 335))
    assert (np.diff(tracker.shifts[:21, 0]) <= 1e-9).all()
    assert tracker.shifts[20, 0] < tracker.shifts[11, 0] < 0
