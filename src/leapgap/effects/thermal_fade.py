"""Torque loss as motors heat."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import MotorEffect, parameter
from leapgap.effects.drive import Drive, add_heating, lacks_torque_limits
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ThermalFade(MotorEffect):
    """Rate at which a motor's resistance rises under its largest torque, as a share of it, and with it torque is lost.

    A drive that takes its windings for cold delivers τ / (1 + r) of the torque τ that it is asked for. The rise r
    follows the heat of the current, ṙ = loss · (τ / τ_max)² / (1 + r) − r / 60 s, with the model's limit τ_max: the
    thermal model of MuJoCo's DC motor. A log begins with cold motors; what they have lost before is a ``torque_gain``.
    A replay that starts within a log has the warmth that the log's commands and motion gave them before. What is asked
    for beyond the limit heats as if it were delivered, and the limit itself does not fall.
    """

    name = "thermal_fade"
    by_default = False

    loss_per_s: float = parameter(0.0, "1/s", 0.0, 20.0, 1.0, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The loss is that under the largest torque, which the model states."""
        return super().lacks(robot) or lacks_torque_limits(robot)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the motors their warmth as a state."""
        add_heating(spec, robot, self.location)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the motors' heating."""
        at = robot.joints_at(self.location)
        return drive.added(
            "heating", at, np.where(robot.driven[at], self.loss_per_s / robot.torque_limits[at] ** 2, 0.0)
        )
