"""Friction, damping and rotor inertia at the joints, and torques that make up for friction."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import AddedToJoints, Effect, ForceContext, Load, MotorEffect, Parameter, parameter, widened
from leapgap.robot import actuators, dc_motors
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Armature(AddedToJoints):
    """Rotor inertia added to the model's own; a negative value takes some of it away, down to zero."""

    name = "armature"
    words = "reflected rotor inertia"
    model_field = "dof_armature"
    most = 0.004  # s²/rad

    inertia: float = parameter(0.0, "kg·m²", 0.0, 0.15, 0.02, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """A unit of inertia takes its share of the torque, against the acceleration."""
        return at.at_joints(location, -at.acceleration)


@dataclass(frozen=True)
class JointDamping(AddedToJoints):
    """Damping added to the model's own; negative values reduce it, down to zero."""

    name = "joint_damping"
    words = "viscous friction"
    model_field = "dof_damping"
    most = 0.1  # s/rad

    damping: float = parameter(0.0, "N·m·s/rad", 0.0, 4.0, 0.4, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """A unit of damping acts against the velocity, in proportion to it."""
        return at.at_joints(location, -at.velocity)


STILL_RAD_S = 0.01  # speed below which a joint that starts or stops is between both directions


@dataclass(frozen=True)
class JointFriction(AddedToJoints):
    """Friction torque of the gears added to the model's own; negative values reduce it, down to zero."""

    name = "joint_friction"
    words = "joint Coulomb friction"
    model_field = "dof_frictionloss"
    most = 0.15

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the motion as MuJoCo's soft constraint sees it, which looks ahead by half its time constant.

        A joint that stands is held by what pushes it, so that its force is not known.
        """
        dofs = at.robot.joint_dofs
        ahead_s = np.maximum(at.model.dof_solref[dofs, 0], 0.0) * at.model.dof_solimp[dofs, 1] / 2
        return at.at_joints(location, -np.tanh((at.velocity + ahead_s * at.acceleration) / STILL_RAD_S))


@dataclass(frozen=True)
class QuadraticDamping(AddedToJoints):
    """Torque −coefficient · |q̇| q̇ added to the model's own (MuJoCo's polynomial damping), down to none of it."""

    name = "quadratic_damping"
    words = "quadratic friction"
    by_default = False
    model_field = "dof_dampingpoly"

    coefficient: float = parameter(0.0, "N·m·s²/rad²", 0.0, 1.0, 0.05, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity, by its square."""
        return at.at_joints(location, -np.abs(at.velocity) * at.velocity)


LARGEST_SHARE, MODERATE_SHARE = 0.05, 0.01
"""Limit of the search and noticeable value, as shares of the largest torque of the motors."""
FADES_RAD_S = 0.02  # below such speeds the torque fades out, as controllers let it lest it chatter


@dataclass(frozen=True)
class FrictionCompensation(MotorEffect):
    """Torque that motors add along the measured joint velocity, on top of the logged command."""

    name = "friction_compensation"
    words = "friction compensation missing from the log"
    by_default = False

    torque_nm: float = parameter(0.0, "N·m", 0.0, 2.0, 0.2, limits=(-np.inf, np.inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Shares of the motors' largest torque, where the model states one."""
        (declared,) = super().parameters(robot, location)
        declared, most = replace(declared, lower_is_physical=True), robot.largest_torque(location)
        return (
            declared if most is None else replace(declared, upper=LARGEST_SHARE * most, moderate=MODERATE_SHARE * most),
        )

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """A unit of torque acts along the measured motion, where the motor is within its limit."""
        return at.at_motors(location, at.within * np.tanh(at.velocity / FADES_RAD_S))

    def torque_by_velocity(self, velocity: np.ndarray, robot: Robot) -> np.ndarray | None:
        """Along the motion, as large at every speed at which the joint clearly moves."""
        if self.is_nominal:
            return None
        at = [joint for joint in robot.joints_at(self.location) if robot.driven[joint]]
        torque = np.zeros_like(velocity)
        torque[:, at] = self.torque_nm * np.tanh(velocity[:, at] / FADES_RAD_S)
        return torque


CREEP_RAD_S = 0.05
"""Speed below which the friction is viscous; a joint under load that should stand creeps at less than that."""


@dataclass(frozen=True)
class LoadFriction(MotorEffect):
    """Friction −share · |τ| · tanh(q̇ / 0.05 rad/s) of a joint whose motor gives τ, beside the model's own friction.

    A gear of efficiency 1 − share: the motor's torque comes through weaker where it drives the joint and stronger where
    it brakes it. MuJoCo has no friction that follows a load. So a replay takes the torque τ (joint PD and limits
    included) and the velocity from its log, and its own velocity where it matters: about each row's velocity the law
    is a straight line, a torque and a damping that change from row to row. A replay that follows its log is exact; one
    that turns round at other times than the log has the friction of the log's direction there. Logs that are made in
    open loop take both from their plan; a closed loop takes its own at every tick. A joint at rest creeps, as the
    friction fades out with its speed; with explicit integrators it creeps faster where steps are long for the joint.
    """

    name = "load_friction"
    words = "load-dependent friction"
    by_default = False

    share: float = parameter(0.0, "1", 0.0, 0.6, 0.1, limits=(0.0, 1.0))

    def _parts(self, robot: Robot) -> Iterator[tuple[int, str, str]]:
        """Joint, and names of its two actuators: a torque and a damper."""
        for i in robot.joints_at(self.location):
            if robot.driven[i]:
                where = f"at {self.location} of {robot.joints[i]}"
                yield int(i), f"{self.name} {where}", f"damping of {self.name} {where}"

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the motion, by the torque."""
        return at.at_motors(location, -np.abs(at.torque) * np.tanh(at.velocity / CREEP_RAD_S))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the torque and the damper of each joint that a motor drives."""
        for joint, push, damper in self._parts(robot):
            actuators.add_brake(spec, robot.joints[joint], push, damper)

    def put_controls(self, control: np.ndarray, load: Load, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the torque and the damping of each joint by its load."""
        if self.is_nominal:
            return
        joints, *names = zip(*self._parts(robot), strict=True)
        at = list(joints)
        push, damper = (actuators.controls_of(model, of) for of in names)
        most = actuators.largest_damping(model, robot.joint_dofs[at], load.step_s)
        friction, speed = self.share * np.abs(load.torque[:, at]), load.velocity[:, at]
        faded = np.tanh(speed / CREEP_RAD_S)
        slope = np.minimum(friction / CREEP_RAD_S * (1 - faded**2), most)
        control[:, push], control[:, damper] = slope * speed - friction * faded, slope


STRIBECK_RAD_S = 0.1  # speed over which the holding torque falls off as exp(−(q̇/v)²): that of greased gears
DEFLECTION_RAD = 0.005  # deflection of the teeth at which a joint breaks loose
BRISTLE_DAMPING_S = 0.002
"""Damping of the deflection, as a time: what it adds to the friction is that time times the stiffness."""
MOST_SHARE = 0.15
"""Upper end of the search, as a share of the largest torque of the motors, if that is more than declared."""
SLIDING = 1e-3
"""Friction that is left at speed, as a share of the holding torque; the model's own friction stays beside it."""


@dataclass(frozen=True)
class StaticFriction(Effect):
    """Torque that holds a joint at rest beyond the model's own friction, and vanishes above 0.1 rad/s.

    The LuGre model (Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995) of MuJoCo's DC motor, in a passive
    actuator beside the joint's own. A motion starts with the teeth as far as its speed has dragged them.
    """

    name = "static_friction"
    words = "static friction (stiction)"
    by_default = False
    places = "joints"
    along_joints = True

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Up to a share of the motors' largest torque."""
        (declared,) = super().parameters(robot, location)
        return (widened(declared, robot, location, MOST_SHARE),)

    def _parts(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Joint and name of its passive actuator."""
        for i in robot.joints_at(self.location):
            yield robot.joints[i], f"{self.name} at {self.location} of {robot.joints[i]}"

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add a passive actuator to each joint that the friction acts at."""
        for joint, part in self._parts(robot):
            dc_motors.add_passive_friction(spec, joint, part)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the size of the friction."""
        if self.is_nominal:
            return
        friction = (SLIDING * self.torque_nm, self.torque_nm, STRIBECK_RAD_S)
        stiffness = self.torque_nm / DEFLECTION_RAD
        for _, part in self._parts(robot):
            actuator = model.actuator(part).id
            dc_motors.set_lugre_friction(model, actuator, stiffness, BRISTLE_DAMPING_S * stiffness, friction)
