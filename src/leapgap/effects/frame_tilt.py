"""Tilt of the measuring frame (motion capture)."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Effect, parameter
from leapgap.effects.leaning import inverse, lean, rotated
from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion


@dataclass(frozen=True)
class FrameTilt(Effect):
    """The reported pose and velocity of the base are the true ones turned about the world's origin.

    The turn is a roll about x, then a pitch about y. Joints, and the angular velocity in the axes of the base, are
    reported as they are.
    """

    name = "frame_tilt"
    by_default = False
    needs_base = True

    roll_rad: float = parameter(0.0, "rad", -0.3, 0.3, 0.03)
    pitch_rad: float = parameter(0.0, "rad", -0.3, 0.3, 0.03)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Turn the state of the base."""
        return self._turned(motion, lean(self.roll_rad, self.pitch_rad), robot)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Turn the first state of the base back."""
        return self._turned(start, inverse(lean(self.roll_rad, self.pitch_rad)), robot)

    def _turned(self, motion: Motion, turn: np.ndarray, robot: Robot) -> Motion:
        if self.is_nominal or not robot.has_free_base:
            return motion
        qpos, qvel = motion.qpos.copy(), motion.qvel.copy()
        qpos[:, POSITION_SLICE] = rotated(motion.base_position, turn)
        qvel[:, VELOCITY_SLICE] = rotated(motion.base_velocity, turn)
        for true, reported in zip(motion.base_quaternion, qpos[:, QUATERNION_SLICE], strict=True):
            mujoco.mju_mulQuat(reported, turn, true)
        return replace(motion, qpos=qpos, qvel=qvel)
