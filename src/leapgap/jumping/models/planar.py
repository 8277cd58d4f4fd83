"""Planar model of the robot for trajectory optimisation: five links, with left and right leg merged into one.

Masses and lengths are those of the published references, or read from a MuJoCo model.

The planner's angles are positive nose-down, and its joint angles *minus* those of a robot whose leg hangs straight
down at zero and swings by +y, like the A1's: a link's own angle against the vertical is the pitch less the joint
angles up to it. ``JointMap`` holds how a robot's own joints count.
"""

import copy
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field

import mujoco
import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.models.rigid_body import RigidBody, rigid_body_of
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS

PUBLISHED_SUPPLY_V = 21.5  # Voltage that the published planner reckons with; 1 V is 1 rad/s at a joint


@dataclass(frozen=True)
class PlanarLink:
    """A thigh, or a calf with its foot, of one leg."""

    mass: float  # kg
    length: float  # m, hip to knee or knee to foot
    com_down: float  # m, from the upper joint along the link to its centre of mass
    com_across: float  # m, across it: forward of a link that hangs straight down
    inertia: float  # kg·m² about the centre of mass


@dataclass(frozen=True)
class PlanarLeg:
    """One leg: position of its hip in the trunk, and its two links."""

    hip_x: float  # m, in the trunk
    hip_z: float
    thigh: PlanarLink
    calf: PlanarLink


@dataclass(frozen=True)
class JointMap:
    """Joint convention of a leg: robot's angle = sign × planner's angle + offset."""

    leg: str
    pair: str
    abduction: tuple[str, ...]  # Joints that stay at zero, where the leg moves in the plane
    pitch: tuple[str, str]  # Thigh and calf joint
    sign: tuple[float, float] = (-1.0, -1.0)
    offset: tuple[float, float] = (0.0, 0.0)  # rad
    foot: str = ""


def published_link(mass: float) -> PlanarLink:
    """A link of the published optimiser: a uniform box of 0.2 m by 0.092 m."""
    return PlanarLink(mass, 0.2, 0.1, 0.0, mass * (0.2**2 + 0.092**2) / 12)


def published_leg(hip_x: float) -> PlanarLeg:
    """A leg of the published optimiser, with its hip at ``hip_x``, m."""
    return PlanarLeg(hip_x, 0.0, published_link(0.403), published_link(0.166))


A1_JOINTS = tuple(
    JointMap(leg, pair, (f"{leg}_hip",), (f"{leg}_thigh", f"{leg}_calf"), foot=leg)
    for leg, pair in (("FR", "front"), ("FL", "front"), ("RR", "rear"), ("RL", "rear"))
)


@dataclass(frozen=True)
class PlanarRobot:
    """Parameters of the planar robot; the defaults are those of the published full-body optimiser of the A1.

    Source: model behind the published references (Nguyen et al., RA-L 2025, and the group's earlier
    jumping papers); voltage law and gearing: motor data published by the same group. Masses and inertias
    are of one leg, the dynamics take each leg twice.
    """

    name: str = "a1"
    trunk_mass: float = 9.593  # kg, with what moves with it while the legs stay in their planes
    trunk_com_x: float = 0.0  # m, in the trunk
    trunk_com_z: float = 0.0
    trunk_inertia: float = 9.593 * (0.366**2 + 0.114**2) / 12  # kg·m² about its centre of mass; of a uniform box
    front: PlanarLeg = field(default_factory=lambda: published_leg(0.183))
    rear: PlanarLeg = field(default_factory=lambda: published_leg(-0.183))
    foot_radius: float = 0.02  # m; the planner's feet are points, at the centres of the robot's spheres
    rolling_radius_m: float = 0.0  # Radius of feet that roll as the calf rotates, m; 0: point feet, as published
    armature: float = 0.128  # kg·m², inertia of the motors of a pair of joints, seen at the joint
    damping: float = 1.0  # N·m·s/rad, viscous, of a pair of joints
    gravity: float = 9.81  # m/s²
    speed_per_torque: float = 0.34602  # rad/s per N·m at a joint: R/(Kt gear)² × Kt gear, Kt 4/34, R = 25 Kt², gear 8.5
    no_load_speed: float = PUBLISHED_SUPPLY_V  # rad/s, since gear × Kt = 1; infinite: no torque-speed limit
    torque_limit: tuple[float, float] = (33.5, 33.5)  # N·m, of one thigh and one calf joint
    thigh_range: tuple[float, float] = (-4.1888, 1.047)  # rad, in the planner's sign
    calf_range: tuple[float, float] = (0.916, 2.697)
    joints: tuple[JointMap, ...] = A1_JOINTS

    @property
    def legs(self) -> tuple[PlanarLeg, PlanarLeg]:
        """The front and the rear leg."""
        return self.front, self.rear

    @property
    def wheelbase(self) -> float:
        """Distance from the rear to the front hips, m."""
        return self.front.hip_x - self.rear.hip_x

    @property
    def total_mass(self) -> float:
        """Mass of trunk and four legs, kg."""
        return self.trunk_mass + 2 * sum(leg.thigh.mass + leg.calf.mass for leg in self.legs)


def planar_robot(robot: Robot, model: mujoco.MjModel | None = None) -> PlanarRobot:
    """The robot of a MuJoCo model in its plane: masses, lengths, armature and damping read from the model.

    ``model`` is a changed version of the robot's own model; None: the model as in its file.

    Needs a free base and four legs with an abduction joint along x, then thigh and calf joints along y, mirrored left
    and right. The torque-speed limit is that of the motors whose constants the model file states, at the published
    supply voltage; a model without them has none.
    """
    found = " and ".join(f"{len(robot.limbs_of_pair.get(pair, ()))} legs {pair}" for pair in PAIRS)
    if not robot.has_free_base or found != "2 legs front and 2 legs rear":
        base = "a free base" if robot.has_free_base else "no free base"
        raise InputError(robot.path, f"{base}, {found}", "a free base, two legs front and two rear", "plan by hand")
    return PlanarReader(robot, robot.model if model is None else model).read()


class PlanarReader:
    """Reads a model in the pose of its file, with level trunk and all joints at zero."""

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.robot, self.model = robot, model
        self.data = mujoco.MjData(self.model)
        self.data.qpos[3:7] = [1, 0, 0, 0]
        self.data.qpos[robot.joint_qpos] = 0.0
        mujoco.mj_kinematics(self.model, self.data)
        self.origin = self.data.xpos[robot.base_body].copy()

    def read(self) -> PlanarRobot:
        """The planar robot with the parameters of this model."""
        robot = self.robot
        maps = tuple(self.joint_map(leg) for pair in PAIRS for leg in robot.limbs_of_pair[pair])
        jointed = {joint: self.model.jnt_bodyid[self.model.joint(joint).id] for m in maps for joint in m.pitch}
        carrier = self.carriers(set(jointed.values()))
        trunk_mass, trunk_com, trunk_inertia = self.composite_body(np.flatnonzero(carrier == robot.base_body))
        of_pair = {pair: [self.leg(m, jointed, carrier) for m in maps if m.pair == pair] for pair in PAIRS}
        dofs = [self.model.joint(joint).dofadr[0] for m in maps for joint in m.pitch]
        return PlanarRobot(
            name=robot.name,
            trunk_mass=trunk_mass,
            trunk_com_x=float(trunk_com[0] - self.origin[0]),
            trunk_com_z=float(trunk_com[2] - self.origin[2]),
            trunk_inertia=trunk_inertia,
            front=mean_leg(of_pair["front"]),
            rear=mean_leg(of_pair["rear"]),
            foot_radius=float(robot.foot_radius.mean()),
            rolling_radius_m=float(robot.foot_radius.mean()),
            armature=2 * float(self.model.dof_armature[dofs].mean()),
            damping=2 * float(self.model.dof_damping[dofs].mean()),
            gravity=-float(self.model.opt.gravity[2]),
            speed_per_torque=robot.motors.resistance if robot.motors else 0.0,
            no_load_speed=PUBLISHED_SUPPLY_V if robot.motors else float("inf"),
            torque_limit=tuple(min(self.torque_limit(m.pitch[i]) for m in maps) for i in (0, 1)),  # type: ignore[arg-type]
            thigh_range=self.joint_range(maps, 0),
            calf_range=self.joint_range(maps, 1),
            joints=maps,
        )

    def torque_limit(self, joint: str) -> float:
        """Largest torque of the joint's motor, N·m; infinite where the model has no limit."""
        return float(self.robot.torque_limits[self.robot.joints.index(joint)])

    def joint_range(self, maps: Sequence[JointMap], which: int) -> tuple[float, float]:
        """Range that all thigh (0) or calf (1) joints can reach, in the planner's sign, rad."""
        lower, upper = -np.inf, np.inf
        for m in maps:
            joint = self.model.joint(m.pitch[which]).id
            if self.model.jnt_limited[joint]:
                ends = sorted((self.model.jnt_range[joint] - m.offset[which]) * m.sign[which])
                lower, upper = max(lower, ends[0]), min(upper, ends[1])
        return float(lower), float(upper)

    def joint_map(self, leg: str) -> JointMap:
        """Names, signs and zeros of a leg's joints, from the directions of its links."""
        robot, model = self.robot, self.model
        names = [joint for joint in robot.joints if robot.limb_of(joint) == leg]
        axes = {name: self.data.xaxis[model.joint(name).id] for name in names}
        pitch = [name for name in names if abs(axes[name][1]) > 0.9]
        feet = [foot for foot in robot.feet if robot.limb_of(foot) == leg]
        if len(pitch) != 2 or len(feet) != 1:
            found = f"leg {leg} with {len(pitch)} joints along y and {len(feet)} feet"
            expected = "a thigh and a calf joint and a named sphere as foot"
            raise InputError(robot.path, found, expected, "name joints and feet by their leg, or plan by hand")
        hip, knee = (self.data.xanchor[model.joint(name).id] for name in pitch)
        foot = self.data.geom(feet[0]).xpos
        thigh_angle, calf_angle = angle_from_vertical(knee - hip), angle_from_vertical(foot - knee)
        turns = [float(np.sign(axes[name][1])) for name in pitch]
        # angle = at zero + turn × joint, of the calf against the thigh; planner's angle = −angle
        zeros = (thigh_angle, calf_angle - thigh_angle)
        return JointMap(
            leg,
            next(pair for pair in PAIRS if leg in robot.limbs_of_pair[pair]),
            tuple(name for name in names if name not in pitch),
            (pitch[0], pitch[1]),
            (-turns[0], -turns[1]),
            (snap_to_zero(-turns[0] * zeros[0]), snap_to_zero(-turns[1] * zeros[1])),
            feet[0],
        )

    def carriers(self, jointed: set[int]) -> np.ndarray:
        """For each body, the moving link that carries it: a thigh, a calf, or the base for all others, (bodies,)."""
        carrier = np.zeros(self.model.nbody, dtype=int)
        for body in range(1, self.model.nbody):
            base = body == self.robot.base_body or body in jointed
            carrier[body] = body if base else carrier[self.model.body_parentid[body]]
        return carrier

    def composite_body(self, bodies: Sequence[int] | np.ndarray) -> tuple[float, np.ndarray, float]:
        """Mass, kg, centre of mass in the world (3,), m, and pitch inertia about it, kg·m², of some bodies together."""
        mass = self.model.body_mass[bodies]
        centre = (mass[:, None] * self.data.xipos[bodies]).sum(axis=0) / mass.sum()
        inertia = 0.0
        for body, m in zip(bodies, mass, strict=True):
            axes = self.data.ximat[body].reshape(3, 3)
            arm = self.data.xipos[body] - centre
            inertia += (axes[1] ** 2 * self.model.body_inertia[body]).sum() + m * (arm[0] ** 2 + arm[2] ** 2)
        return float(mass.sum()), centre, float(inertia)

    def leg(self, joints: JointMap, jointed: dict[str, int], carrier: np.ndarray) -> PlanarLeg:
        """The planar leg: position of its hip, and lengths and masses of its links."""
        hip, knee = (self.data.xanchor[self.model.joint(name).id] for name in joints.pitch)
        foot = self.data.geom(joints.foot).xpos
        links = []
        for name, upper, lower in ((joints.pitch[0], hip, knee), (joints.pitch[1], knee, foot)):
            mass, centre, inertia = self.composite_body(np.flatnonzero(carrier == jointed[name]))
            along = (lower - upper)[[0, 2]]
            length = float(np.hypot(*along))
            down, arm = along / length, (centre - upper)[[0, 2]]
            across = np.array([-down[1], down[0]])  # forward, of a link that hangs straight down
            links.append(PlanarLink(mass, length, float(arm @ down), float(arm @ across), inertia))
        at = hip - self.origin
        return PlanarLeg(float(at[0]), float(at[2]), links[0], links[1])


def angle_from_vertical(along: np.ndarray) -> float:
    """Angle of a link about +y from straight down, rad, given the vector along it."""
    return float(np.arctan2(-along[0], -along[2]))


def snap_to_zero(angle: float) -> float:
    """An angle, rad, with rounding errors around zero removed."""
    return 0.0 if abs(angle) < 1e-9 else angle


def mean_leg(legs: Sequence[PlanarLeg]) -> PlanarLeg:
    """Mean of the left and the right leg, which are mirror images up to rounding in their files."""
    rows = [(leg.hip_x, leg.hip_z, *astuple(leg.thigh), *astuple(leg.calf)) for leg in legs]
    hip_x, hip_z, *links = np.mean(rows, axis=0).tolist()
    return PlanarLeg(hip_x, hip_z, PlanarLink(*links[:5]), PlanarLink(*links[5:]))


IN_PLANS = ("armature", "com_offset", "joint_damping", "leg_mass", "payload", "trunk_inertia")
"""Effects that plans can account for; the planar robot has no parameter for the others."""


def plannable(found: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that plans can account for."""
    return tuple(effect for effect in found if effect.name in IN_PLANS and effect.location == "all")


def unplannable_effects(found: Sequence[Effect]) -> list[str]:
    """The effects that plans cannot account for, each with its location, as text."""
    return [f"{effect.name} at {effect.location}" for effect in found if effect not in plannable(found)]


def planar_robot_with(robot: Robot, found: Sequence[Effect]) -> PlanarRobot:
    """The planar robot with effects; one that plans cannot account for is an ``InputError`` with its name."""
    return planar_robot(robot, model_with(robot, found))


def body_with(robot: Robot, found: Sequence[Effect], joint_pos: np.ndarray) -> RigidBody:
    """``rigid_body_of`` the robot with effects that plans can account for, at joint angles (joints,), rad."""
    return rigid_body_of(robot, joint_pos, model_with(robot, found))


def model_with(robot: Robot, found: Sequence[Effect]) -> mujoco.MjModel:
    """A copy of the robot's MuJoCo model with effects that plans can account for."""
    refused = unplannable_effects(found)
    if refused:
        do = "leave it out of the planned robot (effects.json); the simulation can have it"
        raise InputError("effects in planning", ", ".join(refused), f"one of {', '.join(IN_PLANS)}, at all", do)
    model = copy.copy(robot.model)
    for effect in found:
        effect.change_model(model, robot)
    return model
