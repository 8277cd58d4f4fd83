"""Motors between command and joint: the torque they deliver when the joint PD asks for one.

Where neither voltage nor inductance matter they are MuJoCo's affine actuators. Where one does, they are its DC motors
(``dcmotor``), which hold the same joint PD, drive v = R τ + q̇ within ± the voltage, and let the torque follow with
the electrical time constant; the motor constant is 1 at the joint, so that current is torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.robot import actuators, dc_motors
from leapgap.robot.model import Robot

LEAST_INERTIA = 0.5  # share of a joint's inertia that a late damping leaves it
COOLING_S = 60.0  # time constant with which the windings of small motors give their heat to the housing


@dataclass(frozen=True)
class Drive:
    """Motors of all joints, shape (joints,) each, joint order of the robot."""

    kp_scale: np.ndarray  # Ratio of the joint PD's acting stiffness to the one that was sent
    kd_scale: np.ndarray  # The same of its damping
    limit_scale: np.ndarray  # Ratio of the torque limit to the model's
    gain: np.ndarray  # Ratio of delivered to commanded torque; it scales the torque limit too
    voltage_v: np.ndarray  # Limit of |R τ + q̇|, V; infinite: no limit
    lag_s: np.ndarray  # Time constant with which the delivered torque follows the commanded one; 0: at once
    filter_s: np.ndarray  # Time constant of the filter of the joint velocity that the joint PD feeds back; 0: none
    resistance: np.ndarray  # Of the windings, V/(N·m); NaN: that of the robot's motors
    delay_s: np.ndarray
    """Time from a measurement to the torque with which the joint PD answers it; 0: the PD runs at the joint."""
    heating: np.ndarray  # Growth of the windings' resistance by their heat, as a share of it: 1/(N²m²s); 0: none

    @staticmethod
    def ideal(joints: int) -> "Drive":
        """Motors that deliver the commanded torque at once."""
        ones, none = np.ones(joints), np.zeros(joints)
        return Drive(
            kp_scale=ones,
            kd_scale=ones,
            limit_scale=ones,
            gain=ones,
            voltage_v=np.full(joints, np.inf),
            lag_s=none,
            filter_s=none,
            resistance=np.full(joints, np.nan),
            delay_s=none,
            heating=none,
        )

    @property
    def electric(self) -> np.ndarray:
        """Which joints need MuJoCo's DC motor, bool, (joints,)."""
        return np.isfinite(self.voltage_v) | (self.lag_s > 0) | (self.heating > 0)

    def resistances(self, robot: Robot) -> np.ndarray:
        """Resistance of each joint's motor, V/(N·m), (joints,)."""
        return np.where(np.isnan(self.resistance), resistance_of(robot), self.resistance)

    @property
    def control_gain(self) -> np.ndarray:
        """Factor on the controls, (joints,): a DC motor has no gain of its own."""
        return np.where(self.electric, self.gain, 1.0)

    def scaled(self, name: str, joints: np.ndarray, by: float) -> "Drive":
        """The same motors with one field larger by a factor at some joints."""
        changed = getattr(self, name).copy()
        changed[joints] *= by
        return replace(self, **{name: changed})

    def added(self, name: str, joints: np.ndarray, by: np.ndarray | float) -> "Drive":
        """The same motors with one field larger by so much at some joints."""
        changed = getattr(self, name).copy()
        changed[joints] += by
        return replace(self, **{name: changed})

    def gains(self, kp: np.ndarray, kd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gains of the joint PD that act, from those that were sent, (…, joints) each: N·m/rad, N·m·s/rad."""
        return kp * self.kp_scale, kd * self.kd_scale

    def torque_limits(self, robot: Robot) -> np.ndarray:
        """Largest torque that can be commanded, N·m, (joints,); ``gain`` acts on what is within."""
        return robot.torque_limits * self.limit_scale

    def put_into(self, model: mujoco.MjModel, robot: Robot, kp: np.ndarray, kd: np.ndarray) -> None:
        """Set these motors in a model of affine actuators, with a joint PD of the gains that were sent (joints,)."""
        actuators.set_joint_pd(model, robot.joint_actuators, *self.gains(kp, kd))
        actuators.scale_limit(model, robot.joint_actuators, self.limit_scale * self.gain)
        actuators.scale_torque(model, robot.joint_actuators, self.gain)
        chosen = self.electric & robot.driven
        if chosen.any():
            voltage = np.where(np.isfinite(self.voltage_v), self.voltage_v, 0.0)
            motors = robot.joint_actuators[chosen]
            resistance = self.resistances(robot)[chosen]
            dc_motors.make_dc_motors(model, motors, resistance, voltage[chosen], self.lag_s[chosen])
            dc_motors.set_heating(model, motors, self.heating[chosen], COOLING_S)
        self._delay_pd(model, robot)
        self.split_joint_pd(model, robot)

    def split_joint_pd(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Let the dampers of joint PDs whose velocity is filtered act late."""
        at = np.flatnonzero((self.filter_s > 0) & robot.driven)
        if len(at):
            dampers = np.array([model.actuator(dc_motors.filter_of(robot.joints[i])).id for i in at])
            dc_motors.split_joint_pd(model, robot.joint_actuators[at], dampers, (self.filter_s + self.lag_s)[at])

    def _delay_pd(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Let the joint PD act on the state of ``delay_s`` ago, q − d q̇ + d² q̈ / 2.

        So kd becomes kd − kp d, and the inertia of the joint grows by kp d² / 2 − kd d, at most down to a half.
        """
        late = (self.delay_s > 0) & robot.driven
        if not late.any():
            return
        motors, dofs, delay = robot.joint_actuators[late], robot.joint_dofs[late], self.delay_s[late]
        kp, kd = dc_motors.gains_of(model, motors)
        dc_motors.set_gains(model, motors, kp, kd - kp * delay)
        added = kp * delay**2 / 2 - kd * delay
        model.dof_armature[dofs] += np.maximum(added, (LEAST_INERTIA - 1) * model.dof_M0[dofs])

    def warmth(self, torque: np.ndarray, row_s: np.ndarray, rows: Sequence[int]) -> np.ndarray:
        """Rise of the windings' resistance, as a share of it, at some rows of a log that begins cold.

        (chosen rows, joints), from the torque that was asked of the motors, N·m, (rows, joints), and the length of each
        row, s, (rows,). With the rise r, τ² heats by τ² / (1 + r), as the current falls.
        """
        heat = np.concatenate([np.zeros((1, torque.shape[1])), np.cumsum(torque**2 * row_s[:, None], axis=0)])
        time = np.concatenate([[0.0], np.cumsum(row_s)])
        rise, found, last = np.zeros(torque.shape[1]), [], 0
        for row in rows:
            cooled = np.exp((time[last] - time[row]) / (2 * COOLING_S))  # half of it before the heat, and half after
            rise = cooled * (np.sqrt((1 + cooled * rise) ** 2 + 2 * self.heating * (heat[row] - heat[last])) - 1)
            found.append(rise)
            last = row
        return np.array(found)

    def lagged(self, torque: np.ndarray, row_s: np.ndarray, rows: Sequence[int]) -> np.ndarray:
        """Torque of the motors at the beginning of some rows of a log, (chosen rows, joints), N·m.

        From the torque that was asked of them, N·m, (rows, joints), and the length of each row, s, (rows,).
        """
        kept = np.exp(-row_s[:, None] / np.maximum(self.lag_s, 1e-9))
        found = torque.copy()
        for row in range(1, len(torque)):
            found[row] = torque[row - 1] + kept[row - 1] * (found[row - 1] - torque[row - 1])
        return np.asarray(np.where(self.lag_s > 0, found, torque)[rows])

    def set_joint_pd(self, model: mujoco.MjModel, robot: Robot, kp: np.ndarray, kd: np.ndarray) -> None:
        """Set other gains that were sent (joints,) in a model that has these motors: N·m/rad, N·m·s/rad."""
        kp, kd = self.gains(kp, kd)
        late = kd - kp * self.delay_s
        for chosen, put in ((~self.electric, actuators.set_joint_pd), (self.electric, dc_motors.set_dc_joint_pd)):
            put(model, robot.joint_actuators[chosen], (kp * self.gain)[chosen], (late * self.gain)[chosen])
        self.split_joint_pd(model, robot)


def resistance_of(robot: Robot) -> float:
    """Resistance of the motors, V/(N·m); 1 where it is not stated, which has no influence without a voltage limit."""
    return 1.0 if robot.motors is None else robot.motors.resistance


def lacks_torque_limits(robot: Robot) -> str | None:
    """What a robot lacks for effects that refer to its largest torques; None where its model states all of them."""
    limits = robot.torque_limits[robot.driven]
    return None if len(limits) and np.isfinite(limits).all() else "limits of its torques"
