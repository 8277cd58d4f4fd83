"""Off-table effects of the robot's structure; the bent calf is in ``leapgap.simulation.presets``."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import parameter
from leapgap.robot.model import Robot
from leapgap.validation.off_table.base import OffTableEffect


@dataclass(frozen=True)
class CableSpring(OffTableEffect):
    """Stiff cables across the joints: a spring about the joint angles of the crouch."""

    name = "cable_spring"
    places = "joints"

    stiffness_nm_rad: float = parameter(0.0, "N·m/rad", 0.0, 30.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set stiffness and rest angle of the joints."""
        for dof in robot.joint_dofs[robot.joints_at(self.location)]:
            joint = int(model.dof_jntid[dof])
            address = int(model.jnt_qposadr[joint])
            model.jnt_stiffness[joint] = self.stiffness_nm_rad
            if model.nkey:
                model.qpos_spring[address] = robot.model.key_qpos[0, address]
