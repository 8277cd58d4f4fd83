"""Off-table effects of motors, drives and what carries them; the bent calf is in ``leapgap.simulation.presets``."""

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


COGS = 40  # cogging periods per turn of the joint: rotor slots behind the gear give more, planet gears fewer
TOOTH_STIFFNESS = 4000.0  # stiffness of the teeth in contact, N·m/rad
TOOTH_DAMPING = 2.0  # damping of the teeth in contact, N·m·s/rad


@dataclass(frozen=True)
class Motors:
    """The motors of a location with their joint PD, as the model has them when this is made."""

    actuators: np.ndarray
    dofs: np.ndarray
    qpos: np.ndarray  # indices of the motors and of their joints in the model, (motors,) each
    gain: np.ndarray  # (motors,), N·m per unit of control
    bias: np.ndarray  # (motors, 3): constant, N·m per rad and N·m per rad/s
    limit: np.ndarray  # (motors, 2) least and largest torque, N·m

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: Robot, location: str) -> "Motors":
        """The motors of a location with copies of the model's numbers."""
        at = robot.joints_at(location)
        actuators = robot.joint_actuators[at]
        return cls(
            actuators,
            robot.joint_dofs[at],
            robot.joint_qpos[at],
            model.actuator_gainprm[actuators, 0].copy(),
            model.actuator_biasprm[actuators, :3].copy(),
            model.actuator_forcerange[actuators].copy(),
        )

    def torque(self, data: mujoco.MjData) -> np.ndarray:
        """Torques that the motors give in the present state, (motors,), N·m."""
        q, v = data.qpos[self.qpos], data.qvel[self.dofs]
        torque = self.gain * data.ctrl[self.actuators] + self.bias[:, 1] * q + self.bias[:, 2] * v
        return np.clip(torque, self.limit[:, 0], self.limit[:, 1])


@dataclass(frozen=True)
class Backlash(OffTableEffect):
    """Play in the gears: the rotor turns freely within it before its teeth push the link.

    The joint's armature is the rotor; encoder and joint PD sit at the link.
    """

    name = "backlash"
    places = "joints"

    play_rad: float = parameter(0.0, "rad", 0.0, 0.15)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Drive a rotor, integrated here, with the motor's torque, and the link with the torque of the teeth."""
        motors = Motors.of(model, robot, self.location)
        dofs, inertia = motors.dofs, model.dof_armature[motors.dofs].copy()
        model.actuator_gainprm[motors.actuators], model.actuator_biasprm[motors.actuators] = 0.0, 0.0
        model.dof_armature[dofs] = 0.0
        mujoco.mj_setConst(model, mujoco.MjData(model))
        rotor: dict[str, np.ndarray] = {}

        def mesh(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            q, v = data.qpos[motors.qpos], data.qvel[dofs]
            if not rotor:
                rotor["q"], rotor["v"] = q.copy(), v.copy()
            twist = rotor["q"] - q
            beyond = twist - np.clip(twist, -self.play_rad / 2, self.play_rad / 2)
            teeth = np.where(beyond != 0, TOOTH_STIFFNESS * beyond + TOOTH_DAMPING * (rotor["v"] - v), 0.0)
            rotor["v"] = rotor["v"] + model.opt.timestep * (motors.torque(data) - teeth) / inertia
            rotor["q"] = rotor["q"] + model.opt.timestep * rotor["v"]
            data.qfrc_applied[dofs] += teeth

        return mesh


@dataclass(frozen=True)
class Cogging(OffTableEffect):
    """A torque that ripples with the joint's angle q: amplitude · sin(40 q); its mean is zero."""

    name = "cogging"
    places = "joints"

    amplitude_nm: float = parameter(0.0, "N·m", 0.0, 10.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Add the ripple torque at the joints of the location."""
        at = robot.joints_at(self.location)
        dofs, qpos = robot.joint_dofs[at], robot.joint_qpos[at]

        def ripple(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[dofs] += self.amplitude_nm * np.sin(COGS * data.qpos[qpos])

        return ripple


@dataclass(frozen=True)
class DeadBand(OffTableEffect):
    """A driver that gives no small currents: of a torque τ the joint gets what is left of its size beyond the band.

    Unlike dry friction it takes from torques at rest as well, and does nothing while the motor is idle.
    """

    name = "dead_band"
    places = "joints"

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Take the band away from what the motors of the location give."""
        motors = Motors.of(model, robot, self.location)

        def take(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[motors.dofs] -= np.clip(motors.torque(data), -self.torque_nm, self.torque_nm)

        return take
