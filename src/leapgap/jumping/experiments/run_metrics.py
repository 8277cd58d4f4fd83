"""What a run demanded of joints, motors and ground, from the true motion and forces of the simulation."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects.drive import resistance_of
from leapgap.jumping.task import schedule_of
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, per_pair
from leapgap.logs.state import commanded_torque
from leapgap.robot.model import Robot
from leapgap.simulation.closed_loop import ClosedLoopRun

LEAST_PUSH_N = 20.0
"""A pair of feet pushes if its vertical force is larger; below, the ratio of two small forces means nothing."""
SUPPLY_V = 21.5
"""Limit of |R τ + q̇| at the joint, V, by the motors' data sheet."""
IMPULSE_S = 0.005
"""Ground forces are averaged over this time, because single steps of a simulated contact chatter."""


@dataclass(frozen=True)
class RunMetrics:
    """Figures over the rows from the start of the first jump to its take-off, over both pairs and all joints."""

    friction: float
    """Largest |F_x| / F_z of a pair's ground force while it pushes, 1."""
    force_n: float
    """Largest F_z of a pair, N."""
    tracking_rad: float
    """Root mean square of set point − joint angle, rad."""
    torque_nm: float
    """Largest commanded joint torque, N·m."""
    short_of_torque: float
    """Share of joint-milliseconds in which the data sheet's motors cannot deliver what is commanded, 1."""


def run_metrics(run: ClosedLoopRun, robot: Robot, first: int) -> RunMetrics:
    """Figures of the jump that begins at row ``first``."""
    schedule, period = schedule_of(run.log), run.log.info.sample_period_s
    rows = slice(first, min(len(run.log), first + round(schedule.take_off_s / period)))
    width = max(1, round(IMPULSE_S / period))
    force = moving_average(pair_force(run, robot), width)[rows]
    horizontal, vertical = force[:, FORCE_X], force[:, FORCE_Z]
    pushing = vertical > LEAST_PUSH_N
    joint_vel = run.truth.qvel[rows][:, robot.joint_dofs]
    commanded = commanded_torque(run.log)[rows]
    tracking_error = (run.log.per_joint("cmd_pos") - run.truth.qpos[:, robot.joint_qpos])[rows]
    return RunMetrics(
        friction=float(np.max(np.abs(horizontal[pushing]) / vertical[pushing], initial=0.0)),
        force_n=float(np.max(vertical, initial=0.0)),
        tracking_rad=float(np.sqrt(np.mean(tracking_error**2))),
        torque_nm=float(np.abs(commanded).max()),
        short_of_torque=float(np.mean(np.abs(resistance_of(robot) * commanded + joint_vel) > SUPPLY_V)),
    )


def pair_force(run: ClosedLoopRun, robot: Robot) -> np.ndarray:
    """True ground force of each pair on the robot, front x z, rear x z, N, world axes, (rows, 4)."""
    return per_pair(robot, run.ground_force)


def moving_average(values: np.ndarray, width: int) -> np.ndarray:
    """Moving average over ``width`` rows, (rows, n)."""
    window = np.ones(width) / width
    return np.stack([np.convolve(column, window, mode="same") for column in values.T], axis=1)
