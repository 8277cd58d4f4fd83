"""The MuJoCo model of a robot, with names and indices of its parts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.actuators import (
    SINGLE,
    JointActuator,
    MotorConstants,
    actuators_of,
    check_joint_pd,
    motors_of,
    replace_actuators,
)
from leapgap.robot.mjcf import hash_model
from leapgap.robot.model_file import (
    compile_spec,
    discard_visual,
    gravity_of,
    is_urdf,
    keep_inertia_changeable,
    model_file,
    read_spec,
)
from leapgap.robot.terrain import Box, ground_geoms
from leapgap.robot.topology import Feet, PartNames, Topology, feet_of, indices, name_contacts, topology_of

DEFAULT_MODEL = Path(__file__).with_name("a1.xml")
OTHER_DESCRIPTION = "a1_2020.xml"
"""Beside it, the maker's description of 2020, for ``diagnose.robots``; a name in code is what stages depend on."""
ROOTED_M = 0.5
"""Blocks reach this far below the floor. A soft foot that sinks past the middle of a thin box would be pushed out at
its underside."""
EARTH, USUAL_GRAVITY = np.array([0.0, 0.0, -9.81]), 0.05
"""Gravity at the ground, and largest departure from it that is not worth a note, m/s²."""
DOWNWARDS, LEAST_GRAVITY = 0.7, 0.1
"""Least share of the gravity of a free base that points down, and least gravity, m/s²."""
PARKED_BELOW_FLOOR_M = 50.0
LEVEL = 1 - 1e-6  # cosine of the largest slope of a level floor


@dataclass(frozen=True)
class Robot:
    """A robot as a model file describes it: hinge and slide joints, feet, maybe a free base.

    The file is an MJCF as its makers publish it, or a URDF. Whatever actuators it has, the model here has one torque
    actuator at each joint (``robot.actuators``). Limbs, groups and feet come from the tree of its bodies, or from the
    user's ``names``.
    """

    path: Path
    stated_motors: MotorConstants | None = None
    """Constants of the motors in place of those that the model file states."""
    names: PartNames | None = field(default=None, compare=False)
    """The user's names of its parts; None: by the tree of its bodies."""
    fix_base: bool | None = None
    """True: a floating robot is held at the pose of its model file. False: a robot of a URDF floats. None: as the
    file has it."""
    unstopped: tuple[str, ...] = ()
    """Joints whose range in the file has no stops at its ends (``logs.reach``)."""

    @staticmethod
    def load(
        path: Path | str = DEFAULT_MODEL,
        motors: MotorConstants | None = None,
        names: PartNames | None = None,
        fix_base: bool | None = None,
    ) -> "Robot":
        """Read and compile a model file; ``InputError`` where it is invalid or cannot be replayed.

        ``menagerie:<name>`` is a robot of MuJoCo Menagerie (``robot.model_file``).
        """
        robot = Robot(model_file(path), motors, names, fix_base)
        robot.check()
        return robot

    def check(self) -> None:
        """Raise ``InputError`` for a robot that cannot be replayed; at the end, each joint PD is tried."""
        free = [j for j in range(self.model.njnt) if self.model.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_FREE)]
        balls = [j for j in range(self.model.njnt) if self.model.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_BALL)]
        if free not in ([], [0]) or balls:
            bodies = ", ".join(self.model.body(self.model.jnt_bodyid[j]).name or "(no name)" for j in (*free, *balls))
            raise InputError(
                self.path,
                f"free or ball joints of the bodies {bodies}",
                "at most one free joint, the base's and the first of all; other joints turn or slide about one axis",
                "leave loose objects out of the model, and put the robot first",
            )
        # Refuse a free base without gravity, or with one that does not point down
        x, y, z = gravity = gravity_of(self.model)
        if self.has_free_base and not -z >= DOWNWARDS * max(float(np.linalg.norm(gravity)), LEAST_GRAVITY):
            found = f"gravity ({x:g}, {y:g}, {z:g}) m/s² for a robot with a free base"
            do = "correct option gravity and its flag, or hold the base (fix_base)"
            raise InputError(self.path, found, "gravity along −z: the world of a log has z up", do)
        if not self.driven.any() and not self.is_free_body:
            found = f"no actuator at {', '.join(self.joints) or 'any joint'}"
            raise InputError(self.path, found, "an actuator at every joint that is commanded", "add the actuators")
        _ = self.topology  # names that this robot has not are told now, whoever needs its limbs and feet
        if not self.is_free_body:
            check_joint_pd(self.model, self.joint_actuators, self.actuators, self.path)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model, with one actuator at each joint. Shared: copy it before changing anything."""
        spec = self.spec()
        keep_inertia_changeable(spec)
        return compile_spec(spec, self.path)

    def published_spec(self) -> mujoco.MjSpec:
        """Specification of the model file with the actuators of its makers; a fresh one at each call."""
        spec = read_spec(self.path, self.fix_base)[0]
        for joint in spec.joints:
            if joint.name in self.unstopped:
                joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        return spec

    def spec(self) -> mujoco.MjSpec:
        """Specification of the model, with one actuator at each joint; a fresh one at each call."""
        spec = self.published_spec()
        replace_actuators(spec, self.actuators)
        name_contacts(spec, self.names.feet if self.names else ())
        return spec

    @property
    def actuators(self) -> tuple[JointActuator, ...]:
        """What the model file says of the motor of each joint, in the order of the joints."""
        return self._reading[0]

    @property
    def states_actuators(self) -> bool:
        """Whether the model file says which joints have motors; a URDF does not, and any of its joints may have one."""
        return self._reading[2]

    @cached_property
    def without_shapes(self) -> mujoco.MjModel:
        """The compiled model for inverse dynamics. Shared: copy it, which takes no time.

        There is a dot in place of each mesh, with the masses that the meshes gave. The model of a URDF whose links
        MuJoCo joins stays as it is.
        """
        spec = self.spec()
        if len(spec.bodies) != self.model.nbody:
            return self.model
        keep_inertia_changeable(spec)
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        for body, number in zip(spec.bodies, range(self.model.nbody), strict=True):
            body.explicitinertial, body.fullinertia = True, np.full(6, np.nan)
            body.mass, body.ipos = self.model.body_mass[number], self.model.body_ipos[number]
            body.iquat, body.inertia = self.model.body_iquat[number], self.model.body_inertia[number]
        for geom in spec.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, "", [0.01, 0.01, 0.01]
        discard_visual(spec, self.path)
        return spec.compile()

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what of the model file is left out or changed."""
        notes, ground = self._reading[1], ground_geoms(self.model)
        touched = (self.model.geom_contype[ground] | self.model.geom_conaffinity[ground]).any()
        if self.has_free_base and not touched:
            notes = (*notes, "the model has no ground: the robot falls freely (a scene file may add the floor)")
        x, y, z = gravity = gravity_of(self.model)
        if np.abs(gravity - EARTH).max() > USUAL_GRAVITY:
            notes = (*notes, f"gravity is ({x:g}, {y:g}, {z:g}) m/s², not 9.81 m/s² downwards")
        return notes

    @cached_property
    def step_and_integrator(self) -> str:
        """How the model file has itself simulated, as a sentence: MuJoCo's default where it states nothing."""
        option = self.model.opt
        integrator = mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_")
        return f"simulated in steps of {1e3 * option.timestep:g} ms with the integrator {integrator}, by the model file"

    @cached_property
    def _reading(self) -> tuple[tuple[JointActuator, ...], tuple[str, ...], bool]:
        spec, notes = read_spec(self.path, self.fix_base)
        stated = len(spec.actuators) > 0 or not is_urdf(self.path.read_text(encoding="utf-8", errors="replace"))
        discard_visual(spec, self.path)  # meshes that only show take most of the time
        motors, on_motors = actuators_of(compile_spec(spec, self.path), self.path, all_driven=not stated)
        return motors, (*notes, *on_motors), stated

    @cached_property
    def ground_height(self) -> float:
        """Height of the level floor, m: the highest horizontal plane that feet may touch, 0 without one."""
        model, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_kinematics(model, data)
        planes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
        planes &= np.isin(np.arange(model.ngeom), ground_geoms(model))
        level = planes & (model.geom_contype | model.geom_conaffinity).astype(bool) & (data.geom_xmat[:, 8] > LEVEL)
        return float(data.geom_xpos[level, 2].max()) if level.any() else 0.0

    @cached_property
    def motors(self) -> MotorConstants | None:
        """Constants of the motors, as stated beside the model file or in it; None where not stated."""
        return self.stated_motors or motors_of(self.model)

    @cached_property
    def sha256(self) -> str:
        """Hash of the compiled model, included files and meshes with it: exported networks and reports carry it.

        It includes motors stated beside the file, so that robots with different motors have different hashes.
        """
        return hash_model(self.model, self.stated_motors)

    @cached_property
    def name(self) -> str:
        """Name of the model, as in its file."""
        return self.model.names.split(b"\0", 1)[0].decode()

    @cached_property
    def has_free_base(self) -> bool:
        """Whether the first joint is free: a floating-base robot."""
        return bool(self.model.njnt > 0 and self.model.jnt_type[0] == int(mujoco.mjtJoint.mjJNT_FREE))

    @property
    def stands(self) -> bool:
        """Whether it may stand: it has feet, and its base is not held."""
        return bool(self.feet) and self.has_free_base

    @property
    def is_free_body(self) -> bool:
        """Whether it is one body that flies, falls and slides, without joints and motors."""
        return self.has_free_base and self.model.njnt == 1

    @cached_property
    def _joint_ids(self) -> np.ndarray:
        return np.flatnonzero(np.isin(self.model.jnt_type, SINGLE))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the hinge and slide joints, driven and passive, in the order of the model."""
        return tuple(self.model.joint(j).name for j in self._joint_ids)

    @cached_property
    def turning(self) -> np.ndarray:
        """Whether each joint turns, in rad; the others slide, in m. Bool, (joints,)."""
        return self.model.jnt_type[self._joint_ids] == int(mujoco.mjtJoint.mjJNT_HINGE)

    @cached_property
    def joint_qpos(self) -> np.ndarray:
        """Where each joint's position stands in ``qpos``, shape (joints,)."""
        return self.model.jnt_qposadr[self._joint_ids]

    @cached_property
    def joint_dofs(self) -> np.ndarray:
        """Where each joint's velocity stands in ``qvel``, shape (joints,)."""
        return self.model.jnt_dofadr[self._joint_ids]

    @cached_property
    def joint_bodies(self) -> np.ndarray:
        """The link that each joint moves, shape (joints,)."""
        return self.model.jnt_bodyid[self._joint_ids]

    @cached_property
    def joint_actuators(self) -> np.ndarray:
        """The actuator of each joint, shape (joints,)."""
        of_joint = {int(joint): actuator for actuator, joint in enumerate(self.model.actuator_trnid[:, 0])}
        return np.array([of_joint[int(joint)] for joint in self._joint_ids], dtype=int)

    @cached_property
    def driven(self) -> np.ndarray:
        """Whether a motor drives each joint, bool, (joints,); a passive joint moves and is logged, without commands."""
        return np.array([motor.driven for motor in self.actuators], dtype=bool)

    @cached_property
    def driven_joints(self) -> tuple[str, ...]:
        """Names of the joints that a motor drives."""
        return tuple(motor.joint for motor in self.actuators if motor.driven)

    @cached_property
    def torque_limits(self) -> np.ndarray:
        """Largest torque of each joint's motor, N·m (N for slides), shape (joints,); infinite where none is stated."""
        return np.array([max(abs(end) for end in motor.limit) for motor in self.actuators])

    def largest_torque(self, location: str) -> float | None:
        """Largest torque that the model states of the motors at some joints, N·m; None where it states none."""
        limits = self.torque_limits[self.joints_at(location)]
        stated = limits[np.isfinite(limits)]
        return float(stated.max()) if len(stated) else None

    @cached_property
    def topology(self) -> Topology:
        """Limbs, groups, feet and pairs."""
        joints = dict(zip(self.joints, self._joint_ids.tolist(), strict=True))
        return topology_of(self.model, joints, self.base_body, self.has_free_base, self.names)

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the feet, in the order of the model: what the user named, else spheres that may touch the ground."""
        return self.topology.feet

    @cached_property
    def foot_shapes(self) -> Feet:
        """Where the feet are and what of them touches the ground."""
        return feet_of(self.model, self.feet)

    @property
    def foot_geoms(self) -> np.ndarray:
        """Index of the geom of each foot that touches the ground, shape (feet,)."""
        return self.foot_shapes.geoms

    @property
    def foot_geom_names(self) -> tuple[str, ...]:
        """Names of those geoms, which hold in models with terrain or other parts too."""
        return tuple(self.model.geom(geom).name for geom in self.foot_geoms)

    @property
    def foot_radius(self) -> np.ndarray:
        """Height of each foot's point above its sole, m, shape (feet,): the radius of a sphere."""
        return self.foot_shapes.height

    @cached_property
    def base_body(self) -> int:
        """The body with the free joint: the trunk; the world (0) for a robot of a fixed base, which has no trunk."""
        return int(self.model.jnt_bodyid[0]) if self.has_free_base else 0

    @cached_property
    def bodies(self) -> range:
        """Bodies of the robot, a free base first: bodies of the world that are fixed beside it are left out."""
        if not self.has_free_base:
            return range(1, self.model.nbody)
        root = self.model.body_rootid
        return range(self.base_body, self.base_body + int((root == self.base_body).sum()))

    @cached_property
    def total_mass(self) -> float:
        """Mass of the whole robot, kg."""
        return float(self.model.body_subtreemass[self.base_body])

    def limb_of(self, joint_or_foot: str) -> str:
        """The limb a joint or foot belongs to."""
        return self.topology.limb_of(joint_or_foot)

    @property
    def limbs_of_pair(self) -> Mapping[str, tuple[str, ...]]:
        """Limbs of the ``front`` and the ``rear`` pair; nothing for a robot without them."""
        return self.topology.pairs

    def feet_of_pair(self, pair: str) -> tuple[str, ...]:
        """Feet of the ``front`` or ``rear`` pair."""
        return self.topology.feet_of_pair(pair)

    def joints_at(self, location: str) -> np.ndarray:
        """Indices, among the joints, of a location: all, front, rear, a joint group, a limb or a joint; read-only."""
        if location not in self._joints_at:
            self._joints_at[location] = indices(self.topology.joints_at(location), self.joints)
            self._joints_at[location].flags.writeable = False
        return self._joints_at[location]

    @cached_property
    def _joints_at(self) -> dict[str, np.ndarray]:
        return {}

    def feet_at(self, location: str) -> np.ndarray:
        """Indices, among the feet, of a location: all, front, rear, a limb or a foot."""
        return indices(self.topology.feet_at(location), self.feet)

    @property
    def joint_groups(self) -> tuple[str, ...]:
        """``hip``, ``thigh``, ``calf``: joints that are alike in several limbs."""
        return tuple(self.topology.groups)

    def on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjModel:
        """A fresh model with boxes on the floor, as ``spec_on_terrain`` describes it."""
        return compile_spec(self.spec_on_terrain(boxes, slots), self.path)

    def spec_on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjSpec:
        """Specification of a model with boxes on the floor.

        ``slots`` boxes are made, those not needed parked deep below the floor, so that models of different
        terrains have equal sizes and can be rolled out in one batch.
        """
        spec = self.spec()
        keep_inertia_changeable(spec)
        slots = len(boxes) if slots is None else slots
        # ``contype`` and ``conaffinity`` of a geom of the world that everything of a robot collides with
        contype = conaffinity = 0
        for geom in spec.geoms:
            if geom.parent.name != spec.worldbody.name:
                contype, conaffinity = contype | int(geom.conaffinity), conaffinity | int(geom.contype)
        for i in range(slots):
            geom = spec.worldbody.add_geom()
            geom.name = f"terrain_{i}"
            geom.type = mujoco.mjtGeom.mjGEOM_BOX
            geom.contype, geom.conaffinity, geom.condim = contype, conaffinity, 3
            geom.rgba = [0.72, 0.62, 0.48, 1.0]
            if i < len(boxes):
                box = boxes[i]
                height = max(box.size_m[2], box.top_m + ROOTED_M)
                geom.size = [box.size_m[0] / 2, box.size_m[1] / 2, height / 2]
                geom.pos = [box.x_m, box.y_m, box.top_m - height / 2]
            else:
                geom.size = [0.1, 0.1, 0.1]
                geom.pos = [0.0, 0.0, -PARKED_BELOW_FLOOR_M]
        if len(spec.meshes):
            # Take away meshes that nothing can touch, and what only shows: they make a model thousands of times larger
            paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
            bits = [(int(geom.contype), int(geom.conaffinity)) for geom in spec.geoms]
            for geom, (contype, conaffinity) in zip(spec.geoms, bits, strict=True):
                touches = any(contype & other[1] or conaffinity & other[0] for other in bits)
                if not touches and geom.name not in paired and geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                    geom.contype = geom.conaffinity = 0
            discard_visual(spec, self.path)
        return spec
