"""Where and how a jump landed, from the true motion of the simulation rather than from sensors."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.task import schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import pitch_of, upright_cosine, yaw_of
from leapgap.simulation.closed_loop import ClosedLoopRun

LARGEST_PITCH_RAD = np.deg2rad(15)
STANDS_AFTER_S = 0.5
"""A successful landing is still upright after this time."""
UPRIGHT_COSINE = np.cos(np.deg2rad(30))
"""Cosine of the largest angle between the vertical axes of the base and of the world."""
FOOT_ABOVE_SURFACE_M = 0.03
"""Largest distance of a foot's lowest point from the target surface, or from the blocks on it, to stand on it."""


@dataclass(frozen=True)
class Landing:
    """Errors are target distance − displacement along the heading at take-off, cm; positive is short."""

    error_cm: float
    """Error at the end of the scheduled flight."""
    contact_error_cm: float | None
    """Error when the first foot touches again; None where none does."""
    pitch_deg: float
    """Pitch at the end of the scheduled flight, nose-down."""
    apex: float
    """Largest height of the base, divided by its height at the start."""
    success: bool
    """Pitch below 15°, and half a second later all feet on the target surface and the base upright."""


def landing(run: ClosedLoopRun, robot: Robot, first: int = 0, target_x_m: float | None = None) -> Landing:
    """Landing of the jump that begins at row ``first``; the target distance is the log's unless one is given."""
    jump, truth = run.log, run.truth
    schedule, period = schedule_of(jump), jump.info.sample_period_s
    target_x = target_of(jump).x_m if target_x_m is None else target_x_m
    row, take_off = (
        min(len(jump) - 1, first + round(seconds / period)) for seconds in (schedule.landing_s, schedule.take_off_s)
    )
    end = min(len(jump) - 1, row + round(STANDS_AFTER_S / period))
    position = truth.base_position
    yaw = yaw_of(truth.base_quaternion[first])
    forward = (position - position[first])[:, :2] @ np.array([np.cos(yaw), np.sin(yaw)])
    airborne = np.flatnonzero(~run.touching[take_off:row].any(axis=1))
    left = take_off + airborne[0] if len(airborne) else row
    touched = np.flatnonzero(run.touching[left:].any(axis=1))
    pitch = float(pitch_of(truth.base_quaternion[row]))
    return Landing(
        error_cm=float(100 * (target_x - forward[row])),
        contact_error_cm=float(100 * (target_x - forward[left + touched[0]])) if len(touched) else None,
        pitch_deg=float(np.rad2deg(pitch)),
        apex=float(position[first : end + 1, 2].max() / position[first, 2]),
        success=bool(abs(pitch) < LARGEST_PITCH_RAD and stands(truth, robot, end, target_of(jump).z_m, jump)),
    )


def stands(truth: Motion, robot: Robot, row: int, surface_z_m: float, jump: Log) -> bool:
    """Whether at a row the base is upright and all feet stand on the target surface, which may be a box."""
    feet = feet_positions(robot, truth.qpos[row : row + 1])[0]
    height = feet[:, 2] - robot.foot_radius - surface_z_m
    highest = max((box.top_m - surface_z_m for box in jump.info.terrain), default=0.0)
    on_surface = (height > -FOOT_ABOVE_SURFACE_M) & (height < max(highest, 0.0) + FOOT_ABOVE_SURFACE_M)
    for box in jump.info.terrain:
        if surface_z_m > 0 and box.top_m == surface_z_m:
            on_surface &= np.abs(feet[:, 0] - box.x_m) < box.size_m[0] / 2
    return bool(on_surface.all() and upright_cosine(truth.base_quaternion[row]) > UPRIGHT_COSINE)
