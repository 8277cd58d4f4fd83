"""The MuJoCo model of a robot, and the names and indices others need of it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.pair_force import WORLD_X_Z
from leapgap.robot.terrain import Box

DEFAULT_MODEL = Path(__file__).with_name("a1.xml")
ROOTED_M = 0.5
"""Blocks reach this far below the floor: a soft foot that sinks past the middle of a thin box is pushed out of its
underside, and held there."""
PARKED_BELOW_FLOOR_M = 50.0


@dataclass(frozen=True)
class Robot:
    """A robot as a MuJoCo model file describes it: joints with one actuator each, sphere feet, maybe a free base.

    Knows no robot by name. Joints are named ``<leg>_<group>`` (``FR_calf``, ``FR_calf_joint``) where locations such as
    ``front`` or ``calf`` are to be used; feet are the named spheres that may touch the ground.
    """

    path: Path

    @staticmethod
    def load(path: Path | str = DEFAULT_MODEL) -> "Robot":
        """Read and compile a model file; ``InputError`` where it is none, or lacks what a replay needs."""
        robot = Robot(Path(path))
        if not robot.path.is_file():
            raise InputError(path, "no such file", "a MuJoCo model (XML)", "name the robot's model file")
        try:
            model = robot.model
        except ValueError as error:
            raise InputError(path, f"no valid MuJoCo model ({error})", "a model that compiles", "repair it") from None
        driven = set(model.actuator_trnid[:, 0])
        idle = [name for name, joint in zip(robot.joints, robot._joint_ids, strict=True) if joint not in driven]
        if idle or not robot.joints:
            raise InputError(
                path,
                f"no actuator at {', '.join(idle) or 'any joint'}",
                "one actuator at every hinge or slide joint",
                "add the actuators",
            )
        return robot

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model as it stands in the file. Shared: copy it before changing anything."""
        return mujoco.MjModel.from_xml_path(str(self.path))

    @cached_property
    def sha256(self) -> str:
        """Hash of the model file: exported networks and reports carry it."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    @cached_property
    def name(self) -> str:
        """Name of the model, as in its file."""
        return self.model.names.split(b"\0", 1)[0].decode()

    @cached_property
    def has_free_base(self) -> bool:
        """Whether the first joint is free: a floating-base robot."""
        return self.model.njnt > 0 and self.model.jnt_type[0] == int(mujoco.mjtJoint.mjJNT_FREE)

    @cached_property
    def _joint_ids(self) -> np.ndarray:
        single = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
        return np.flatnonzero(np.isin(self.model.jnt_type, single))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the hinge and slide joints in the order of the model."""
        return tuple(self.model.joint(j).name for j in self._joint_ids)

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
    def feet(self) -> tuple[str, ...]:
        """Names of the feet: named spheres that may touch the ground, in the order of the model."""
        return tuple(
            self.model.geom(g).name
            for g in range(self.model.ngeom)
            if self.model.geom_type[g] == int(mujoco.mjtGeom.mjGEOM_SPHERE)
            and self.model.geom_conaffinity[g] | self.model.geom_contype[g]
            and self.model.geom(g).name
        )

    @cached_property
    def foot_geoms(self) -> np.ndarray:
        """Geom index of each foot, shape (feet,)."""
        return np.array([self.model.geom(name).id for name in self.feet], dtype=int)

    @cached_property
    def foot_radius(self) -> np.ndarray:
        """Radius of each foot, m, shape (feet,)."""
        return self.model.geom_size[self.foot_geoms, 0].copy()

    @cached_property
    def base_body(self) -> int:
        """The body that carries everything: the trunk, or the first link of a fixed-base robot."""
        return 1

    @cached_property
    def total_mass(self) -> float:
        """Of the whole robot, kg."""
        return float(self.model.body_subtreemass[self.base_body])

    def leg_of(self, joint_or_foot: str) -> str:
        """The leg a joint or foot belongs to, by name: ``FR_calf`` and ``FR`` are of ``FR``."""
        return joint_or_foot.split("_", 1)[0]

    @cached_property
    def legs_of_pair(self) -> dict[str, tuple[str, ...]]:
        """Legs of the ``front`` and the ``rear`` pair, by where the first joint of the leg sits along x."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        x_of_leg: dict[str, float] = {}
        for name, joint in zip(self.joints, self._joint_ids, strict=True):
            x_of_leg.setdefault(self.leg_of(name), data.xanchor[joint, 0] - data.xpos[self.base_body, 0])
        return {
            "front": tuple(leg for leg, x in x_of_leg.items() if x > 0),
            "rear": tuple(leg for leg, x in x_of_leg.items() if x <= 0),
        }

    def feet_of_pair(self, pair: str) -> tuple[str, ...]:
        """Feet of the ``front`` or ``rear`` pair."""
        return tuple(foot for foot in self.feet if self.leg_of(foot) in self.legs_of_pair[pair])

    def joints_at(self, location: str) -> np.ndarray:
        """Indices, among the joints, of a location: all, front, rear, a joint group, a leg or a joint."""
        legs = self.legs_of_pair.get(location, (location,))
        found = [
            i
            for i, joint in enumerate(self.joints)
            if location in ("all", joint, group_of(joint)) or self.leg_of(joint) in legs
        ]
        return self._known(location, found, (*self.joints, *self.joint_groups))

    def feet_at(self, location: str) -> np.ndarray:
        """Indices, among the feet, of a location: all, front, rear or a foot."""
        legs = self.legs_of_pair.get(location, (location,))
        found = [i for i, foot in enumerate(self.feet) if location == "all" or self.leg_of(foot) in legs]
        return self._known(location, found, self.feet)

    @cached_property
    def joint_groups(self) -> tuple[str, ...]:
        """``hip``, ``thigh``, ``calf``: what follows the leg in the joints' names."""
        return tuple(dict.fromkeys(group_of(joint) for joint in self.joints))

    def _known(self, location: str, found: list[int], names: Sequence[str]) -> np.ndarray:
        if not found:
            raise InputError(
                "location",
                location,
                f"all, front, rear or one of {', '.join(names)}",
                "name a place this robot has and the effect can act at",
            )
        return np.array(found, dtype=int)

    def on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjModel:
        """A fresh model with boxes on the floor, as ``spec_on_terrain`` describes it."""
        return self.spec_on_terrain(boxes, slots).compile()

    def spec_on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjSpec:
        """What a model with boxes on the floor is compiled from.

        ``slots`` boxes are made, those not needed parked deep below the floor, so that models of different
        terrains have equal sizes and can be rolled out in one batch.
        """
        spec = mujoco.MjSpec.from_file(str(self.path))
        slots = len(boxes) if slots is None else slots
        for i in range(slots):
            geom = spec.worldbody.add_geom()
            geom.name = f"terrain_{i}"
            geom.type = mujoco.mjtGeom.mjGEOM_BOX
            geom.contype, geom.conaffinity, geom.condim = 1, 0, 3
            geom.rgba = [0.72, 0.62, 0.48, 1.0]
            if i < len(boxes):
                box = boxes[i]
                height = max(box.size_m[2], box.top_m + ROOTED_M)
                geom.size = [box.size_m[0] / 2, box.size_m[1] / 2, height / 2]
                geom.pos = [box.x_m, box.y_m, box.top_m - height / 2]
            else:
                geom.size = [0.1, 0.1, 0.1]
                geom.pos = [0.0, 0.0, -PARKED_BELOW_FLOOR_M]
        return spec

    def feet_in_world(
        self, base_position: np.ndarray, base_quaternion: np.ndarray, joint_pos: np.ndarray
    ) -> np.ndarray:
        """Centres of the feet, m, world frame, shape (rows, feet, 3).

        Forward kinematics of measured poses: ``base_position`` (rows, 3) m, ``base_quaternion`` (rows, 4) w x y z,
        ``joint_pos`` (rows, joints) rad in the order of ``joints``.
        """
        data = mujoco.MjData(self.model)
        feet = np.empty((len(joint_pos), len(self.feet), 3))
        for row in range(len(joint_pos)):
            data.qpos[:3], data.qpos[3:7] = base_position[row], base_quaternion[row]
            data.qpos[self.joint_qpos] = joint_pos[row]
            mujoco.mj_kinematics(self.model, data)
            feet[row] = data.geom_xpos[self.foot_geoms]
        return feet

    def joint_torque_to_foot_force(
        self, base_quaternion: np.ndarray, joint_pos: np.ndarray, torque: np.ndarray
    ) -> np.ndarray:
        """Ground forces on the robot that joint torques stand for when the legs are massless, N, (rows, feet, 3).

        u = −(J(q)ᵀ)⁻¹ τ a leg, J the derivative of the foot's position in world axes by the leg's joints
        (paper, data collection; minus because u acts on the robot). ``torque`` is (rows, joints) in N·m.
        """
        data = mujoco.MjData(self.model)
        jacobian = np.empty((3, self.model.nv))
        of_leg = np.array(
            [[i for i, j in enumerate(self.joints) if self.leg_of(j) == self.leg_of(f)] for f in self.feet]
        )
        of_rows = np.empty((len(joint_pos), len(self.feet), 3, 3))
        for row in range(len(joint_pos)):
            data.qpos[:3], data.qpos[3:7] = 0.0, base_quaternion[row]
            data.qpos[self.joint_qpos] = joint_pos[row]
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_comPos(self.model, data)
            for foot, (geom, joints) in enumerate(zip(self.foot_geoms, of_leg, strict=True)):
                body = self.model.geom_bodyid[geom]
                mujoco.mj_jac(self.model, data, jacobian, None, data.geom_xpos[geom], body)
                of_rows[row, foot] = jacobian[:, self.joint_dofs[joints]].T
        return -np.linalg.solve(of_rows, torque[:, of_leg, None])[..., 0]

    def per_pair(self, of_feet: np.ndarray) -> np.ndarray:
        """Sum over the feet of each pair, in the planar axes: (rows, feet, 3) → front x z, rear x z (rows, 4)."""
        sums = [
            of_feet[:, [self.feet.index(f) for f in self.feet_of_pair(pair)]].sum(axis=1) for pair in ("front", "rear")
        ]
        return np.concatenate([s[:, WORLD_X_Z] for s in sums], axis=1)


def group_of(joint: str) -> str:
    """``hip``, ``thigh`` or ``calf``: the last word of a joint's name, but for the word joint itself."""
    return joint.removesuffix("_joint").rsplit("_", 1)[-1]
