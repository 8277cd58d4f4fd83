"""Encoder bias."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import Commands, Effect, ForceContext, parameter
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class EncoderBias(Effect):
    """Reported − true joint position. The joint PD acts on the reported position, and the log holds it."""

    name = "encoder_bias"
    places = "joints"

    bias_rad: float = parameter(0.0, "rad", -0.6, 0.6, 0.03)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Less stiffness times the bias, within the limits; what is measured changes beside it."""
        return at.at_motors(location, -at.kp * at.within)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the set points: kp (q* − (q + bias)) = kp ((q* − bias) − q)."""
        position = commands.position.copy()
        position[:, robot.joints_at(self.location)] -= self.bias_rad
        return replace(commands, position=position)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Add the bias to the joint positions."""
        return self._shifted(motion, self.bias_rad, robot)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Subtract the bias from the first joint positions."""
        return self._shifted(start, -self.bias_rad, robot)

    def _shifted(self, motion: Motion, angle: float, robot: Robot) -> Motion:
        qpos: np.ndarray = motion.qpos.copy()
        qpos[:, robot.joint_qpos[robot.joints_at(self.location)]] += angle
        return replace(motion, qpos=qpos)
