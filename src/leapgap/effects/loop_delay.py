"""Latency of the feedback loop."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects.base import Commands, ForceContext, MotorEffect, parameter
from leapgap.effects.command_delay import CommandDelay
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class LoopDelay(MotorEffect):
    """Time from a measurement to the torque of the joint PD that answers it; feed-forward and set points are as late.

    The PD acts on the state of ``delay_s`` ago, which is taken to second order: q(t − d) = q − d q̇ + d² q̈ / 2. So kd
    becomes kd − kp d, and the joint's inertia grows by kp d² / 2 − kd d, at most down to a half. Delays
    that are long for the loop (kp d² near the inertia) make a real loop unstable and are not exact here.
    """

    name = "loop_delay"
    by_default = False

    delay_s: float = parameter(0.0, "s", 0.0, 0.15, 0.003)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Commands and joint PD are late."""
        return at.at_motors(location, at.within * (at.late(at.sent) + at.kp * at.velocity + at.kd * at.acceleration))

    @property
    def memory_s(self) -> float:
        """All of the delay."""
        return self.delay_s

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the commands of the joints."""
        return CommandDelay(self.location, delay_s=self.delay_s).change_commands(commands, period_s, robot)

    def change_newest_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the last of the commands of the joints."""
        return CommandDelay(self.location, delay_s=self.delay_s).change_newest_commands(commands, period_s, robot)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the time after which the joint PD answers."""
        return drive.added("delay_s", robot.joints_at(self.location), self.delay_s)
