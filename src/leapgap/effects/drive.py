"""The motors between command and joint: what they deliver of what the joint PD asks for.

Where neither voltage nor inductance matter they are MuJoCo's affine actuators. Where one does, they are its DC motors
(``dcmotor``), which hold the same joint PD, drive v = R τ + q̇ within ± the voltage, and let the torque follow with
the electrical time constant; the motor constant is 1 at the joint, so that current is torque.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.robot.model import Robot

FEED_FORWARD_INPUT = 4
"""MuJoCo's input signature of a DC motor whose one control is a torque (bits: position 1, velocity 2, torque 4)."""


@dataclass(frozen=True)
class Drive:
    """Motors of all joints, shape (joints,) each, joint order of the robot."""

    gain: np.ndarray
    """Delivered over commanded torque; scales the torque limit too."""
    voltage_v: np.ndarray
    """|R τ + q̇| stays within it; infinite: no limit."""
    lag_s: np.ndarray
    """Time constant with which the delivered torque follows the commanded one; 0: at once."""

    @staticmethod
    def ideal(joints: int) -> "Drive":
        """Motors that deliver what they are told."""
        return Drive(np.ones(joints), np.full(joints, np.inf), np.zeros(joints))

    @property
    def electric(self) -> np.ndarray:
        """Which joints need the DC motor, (joints,)."""
        return np.isfinite(self.voltage_v) | (self.lag_s > 0)

    @property
    def control_gain(self) -> np.ndarray:
        """Factor on the controls, (joints,): a DC motor has no gain of its own."""
        return np.where(self.electric, self.gain, 1.0)

    def put_into(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Give the model these motors; the joint PD stands in the actuators' bias already."""
        actuators = robot.joint_actuators
        model.actuator_gainprm[actuators, 0] *= self.gain
        model.actuator_biasprm[actuators, :3] *= self.gain[:, None]
        model.actuator_forcerange[actuators] *= self.gain[:, None]
        chosen = self.electric
        if not chosen.any():
            return
        motors = actuators[chosen]
        kp, kd = -model.actuator_biasprm[motors, 1], -model.actuator_biasprm[motors, 2]
        model.actuator_dyntype[motors] = int(mujoco.mjtDyn.mjDYN_DCMOTOR)
        model.actuator_gaintype[motors] = int(mujoco.mjtGain.mjGAIN_DCMOTOR)
        model.actuator_biastype[motors] = int(mujoco.mjtBias.mjBIAS_DCMOTOR)
        model.actuator_ctrlspec[motors] = FEED_FORWARD_INPUT
        model.actuator_actearly[motors] = True
        model.actuator_gainprm[motors], model.actuator_biasprm[motors], model.actuator_dynprm[motors] = 0.0, 0.0, 0.0
        model.actuator_gainprm[motors, 0], model.actuator_gainprm[motors, 1] = resistance_of(robot), 1.0
        model.actuator_gainprm[motors, 4], model.actuator_gainprm[motors, 6] = kp, kd
        model.actuator_gainprm[motors, 7] = np.where(np.isfinite(self.voltage_v), self.voltage_v, 0.0)[chosen]
        model.actuator_dynprm[motors, 0] = self.lag_s[chosen]

    def set_joint_pd(self, model: mujoco.MjModel, robot: Robot, kp: np.ndarray, kd: np.ndarray) -> None:
        """Give motors that are in the model already other gains, (joints,): N·m/rad, N·m·s/rad."""
        actuators, chosen = robot.joint_actuators, self.electric
        affine, motors = actuators[~chosen], actuators[chosen]
        model.actuator_biasprm[affine, 1] = -(kp * self.gain)[~chosen]
        model.actuator_biasprm[affine, 2] = -(kd * self.gain)[~chosen]
        model.actuator_gainprm[motors, 4] = (kp * self.gain)[chosen]
        model.actuator_gainprm[motors, 6] = (kd * self.gain)[chosen]


def resistance_of(robot: Robot) -> float:
    """Of the motors, V/(N·m); 1 where nobody states it, which a lag without a voltage limit does not feel."""
    return 1.0 if robot.motors is None else robot.motors.resistance


def add_lag(spec: mujoco.MjSpec, joints: set[str], resistance: float) -> None:
    """Give the motors of these joints the state, their torque, that a lag needs."""
    for actuator in spec.actuators:
        if actuator.target in joints:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_DCMOTOR
            actuator.gaintype = mujoco.mjtGain.mjGAIN_DCMOTOR
            actuator.biastype = mujoco.mjtBias.mjBIAS_DCMOTOR
            actuator.ctrlspec = FEED_FORWARD_INPUT
            actuator.gainprm[:2] = resistance, 1.0
            actuator.dynprm[0] = 1.0  # any lag: its size comes with the drive
            actuator.actearly = True
