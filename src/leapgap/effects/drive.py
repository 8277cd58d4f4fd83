"""Motors between command and joint: the torque they deliver when the joint PD asks for one.

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
    """Ratio of delivered to commanded torque; it scales the torque limit too."""
    voltage_v: np.ndarray
    """Limit of |R τ + q̇|, V; infinite: no limit."""
    lag_s: np.ndarray
    """Time constant with which the delivered torque follows the commanded one; 0: at once."""

    @staticmethod
    def ideal(joints: int) -> "Drive":
        """Motors that deliver the commanded torque at once."""
        return Drive(np.ones(joints), np.full(joints, np.inf), np.zeros(joints))

    @property
    def electric(self) -> np.ndarray:
        """Which joints need MuJoCo's DC motor, bool, (joints,)."""
        return np.isfinite(self.voltage_v) | (self.lag_s > 0)

    @property
    def control_gain(self) -> np.ndarray:
        """Factor on the controls, (joints,): a DC motor has no gain of its own."""
        return np.where(self.electric, self.gain, 1.0)

    def put_into(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set these motors in the model, whose actuators already have the joint PD in their bias."""
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
        """Set other gains (joints,) in a model that has these motors: N·m/rad, N·m·s/rad."""
        actuators, chosen = robot.joint_actuators, self.electric
        affine, motors = actuators[~chosen], actuators[chosen]
        model.actuator_biasprm[affine, 1] = -(kp * self.gain)[~chosen]
        model.actuator_biasprm[affine, 2] = -(kd * self.gain)[~chosen]
        model.actuator_gainprm[motors, 4] = (kp * self.gain)[chosen]
        model.actuator_gainprm[motors, 6] = (kd * self.gain)[chosen]


def resistance_of(robot: Robot) -> float:
    """Resistance of the motors, V/(N·m); 1 where it is not stated, which has no influence without a voltage limit."""
    return 1.0 if robot.motors is None else robot.motors.resistance


def add_lag(spec: mujoco.MjSpec, joints: set[str], resistance: float) -> None:
    """Give the motors of these joints their torque as a state, which a lag needs."""
    for actuator in spec.actuators:
        if actuator.target in joints:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_DCMOTOR
            actuator.gaintype = mujoco.mjtGain.mjGAIN_DCMOTOR
            actuator.biastype = mujoco.mjtBias.mjBIAS_DCMOTOR
            actuator.ctrlspec = FEED_FORWARD_INPUT
            actuator.gainprm[:2] = resistance, 1.0
            actuator.dynprm[0] = 1.0  # any lag: its size comes with the drive
            actuator.actearly = True
