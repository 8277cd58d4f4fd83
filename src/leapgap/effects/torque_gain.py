"""Motors that deliver another torque than they were told."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TorqueGain(Effect):
    """Delivered over commanded torque: feed-forward, joint PD and limit are all scaled."""

    name = "torque_gain"
    places = "joints"

    scale: float = parameter(1.0, "1", 0.3, 1.5)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the actuators' gain, bias and force range."""
        actuators = robot.joint_actuators[robot.joints_at(self.location)]
        model.actuator_gainprm[actuators, 0] *= self.scale
        model.actuator_biasprm[actuators, :3] *= self.scale
        model.actuator_forcerange[actuators] *= self.scale
