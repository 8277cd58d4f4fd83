"""Sensor noise: white noise on every measured quantity."""

from dataclasses import dataclass

import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import turn_by


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

    position: np.ndarray
    """(rows, 3), m."""
    angle: np.ndarray
    """(rows, 3), rad, about the body's axes."""
    joint_pos: np.ndarray
    """(rows, joints), rad."""
    joint_vel: np.ndarray
    """(rows, joints), rad/s."""
    linvel: np.ndarray
    """(rows, 3), m/s."""
    angvel: np.ndarray
    """(rows, 3), rad/s."""

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
