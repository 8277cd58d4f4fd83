"""Motors that deliver other torques than are asked of them: gains, limits, lag, heat, voltage of the supply."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, inf

import mujoco
import numpy as np

from leapgap.effects.base import DriveEffect, Effect, ForceContext, Load, MotorEffect, Parameter, parameter
from leapgap.effects.drive import Drive, lacks_torque_limits, resistance_of
from leapgap.errors import InputError
from leapgap.robot import actuators, dc_motors
from leapgap.robot.actuators import RESISTANCE, TOP_SPEED, MotorConstants
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TorqueGain(DriveEffect):
    """Ratio of delivered to commanded torque: feed-forward, joint PD and limit are all scaled."""

    name = "torque_gain"
    drive_field = "gain"
    words = "motor torque gain"

    scale: float = parameter(1.0, "1", 0.3, 1.5, 0.85)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """All that the motors give."""
        return at.at_motors(location, at.torque)


@dataclass(frozen=True)
class TorqueLimit(DriveEffect):
    """Ratio of the motors' largest torque to the model's; what is asked for below it is delivered as before."""

    name = "torque_limit"
    drive_field = "limit_scale"
    words = "motor torque limit"
    by_default = False

    scale: float = parameter(1.0, "1", 0.02, 5.0, 0.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Without any stated limit there is nothing to scale."""
        stated = np.isfinite(robot.torque_limits[robot.driven]).any()
        return super().lacks(robot) or (None if stated else "limits of its torques")

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """What the motors give at their limits."""
        return at.at_motors(location, at.torque * (1 - at.within))


@dataclass(frozen=True)
class PositionGain(DriveEffect):
    """Ratio of the stiffness with which a joint PD acts to the logged ``cmd_kp``; feed-forward and limits stay.

    Where no position gain is logged there is nothing to scale.
    """

    name = "position_gain"
    drive_field = "kp_scale"
    words = "position gain (kp) of the joint PD"
    by_default = False
    in_controller = True

    scale: float = parameter(1.0, "1", 0.02, 50.0, 1.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The part of stiffness in the joint PD."""
        return at.at_motors(location, at.within * at.kp * (at.commands.position - at.position))


@dataclass(frozen=True)
class VelocityGain(DriveEffect):
    """Ratio of the damping with which a joint PD acts to the logged ``cmd_kd``; feed-forward and limits stay.

    Where no velocity gain is logged there is nothing to scale, and a drive's damping is a ``joint_damping``.
    """

    name = "velocity_gain"
    drive_field = "kd_scale"
    words = "velocity gain (kd) of the joint PD"
    by_default = False
    in_controller = True

    scale: float = parameter(1.0, "1", 0.02, 50.0, 1.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The part of damping in the joint PD."""
        return at.at_motors(location, at.within * at.kd * (at.commands.velocity - at.velocity))


@dataclass(frozen=True)
class MotorLag(DriveEffect):
    """First-order lag between commanded torque, joint PD included, and delivered torque, T τ̇ = τ_commanded − τ.

    Integrated exactly over each step with the command held. Torque limits act on what is delivered, after the lag.
    A motion starts with the torque that its first command asks for.
    """

    name = "motor_lag"
    drive_field = "lag_s"
    words = "motor lag (first order)"

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.15, 0.005)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The torque is late."""
        return at.at_motors(location, at.late(at.torque))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the motors their torque as a state."""
        motors = [robot.joint_actuators[i] for i in robot.joints_at(self.location) if robot.driven[i]]
        dc_motors.add_dc_state(spec, np.array(motors, int), resistance_of(robot))


@dataclass(frozen=True)
class VelocityFilter(DriveEffect):
    """First-order low-pass in front of the damper of the joint PD, T v̇_f = q̇ − v_f with τ = kp e + kd (q̇* − v_f).

    Drives differentiate their encoders and smooth the result. The position is fed back at once, as are the commands.
    Integrated exactly over each step with the velocity held; a motion starts with v_f = q̇. A limit of the motors'
    voltage (``torque_speed_limit``) acts on the torque without its damper.
    """

    name = "velocity_filter"
    drive_field = "filter_s"
    words = "low-pass filter on the velocity feedback"
    in_controller = True
    by_default = False
    beside_clock = True

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.01, 0.001)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The damper misses the newest change of the velocity."""
        return at.at_motors(location, at.within * at.kd * at.acceleration)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the joints the actuators of their dampers."""
        joints = [robot.joints[i] for i in robot.joints_at(self.location) if robot.driven[i]]
        known = {actuator.name for actuator in spec.actuators}
        missing = [joint for joint in joints if dc_motors.filter_of(joint) not in known]
        dc_motors.add_filtered_dampers(spec, missing, resistance_of(robot))


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
    words = "torque loss as motors heat"
    by_default = False

    loss_per_s: float = parameter(0.0, "1/s", 0.0, 20.0, 1.0, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The loss is that under the largest torque, which the model states."""
        return super().lacks(robot) or lacks_torque_limits(robot)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the motors that have a limit their warmth as a state."""
        limited = robot.driven & np.isfinite(robot.torque_limits)
        motors = [robot.joint_actuators[i] for i in robot.joints_at(self.location) if limited[i]]
        dc_motors.add_dc_heat(spec, np.array(motors, int), resistance_of(robot))

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the motors' heating."""
        at = robot.joints_at(self.location)
        return drive.added(
            "heating", at, np.where(robot.driven[at], self.loss_per_s / robot.torque_limits[at] ** 2, 0.0)
        )


@dataclass(frozen=True)
class DutyLimit(MotorEffect):
    """Share of a motor's largest torque that is lost per rad/s of its joint, by a duty cycle that cannot exceed 1.

    The torque obeys −τ_max (1 + c q̇) ≤ τ ≤ τ_max (1 − c q̇), with τ_max of the model: a straight line from the stall
    torque to the no-load speed 1 / c. It is the law of ``torque_speed_limit`` with the resistance 1 / (c τ_max), for
    robots that state no constants of their motors.
    """

    name = "duty_limit"
    words = "torque-speed limit (duty cycle)"
    by_default = False

    droop_s_rad: float = parameter(0.0, "s/rad", 0.0, 3.0, 0.05, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The line ends at a stated torque, and motors of stated constants have a law of their own."""
        stated = None if robot.motors is None else "motors without stated constants (see torque_speed_limit)"
        return super().lacks(robot) or stated or lacks_torque_limits(robot)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """At the limits, what a speed along the torque takes of them."""
        along = np.maximum(at.torque * at.velocity, 0.0) * np.sign(at.torque)
        return at.at_motors(location, -(1 - at.within) * along)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Bound the voltage of the motors at the no-load speed."""
        if self.is_nominal:
            return drive
        voltage, resistance = drive.voltage_v.copy(), drive.resistance.copy()
        at = robot.joints_at(self.location)
        at = at[np.isfinite(robot.torque_limits[at])]
        voltage[at], resistance[at] = 1 / self.droop_s_rad, 1 / (self.droop_s_rad * robot.torque_limits[at])
        return replace(drive, voltage_v=voltage, resistance=resistance)


@dataclass(frozen=True)
class TorqueSpeedLimit(MotorEffect):
    """The delivered torque obeys |R τ + q̇| ≤ voltage (τ N·m, q̇ rad/s, at the joint), beside the model's own limit of τ.

    R is the resistance of the robot's motors (``MotorConstants``); a robot that does not state it cannot have this
    effect. Beyond the speed at which no torque is left the motor brakes. The nominal robot has no voltage limit. In a
    fit its nominal value is the smallest whole voltage that allows full torque at the joints' top speed.
    """

    name = "torque_speed_limit"
    words = "voltage limit of the motors"

    voltage_v: float | None = parameter(None, "V", 0.0, inf, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The law needs the resistance of the motors."""
        return super().lacks(robot) or ("constants of its motors" if robot.motors is None else None)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From 10/33 of the nominal voltage, which limits nothing, up to it; 16/33 of it is moderate."""
        torque = float(torque_limits(robot)[robot.joints_at(location)].max())
        motors = stated_motors(robot)
        ample = float(ceil(motors.resistance * torque + motors.top_speed_rad_s))
        unit = cls.declarations()["voltage_v"].unit
        return (Parameter("voltage_v", unit, ample, ample * 10 / 33, ample, ample * 16 / 33, ample),)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Bound the voltage of the motors."""
        if self.voltage_v is None or self.is_nominal_for(robot):
            return drive
        voltage = drive.voltage_v.copy()
        at = robot.joints_at(self.location)
        voltage[at] = np.minimum(voltage[at], self.voltage_v)
        return replace(drive, voltage_v=voltage)


def torque_limits(robot: Robot) -> np.ndarray:
    """Largest torque of each joint's motor by the model, N·m, (joints,).

    Where the model states none: the stall torque at the voltage of the motor's top speed.
    """
    motors = stated_motors(robot)
    return np.where(np.isfinite(robot.torque_limits), robot.torque_limits, motors.top_speed_rad_s / motors.resistance)


def stated_motors(robot: Robot) -> MotorConstants:
    """Constants of the motors; ``InputError`` where nobody states them."""
    if robot.motors is None:
        expected = f"the custom numbers {RESISTANCE} and {TOP_SPEED}"
        do = "add them to the model file (docs/reference/log_format.md), or leave torque_speed_limit out"
        raise InputError(robot.path, "no constants of the motors", expected, do)
    return robot.motors


@dataclass(frozen=True)
class SupplySag(Effect):
    """Share of each motor's torque that is lost when all of them give their largest: τ (1 − sag · mean |τ| / τ_max).

    The voltage falls by the sum of the currents, which are as the shares of the model's limits that are asked for, and
    drives that set a duty cycle do not make up for it; those that control a current do until their voltage ends
    (``torque_speed_limit``). A model may state limits far above what the motors ever give together, so that the sag at
    its limits can be above 1; no torque turns round by it. A replay takes the torques from its log's commands and
    motion, a closed loop its own.
    """

    name = "supply_sag"
    words = "supply voltage sag under load"
    by_default = False
    needs_motor = True

    sag: float = parameter(0.0, "1", 0.0, 6.0, 0.2, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The load is a share of the largest torques, which the model states."""
        return super().lacks(robot) or lacks_torque_limits(robot)

    def _parts(self, robot: Robot) -> Iterator[tuple[int, str]]:
        """Joint that a motor drives, and name of the actuator that takes torque away."""
        for i in np.flatnonzero(robot.driven):
            yield int(i), f"{self.name} at {robot.joints[i]}"

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """By what all motors give."""
        driven = at.robot.driven
        load = np.abs(at.torque[:, driven]) / at.robot.torque_limits[driven]
        return at.at_motors(location, -at.torque * load.mean(axis=1, keepdims=True))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add an actuator beside each motor."""
        for joint, part in self._parts(robot):
            actuators.add_push(spec, robot.joints[joint], part)

    def put_controls(self, control: np.ndarray, load: Load, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the share away."""
        if self.is_nominal:
            return
        joints, names = zip(*self._parts(robot), strict=True)
        torque = load.torque[:, list(joints)]
        work = np.mean(np.abs(torque) / robot.torque_limits[list(joints)], axis=1, keepdims=True)
        control[:, actuators.controls_of(model, names)] = -np.minimum(1.0, self.sag * work) * torque
