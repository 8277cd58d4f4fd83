"""Sensor noise: white noise on every measured quantity."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.motion import QUATERNION_SLICE, Motion
from leapgap.robot.rotations import turn_by, turn_one_by


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of white noise on what is measured."""

    base_pos_m: float = 0.001
    base_angle_rad: float = 0.002
    base_linvel_m_s: float = 0.01
    base_angvel_rad_s: float = 0.02
    joint_pos_rad: float = 0.0005
    joint_vel_rad_s: float = 0.05


@dataclass(frozen=True)
class NoiseRows:
    """Drawn measurement errors of the quantities in ``SensorNoise``, one row a control tick."""

    position: np.ndarray  # (rows, 3), m
    angle: np.ndarray  # (rows, 3), rad, about the body's axes
    joint_pos: np.ndarray  # (rows, joints), rad
    joint_vel: np.ndarray  # (rows, joints), rad/s
    linvel: np.ndarray  # (rows, 3), m/s
    angvel: np.ndarray  # (rows, 3), rad/s

    @staticmethod
    def draw(noise: SensorNoise, rows: int, joints: int, rng: np.random.Generator) -> "NoiseRows":
        """Draw independent normal errors for some rows and joints."""
        of_base, of_joints = (rows, 3), (rows, joints)
        return NoiseRows(
            noise.base_pos_m * rng.standard_normal(of_base),
            noise.base_angle_rad * rng.standard_normal(of_base),
            noise.joint_pos_rad * rng.standard_normal(of_joints),
            noise.joint_vel_rad_s * rng.standard_normal(of_joints),
            noise.base_linvel_m_s * rng.standard_normal(of_base),
            noise.base_angvel_rad_s * rng.standard_normal(of_base),
        )

    def by_tick(self, robot: Robot) -> Callable[[Motion, int], Motion]:
        """``add_to`` for many motions of one row each: the motion of a tick, and the tick, to what is measured.

        Bit for bit the same, in half the time, where each coordinate of the robot is measured.
        """
        if not robot.has_free_base or len(robot.joints) != robot.model.nv - 6 or robot.model.nq != robot.model.nv + 1:
            return lambda motion, tick: self.add_to(motion, robot, tick)
        rows = len(self.position)
        of_all = Motion(np.zeros((rows, robot.model.nq)), np.zeros((rows, robot.model.nv)))
        of_all.base_position[:], of_all.base_velocity[:] = self.position, self.linvel
        of_all.base_angular_velocity[:] = self.angvel
        of_all.qpos[:, robot.joint_qpos], of_all.qvel[:, robot.joint_dofs] = self.joint_pos, self.joint_vel

        def add(motion: Motion, tick: int) -> Motion:
            qpos = motion.qpos + of_all.qpos[tick]
            qpos[0, QUATERNION_SLICE] = turn_one_by(motion.qpos[0, QUATERNION_SLICE], self.angle[tick])
            return Motion(qpos, motion.qvel + of_all.qvel[tick])

        return add

    def add_to(self, motion: Motion, robot: Robot, first: int = 0) -> Motion:
        """The motion with these errors added; its first row is tick ``first``."""
        rows = slice(first, first + len(motion))
        measured = motion.copy()
        if robot.has_free_base:
            measured.base_position[:] += self.position[rows]
            measured.base_quaternion[:] = turn_by(motion.base_quaternion, self.angle[rows])
            measured.base_velocity[:] += self.linvel[rows]
            measured.base_angular_velocity[:] += self.angvel[rows]
        measured.qpos[:, robot.joint_qpos] += self.joint_pos[rows]
        measured.qvel[:, robot.joint_dofs] += self.joint_vel[rows]
        return measured
