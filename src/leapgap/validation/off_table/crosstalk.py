"""Drivers of one leg that disturb each other."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.validation.off_table.base import OffTableEffect, Process


@dataclass(frozen=True)
class Crosstalk(OffTableEffect):
    """Current sensors that also feel the neighbour on their board: a joint gets a share of the next motor's torque.

    Next in the leg, from the body outwards; the last joint's neighbour is the first one.
    """

    name = "crosstalk"
    places = "joints"

    share: float = parameter(0.0, "1", 0.0, 0.5)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Add to each joint at the location what its neighbour's motor delivered in the last step."""
        at = robot.joints_at(self.location)
        dofs, neighbours = robot.joint_dofs[at], robot.joint_actuators[[neighbour(robot, int(joint)) for joint in at]]

        def leak(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[dofs] += self.share * np.asarray(data.actuator_force[neighbours])

        return leak


def neighbour(robot: Robot, joint: int) -> int:
    """Index of the joint that is next to a joint (index) in its limb."""
    for members in robot.topology.limbs.values():
        if robot.joints[joint] in members:
            return robot.joints.index(members[(members.index(robot.joints[joint]) + 1) % len(members)])
    return joint
