"""Masses of the rigid bodies and links, their places, and the gravity that acts on them."""

import copy
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, MotorEffect, Parameter, addition, parameter, recompute_constants
from leapgap.effects.measurements import lean, rotated
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

LEAST_ARM_M = 1e-4  # a centre of mass nearer to its joint's axis than this has no direction away from it
LEAST_INERTIA = 0.1  # share of a link's smallest inertia that always stays
MARGIN = 1e-3
"""By how much the inertias of a body are within what bodies can have, so that a file with rounded numbers is, too."""


def links_at(robot: Robot, location: str) -> np.ndarray:
    """Bodies that the joints at a location move, each once, in the order of the model."""
    return np.unique(robot.joint_bodies[robot.joints_at(location)])


def joint_of_link(robot: Robot, body: int) -> int:
    """MuJoCo's index of the last joint that moves a link against its parent."""
    of_body = np.flatnonzero(robot.joint_bodies == body)
    return int(robot.model.dof_jntid[robot.joint_dofs[of_body[-1]]])


def arm_of_centre(robot: Robot, body: int) -> np.ndarray:
    """From a link's joint to its centre of mass, square to the axis of a hinge, m, (3,), in the link's axes."""
    model, joint = robot.model, joint_of_link(robot, body)
    away: np.ndarray = model.body_ipos[body] - model.jnt_pos[joint]
    if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE):
        away = away - (away @ model.jnt_axis[joint]) * model.jnt_axis[joint]
    return away


def outward(robot: Robot, body: int) -> np.ndarray:
    """Unit vector from a link's joint towards its centre of mass, (3,), in the link's axes.

    Where the centre lies on the axis, it is the one of the link's axes that is nearest to square to the joint's.
    """
    away = arm_of_centre(robot, body)
    length = float(np.linalg.norm(away))
    if length >= LEAST_ARM_M:
        return away / length
    axis = robot.model.jnt_axis[joint_of_link(robot, body)]
    square: np.ndarray = np.eye(3)[int(np.abs(axis).argmin())]
    square = square - (square @ axis) * axis
    return np.asarray(square / np.linalg.norm(square))


def along(robot: Robot, body: int) -> np.ndarray:
    """Unit vector from a link's joint through its centre of mass, (3,), in the link's axes; else the joint's axis."""
    joint = joint_of_link(robot, body)
    away: np.ndarray = robot.model.body_ipos[body] - robot.model.jnt_pos[joint]
    length = float(np.linalg.norm(away))
    return away / length if length >= LEAST_ARM_M else np.asarray(robot.model.jnt_axis[joint])


def jacobians(at: ForceContext, bodies: Sequence[int]) -> np.ndarray:
    """How the centres of mass of bodies move with the robot at each step, (steps, bodies, 3, nv), world axes."""
    model, found = at.model, np.empty((len(at.qpos), len(bodies), 3, at.model.nv))
    data = mujoco.MjData(model)
    for qpos, of_step in zip(at.qpos, found, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for body, of_body in zip(bodies, of_step, strict=True):
            mujoco.mj_jacBodyCom(model, data, of_body, None, body)
    return found


def add_mass(model: mujoco.MjModel, body: int, mass: float, moment: np.ndarray, inertia: np.ndarray) -> None:
    """Add mass to a body: kg, its first moment, kg·m, (3,), and its inertia, kg·m², (3, 3), about the body's centre.

    Axes are those of the body. Where more is taken away than a body can lose, its smallest inertia stays a tenth of its
    own and as large as the difference of the other two: no body, and no model file, has less.
    """
    whole = float(model.body_mass[body]) + mass
    model.body_mass[body] = whole
    if not (moment.any() or inertia.any()):
        return
    shift, axes = moment / whole, np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turn = axes.reshape(3, 3)
    about_centre = turn @ np.diag(model.body_inertia[body]) @ turn.T + inertia - whole * square_to(shift)
    values, vectors = np.linalg.eigh(about_centre)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    values = np.maximum(values, LEAST_INERTIA * model.body_inertia[body].min())
    if values[0] + values[1] < values[2]:
        values[0] = (values[2] - values[1]) * (1 + MARGIN)
    model.body_inertia[body] = values
    mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(vectors).ravel())
    move_centre(model, body, shift)


def square_to(away: np.ndarray) -> np.ndarray:
    """Inertia of one kilogram at a place (3,), m, seen from the origin, m², (3, 3)."""
    return np.asarray(away @ away * np.eye(3) - np.outer(away, away))


def move_centre(model: mujoco.MjModel, body: int, by: np.ndarray) -> None:
    """Move a body's inertial frame by (3,) m in the body's axes, its geoms staying where they are."""
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # a short cut where frames coincide
    model.geom_sameframe[model.geom_bodyid == body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
    model.body_ipos[body] += by


@dataclass(frozen=True)
class InertialEffect(Effect):
    """An effect that changes numbers of the rigid bodies, or of gravity, in the compiled model."""

    @abstractmethod
    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Change the numbers; at nominal parameters it is not asked for."""

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Change the numbers, and what MuJoCo derives from them."""
        if not self.is_nominal:
            self.change_bodies(model, robot)
            recompute_constants(model)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Less what the same motion needs of the changed bodies than of the nominal ones."""
        nominal, found = needed(at.model, at), []
        for effect, by in cls.small_departures(at.robot, location):
            model = copy.copy(at.model)
            effect.change_model(model, at.robot)
            found.append((nominal - needed(model, at)) / by)
        return np.array(found)


def needed(model: mujoco.MjModel, at: ForceContext) -> np.ndarray:
    """Generalised force that the motion needs of rigid bodies in gravity, (steps, nv), by inverse dynamics."""
    data, found = mujoco.MjData(model), np.empty(at.qvel.shape)
    for step in range(len(found)):
        data.qpos[:], data.qvel[:], data.qacc[:] = at.qpos[step], at.qvel[step], at.qacc[step]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, found[step])
    return found


@dataclass(frozen=True)
class ComOffset(InertialEffect):
    """Shift of the base body's centre of mass along its own axes: forward and up."""

    name = "com_offset"
    words = "centre-of-mass offset of the trunk"
    needs_base = True

    x_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)
    z_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the inertial frame of the base body, its geoms staying where they are."""
        move_centre(model, robot.base_body, np.array([self.x_m, 0.0, self.z_m]))


LARGEST_LOSS = 0.9
"""Share of the mass of the trunk, or of a link, that may be taken away; a moving body needs a positive mass."""


@dataclass(frozen=True)
class Payload(InertialEffect):
    """A point mass at the trunk's centre of mass; a negative one where the trunk is lighter than the model has it."""

    name = "payload"
    words = "payload at the trunk"
    needs_base = True

    mass_kg: float = parameter(0.0, "kg", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a trunk that weighs a tenth of the model's upwards."""
        (declared,) = super().parameters(robot, location)
        own = robot.model.body_mass[[robot.base_body]]
        added = addition(declared, own)
        return (replace(added, lower=-LARGEST_LOSS * float(own[0]), lower_is_physical=False),)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of the base body."""
        least = (1 - LARGEST_LOSS) * model.body_mass[robot.base_body]
        model.body_mass[robot.base_body] = max(model.body_mass[robot.base_body] + self.mass_kg, least)


@dataclass(frozen=True)
class TrunkInertia(InertialEffect):
    """Ratio of true to nominal rotational inertia of the base body about its centre of mass; its mass stays."""

    name = "trunk_inertia"
    words = "rotational inertia of the trunk"
    needs_base = True

    scale: float = parameter(1.0, "1", 0.3, 3.0, 1.5)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the inertia of the base body."""
        model.body_inertia[robot.base_body] *= self.scale


@dataclass(frozen=True)
class LegMass(InertialEffect):
    """Ratio of true to nominal mass and inertia of the links that the located joints move; shapes and centres stay.

    Robots whose base is held have no legs: there it is called ``link_mass``.
    """

    name = "leg_mass"
    words = "link mass error"
    other_names = ("link_mass",)
    places = "joints"

    scale: float = parameter(1.0, "1", 0.1, 2.0, 1.3)

    @classmethod
    def called(cls, robot: Robot) -> str:
        """Links are called legs on a robot with a free base."""
        return cls.name if robot.has_free_base else cls.other_names[0]

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale mass and inertia of the links and of the bodies fixed to them."""
        links = np.isin(model.body_weldid, robot.joint_bodies[robot.joints_at(self.location)])
        model.body_mass[links] *= self.scale
        model.body_inertia[links] *= self.scale


LEAST_RANGE_M, MODERATE_COM = 0.05, 0.2  # least limit of the search, and the noticeable value as a share of the limit


@dataclass(frozen=True)
class LinkCom(InertialEffect):
    """Shift of a link's centre of mass away from the axis of its joint; negative towards it, and beyond.

    A joint feels mass · g · shift of it. Mass and inertia about the centre stay.
    """

    name = "link_com"
    words = "centre-of-mass offset of the links"
    by_default = False
    places = "joints"

    outward_m: float = parameter(0.0, "m", -0.05, 0.05, 0.01, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """As far as the centre is from the axis, to either side, and at least 5 cm."""
        (declared,) = super().parameters(robot, location)
        arms = [float(np.linalg.norm(arm_of_centre(robot, int(body)))) for body in links_at(robot, location)]
        most = max(LEAST_RANGE_M, *arms)
        return (replace(declared, lower=-most, upper=most, moderate=MODERATE_COM * most),)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the inertial frames of the links."""
        for body in links_at(robot, self.location):
            move_centre(model, int(body), self.outward_m * outward(robot, int(body)))


@dataclass(frozen=True)
class LinkInertia(InertialEffect):
    """Ratio of true to nominal rotational inertia of links about their centres of mass; masses and centres stay."""

    name = "link_inertia"
    words = "rotational inertia of the links"
    by_default = False
    places = "joints"

    scale: float = parameter(1.0, "1", 0.1, 5.0, 1.5)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the inertia of the links that the located joints move."""
        model.body_inertia[links_at(robot, self.location)] *= self.scale


LARGEST_SHARES, MODERATE_SHARES = (3.0, 0.5), (0.3, 0.02)
"""Limit of the search and noticeable value: the larger of a share of the link's mass and of the robot's."""
FARTHEST_M, MODERATE_M = 0.3, 0.1  # limit of the search for the distance of a heavy payload, and a noticeable one
LIGHT = 0.1
"""A payload below this share of its link's mass adds less inertia than a point at moment / mass, and none at zero mass:
there a moment is a centre of mass that is elsewhere."""


@dataclass(frozen=True)
class LinkPayload(InertialEffect):
    """A point mass at the links that the located joints move; negative where they are lighter.

    It lies beyond the link's centre of mass, away from the joint, by ``moment_kg_m`` / ``mass_kg``. Gravity and inertia
    answer to the two numbers almost linearly, also where the mass is small, which they do not to a distance. Only
    what is added is looked for: lighter links are scaled ones (``leg_mass``).
    """

    name = "link_payload"
    words = "payload at a link"
    by_default = False
    places = "joints"

    mass_kg: float = parameter(0.0, "kg", -inf, inf, 0.2)
    moment_kg_m: float = parameter(0.0, "kg·m", -inf, inf, 0.02)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no mass upwards; the moment either way."""
        mass, moment = super().parameters(robot, location)
        own = robot.model.body_mass[links_at(robot, location)]
        whole = float(robot.model.body_mass[robot.bodies].sum())
        upper, moderate = (max(a * float(own.max()), b * whole) for a, b in (LARGEST_SHARES, MODERATE_SHARES))
        scale = float(own.mean())
        far = FARTHEST_M * upper
        return (
            replace(mass, lower=0.0, lower_is_physical=True, upper=upper, moderate=moderate, scale=scale),
            replace(moment, lower=-far, upper=far, moderate=MODERATE_M * moderate),
        )

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of each link, of which a tenth always stays."""
        for link in links_at(robot, self.location):
            own = float(model.body_mass[link])
            mass = max(self.mass_kg, -LARGEST_LOSS * own)
            inertia = self.moment_kg_m**2 * mass / max(mass**2, (LIGHT * own) ** 2)
            outward = along(robot, int(link))
            add_mass(model, int(link), mass, self.moment_kg_m * outward, inertia * square_to(outward))


@dataclass(frozen=True)
class GravityDirection(InertialEffect):
    """Gravity turned by a roll about the world's x axis, then a pitch about its y axis; its size stays.

    For a robot on a floor it is the same as a floor and a measuring frame that both lean the other way.
    """

    name = "gravity_direction"
    words = "tilt of gravity against the model's vertical"
    by_default = False

    roll_rad: float = parameter(0.0, "rad", -0.5, 0.5, 0.05)
    pitch_rad: float = parameter(0.0, "rad", -0.5, 0.5, 0.05)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Without gravity there is no direction of it."""
        return super().lacks(robot) or (None if np.any(gravity_of(robot.model)) else "gravity")

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Turn the gravity of the model."""
        model.opt.gravity = rotated(model.opt.gravity[None], lean(self.roll_rad, self.pitch_rad))[0]


LEAST_COMPENSATION = 1e-12  # MuJoCo compiles a compensation only where some body has one


@dataclass(frozen=True)
class GravityCompensation(MotorEffect):
    """Share of the weight of the links that the located joints move that the drive compensates, at all joints.

    MuJoCo's ``gravcomp``: the drive adds the torque that holds these weights, by the model, to what it is told, and its
    limit is that of the sum. It is added to what the model states, and may take that away. Links beyond a passive
    joint are not compensated.
    """

    name = "gravity_compensation"
    words = "gravity compensation missing from the log"
    by_default = False

    share: float = parameter(0.0, "1", 0.0, 1.2, 0.2, limits=(-inf, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Drives know the direction of gravity where the base is held."""
        if robot.has_free_base:
            return "a base that is held"
        if not np.any(gravity_of(robot.model)):
            return "gravity"
        return super().lacks(robot) or (None if len(carried(robot, "all")) else "links that motors alone hold")

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no compensation at all upwards."""
        (declared,) = super().parameters(robot, location)
        return (addition(declared, robot.model.body_gravcomp[carried(robot, location)]),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """What holds the weight of the links, where the motors are within their limits with it."""
        bodies = carried(at.robot, location).tolist()
        weights = at.model.body_mass[bodies, None] * gravity_of(at.model)
        held = -np.einsum("bi,sbij->sj", weights, jacobians(at, bodies))
        return at.at_motors("all", held[:, at.robot.joint_dofs] * at.within)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Let the links have a compensation, and the motors' limits hold for what they carry besides."""
        for body in carried(robot, self.location).tolist():
            spec.bodies[body].gravcomp = spec.bodies[body].gravcomp or LEAST_COMPENSATION
        motors = {motor.joint: motor for motor in robot.actuators if motor.driven}
        for joint in spec.joints:
            if joint.name in motors and not joint.actgravcomp:
                joint.actgravcomp = True
                if np.isfinite(limit := motors[joint.name].limit).any():
                    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
                    joint.actfrcrange = np.clip(limit, -mujoco.mjMAXVAL, mujoco.mjMAXVAL)
        for actuator in spec.actuators:
            if actuator.target in motors:
                actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the shares that the model has."""
        if not self.is_nominal:
            model.body_gravcomp[carried(robot, self.location)] += self.share


def carried(robot: Robot, location: str) -> np.ndarray:
    """Bodies of the links at a location that motors alone move, and what is fixed to them."""
    passive = set(robot.joint_bodies[~robot.driven].tolist())
    held: list[bool] = []
    for body, parent in enumerate(robot.model.body_parentid.tolist()):
        held.append(body not in passive and (body == 0 or held[parent]))
    moved = np.isin(robot.model.body_weldid, links_at(robot, location))
    return np.flatnonzero(moved & held)
