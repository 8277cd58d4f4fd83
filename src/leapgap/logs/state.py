"""Conversion between the columns of a log and the motion of a robot; no other file does it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.base_estimate import BaseEstimate, check_base, estimate_base
from leapgap.logs.derivatives import DEGREES, add_velocities, velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, VELOCITY_SLICE, Motion
from leapgap.robot.rotations import turn_between

BASE_PARTS = {
    "base_position": BASE_POSITION,
    "base_quaternion": BASE_QUATERNION,
    "base_velocity": BASE_VELOCITY,
    "base_angular_velocity": BASE_ANGULAR_VELOCITY,
}
"""Part of a motion → its columns in a log."""
FIT_WINDOW_S, FIT_ROWS = 0.03, 7
"""Velocities that were not logged are slopes of parabolas through the positions within this time, or so many rows."""


@dataclass(frozen=True)
class States:
    """The states of a robot in the rows of a log, and how surely those are known that nobody measured."""

    log: Log
    motion: Motion
    fitted: frozenset[str]  # quantities that are slopes of a fit through others, here or by the importer
    base: BaseEstimate | None  # of a floating base whose position was not logged, by its planted feet; None elsewhere
    deviation: np.ndarray
    """Standard deviation of states that were not measured, in their tangent, (rows, 2 nv); zero for what was logged."""

    @staticmethod
    def of(log: Log, robot: Robot, sensors: Sequence[str] = ()) -> "States":
        """The states of every row, with the columns of some further sensors.

        A free base needs a logged attitude (``InputError`` otherwise). Velocities of which no component was logged are
        slopes of parabolas through the positions. Position and velocity of a base whose position was not logged come
        from its feet (``estimate_base``). Both start replays, and are compared with nothing. A single component that
        is missing is zero.
        """
        window = fit_window_s(log)
        joints = [joint for joint in robot.joints if f"joint_pos/{joint}" in log]
        full, derived = add_velocities(log, joints, window) if len(log) >= FIT_ROWS else (log, {})
        motion, fitted = logged_motion(full, robot), frozenset([*derived, *log.derived])
        base = None
        if robot.has_free_base and BASE_POSITION[0] not in log:
            check_base(log, robot)
            base = estimate_base(log, robot, motion, motor_torques(log, robot, motion))
            motion.base_position[:] = base.position
            if not has_base_velocity(log):
                motion.base_velocity[:] = base.velocity
        deviation = np.broadcast_to(0.0, (len(log), 2 * robot.model.nv))
        if fitted or base is not None:
            deviation = unmeasured_deviation(log, motion, robot, fitted, base, window)
        if sensors:
            motion = replace(motion, sensors=log.stack(sensors))
        return States(log, motion, fitted, base, deviation)

    def first_rows(self, rows: int) -> "States":
        """Those of the first rows of the log."""
        base = None if self.base is None else self.base.first_rows(rows)
        return States(self.log.first_rows(rows), self.motion[:rows], self.fitted, base, self.deviation[:rows])

    @property
    def estimated(self) -> frozenset[str]:
        """Quantities of the base that come from its planted feet."""
        if self.base is None:
            return frozenset()
        return frozenset({"base_pos"} if has_base_velocity(self.log) else {"base_pos", "base_linvel"})


def fit_window_s(log: Log) -> float:
    """Time within which velocities that were not logged are fitted through positions, s."""
    return max(FIT_WINDOW_S, FIT_ROWS * log.info.sample_period_s)


def motion_of(log: Log, robot: Robot, rows: slice = slice(None)) -> Motion:
    """The motion of the robot in some rows of a log: ``States``, without what is known of their noise."""
    return States.of(log, robot).motion[rows]


def logged_motion(log: Log, robot: Robot) -> Motion:
    """The columns of a log as a motion; zero for what it lacks."""
    check_logged(log, robot)
    motion = Motion(np.tile(robot.model.qpos0, (len(log), 1)), np.zeros((len(log), robot.model.nv)))
    if robot.has_free_base:
        motion.base_position[:] = 0.0
        for part, columns in BASE_PARTS.items():
            for axis, column in enumerate(columns):
                if column in log:
                    getattr(motion, part)[:, axis] = log[column]
    motion.qpos[:, robot.joint_qpos] = log.per_joint("joint_pos", robot.joints)
    if all(f"joint_vel/{joint}" in log for joint in robot.joints):
        motion.qvel[:, robot.joint_dofs] = log.per_joint("joint_vel", robot.joints)
    return motion


def check_logged(log: Log, robot: Robot) -> None:
    """Raise ``InputError`` for a log without what replays begin from: positions of all joints, attitude of a base."""
    missing = [joint for joint in robot.joints if f"joint_pos/{joint}" not in log]
    if missing and len(missing) == len(robot.joints):
        expected = f"joints of {robot.name}: {', '.join(robot.joints)}"
        raise InputError(log.name, f"positions of none of its joints (robot {log.info.robot})", expected, "log them")
    if missing:
        passive = [joint for joint in missing if joint not in robot.driven_joints]
        without = ", of joints without a motor" if passive == missing else ""
        expected = f"positions of all {len(robot.joints)} joints of {robot.name}: replays begin where the robot was"
        do = "log them, or take joints that never move out of the model"
        raise InputError(log.name, f"no joint_pos of {', '.join(missing)}{without}", expected, do)
    if robot.has_free_base and BASE_QUATERNION[0] not in log:
        expected = f"the attitude of the free base of {robot.name}"
        do = "log it; a robot that hangs is diagnosed with robot.fix_base=true"
        raise InputError(log.name, f"no {', '.join(BASE_QUATERNION)}", expected, do)


def has_base_velocity(log: Log) -> bool:
    """Whether any component of the base's velocity was logged."""
    return any(column in log for column in BASE_VELOCITY)


def motor_torques(log: Log, robot: Robot, motion: Motion) -> np.ndarray:
    """Torques that the log's commands ask for at a motion, within the limits of the motors, N·m, (rows, nv)."""
    torque = np.zeros_like(motion.qvel)
    at = [k for k, joint in enumerate(robot.joints) if joint in log.joints]
    joints, dofs = tuple(robot.joints[k] for k in at), robot.joint_dofs[at]
    spring, damper = pd_torques(log, joints, motion.qpos[:, robot.joint_qpos[at]], motion.qvel[:, dofs])
    limits = robot.torque_limits[at]
    torque[:, dofs] = np.clip(log.per_joint("cmd_tau", joints) + spring + damper, -limits, limits)
    return torque


def unmeasured_deviation(
    log: Log, motion: Motion, robot: Robot, fitted: frozenset[str], base: BaseEstimate | None, window_s: float
) -> np.ndarray:
    """Standard deviation of states that were not measured, in their tangent, (rows, 2 nv).

    That of fitted velocities is by the noise of the positions, largest at the ends of a log, and by how far a motion is
    from parabolas: by how much more cubics depart from them than noise explains. That of an estimated base is by how
    far its feet disagree.
    """
    nv, found = robot.model.nv, np.zeros((len(log), 2 * robot.model.nv))
    if fitted:
        position = tangent_of(motion, robot)
        parabola, cubic = (velocity_fit(log.time, position, window_s, degree) for degree in DEGREES)
        noise = noise_of(np.diff(position, axis=0), log.info.sample_period_s) ** 2
        more = np.mean(cubic.noise_gain**2 - parabola.noise_gain**2)
        bent = np.maximum(0, np.mean((cubic.velocity - parabola.velocity) ** 2, axis=0) - noise * more)
        deviation = np.sqrt(parabola.noise_gain[:, None] ** 2 * noise + bent)
        of_base = {"base_linvel": np.arange(3), "base_angvel": np.arange(3, 6)} if robot.has_free_base else {}
        for quantity, entries in (of_base | {"joint_vel": robot.joint_dofs}).items():
            if quantity in fitted:
                found[:, nv + entries] = deviation[:, entries]
    if base is not None:
        found[:, VELOCITY_SLICE.stop - 1] = base.height_deviation
        if not has_base_velocity(log):
            found[:, nv : nv + VELOCITY_SLICE.stop] = base.velocity_deviation
    return found


def tangent_of(motion: Motion, robot: Robot) -> np.ndarray:
    """Positions as departures from the first row, in the tangent of the state, (rows, nv)."""
    found = np.zeros((len(motion), robot.model.nv))
    if robot.has_free_base:
        found[:, VELOCITY_SLICE] = motion.base_position - motion.base_position[0]
        first = np.repeat(motion.base_quaternion[:1], len(motion), axis=0)
        found[:, ANGULAR_VELOCITY_SLICE] = turn_between(first, motion.base_quaternion)
    found[:, robot.joint_dofs] = motion.qpos[:, robot.joint_qpos]
    return found


def columns_of(motion: Motion, robot: Robot) -> dict[str, np.ndarray]:
    """The measured columns of a log that this motion fills, each (rows,)."""
    columns: dict[str, np.ndarray] = {}
    if robot.has_free_base:
        for part, names in BASE_PARTS.items():
            columns |= dict(zip(names, np.ascontiguousarray(getattr(motion, part).T), strict=True))
    for joint, position, velocity in zip(robot.joints, robot.joint_qpos, robot.joint_dofs, strict=True):
        columns[f"joint_pos/{joint}"] = np.ascontiguousarray(motion.qpos[:, position])
        columns[f"joint_vel/{joint}"] = np.ascontiguousarray(motion.qvel[:, velocity])
    return columns


def pd_torques(
    log: Log, joints: tuple[str, ...], joint_pos: np.ndarray, joint_vel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Spring and damper torque that the log's commands ask for at given joint angles and velocities.

    N·m, (rows, joints) each; positions rad and velocities rad/s, (rows, joints), in the order of ``joints``.
    """
    spring = log.per_joint("cmd_kp", joints) * (log.per_joint("cmd_pos", joints) - joint_pos)
    damper = log.per_joint("cmd_kd", joints) * (log.per_joint("cmd_vel", joints) - joint_vel)
    return spring, damper


def commanded_torque(log: Log, joints: tuple[str, ...] | None = None) -> np.ndarray:
    """Feed-forward plus joint PD torque at the measured joint state, N·m, (rows, joints)."""
    named = log.joints if joints is None else joints
    measured = (log.per_joint(quantity, named) for quantity in ("joint_pos", "joint_vel"))
    spring, damper = pd_torques(log, named, *measured)
    return log.per_joint("cmd_tau", named) + spring + damper
