"""Off-table effects of motors and gears: backlash, cogging, a dead band."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.validation.off_table.base import OffTableEffect, Process

COGS = 40
"""Cogging periods per turn of the joint: 36 rotor slots behind the gear would give more, the planet gears fewer."""
TOOTH_STIFFNESS = 4000.0
"""Stiffness of the teeth in contact, N·m/rad."""
TOOTH_DAMPING = 2.0
"""Damping of the teeth in contact, N·m·s/rad."""


@dataclass(frozen=True)
class MotorTorque:
    """What motors with joint PD give, as the model has them when this is made."""

    gain: np.ndarray
    """(motors,), N·m per unit of control."""
    bias: np.ndarray
    """(motors, 3): constant, N·m per rad and N·m per rad/s."""
    limit: np.ndarray
    """(motors, 2) least and largest torque, N·m."""

    @classmethod
    def of(cls, model: mujoco.MjModel, actuators: np.ndarray) -> "MotorTorque":
        """Copies of the model's numbers."""
        return cls(
            model.actuator_gainprm[actuators, 0].copy(),
            model.actuator_biasprm[actuators, :3].copy(),
            model.actuator_forcerange[actuators].copy(),
        )

    def __call__(self, control: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torques, N·m, at joint angles, rad, and velocities, rad/s, (motors,) each."""
        torque = self.gain * control + self.bias[:, 1] * q + self.bias[:, 2] * v
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
        at = robot.joints_at(self.location)
        actuators, dofs, qpos = robot.joint_actuators[at], robot.joint_dofs[at], robot.joint_qpos[at]
        inertia = model.dof_armature[dofs].copy()
        motor = MotorTorque.of(model, actuators)
        model.actuator_gainprm[actuators], model.actuator_biasprm[actuators] = 0.0, 0.0
        model.dof_armature[dofs] = 0.0
        mujoco.mj_setConst(model, mujoco.MjData(model))
        rotor: dict[str, np.ndarray] = {}

        def mesh(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            q, v = data.qpos[qpos], data.qvel[dofs]
            if not rotor:
                rotor["q"], rotor["v"] = q.copy(), v.copy()
            motor_torque = motor(data.ctrl[actuators], q, v)
            twist = rotor["q"] - q
            beyond = twist - np.clip(twist, -self.play_rad / 2, self.play_rad / 2)
            teeth = np.where(beyond != 0, TOOTH_STIFFNESS * beyond + TOOTH_DAMPING * (rotor["v"] - v), 0.0)
            rotor["v"] = rotor["v"] + model.opt.timestep * (motor_torque - teeth) / inertia
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
        at = robot.joints_at(self.location)
        actuators, dofs, qpos = robot.joint_actuators[at], robot.joint_dofs[at], robot.joint_qpos[at]
        motor = MotorTorque.of(model, actuators)

        def take(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            given = motor(data.ctrl[actuators], data.qpos[qpos], data.qvel[dofs])
            data.qfrc_applied[dofs] -= np.clip(given, -self.torque_nm, self.torque_nm)

        return take


KINDS: tuple[type[OffTableEffect], ...] = (Backlash, Cogging, DeadBand)
