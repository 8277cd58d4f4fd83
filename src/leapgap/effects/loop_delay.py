"""A joint PD that runs off board: what it measures and what it commands are both late."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Commands, Effect, parameter
from leapgap.effects.command_delay import CommandDelay
from leapgap.robot import actuators
from leapgap.robot.model import Robot

LEAST_INERTIA = 0.5
"""Share of a joint's inertia that the delayed damping leaves it."""


@dataclass(frozen=True)
class LoopDelay(Effect):
    """Time from a measurement to the torque of the joint PD that answers it; feed-forward and set points are as late.

    The PD acts on the state of ``delay_s`` ago, which is taken to second order: q(t − d) = q − d q̇ + d² q̈ / 2. So kd
    becomes kd − kp d, and the joint's inertia grows by kp d² / 2 − kd d, at most down to a half. Delays
    that are long for the loop (kp d² near the inertia) make a real loop unstable and are not exact here.
    """

    name = "loop_delay"
    by_default = False
    places = "joints"
    needs_motor = True

    delay_s: float = parameter(0.0, "s", 0.0, 0.02, 0.003)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the commands of the joints."""
        return CommandDelay(self.location, delay_s=self.delay_s).change_commands(commands, period_s, robot)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the delay of the measurement from the damping of the joint PD and from the inertia."""
        if self.is_nominal:
            return
        at = robot.joints_at(self.location)
        at = at[robot.driven[at]]
        motors, dofs = robot.joint_actuators[at], robot.joint_dofs[at]
        kp, kd = actuators.gains_of(model, motors)
        actuators.set_gains(model, motors, kp, kd - kp * self.delay_s)
        added = kp * self.delay_s**2 / 2 - kd * self.delay_s
        own = model.dof_M0[dofs]
        model.dof_armature[dofs] += np.maximum(added, (LEAST_INERTIA - 1) * own)
