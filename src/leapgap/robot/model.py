"""The MuJoCo model of a robot, with names and indices of its parts."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.motors import MotorConstants, motors_of
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PartNames, Topology, indices, topology_of

DEFAULT_MODEL = Path(__file__).with_name("a1.xml")
ROOTED_M = 0.5
"""Blocks reach this far below the floor. A soft foot that sinks past the middle of a thin box would be pushed out at
its underside."""
PARKED_BELOW_FLOOR_M = 50.0


@dataclass(frozen=True)
class Robot:
    """A robot as a MuJoCo model file describes it: joints with one actuator each, sphere feet, maybe a free base.

    Limbs, groups and feet come from the tree of its bodies, or from the user's ``names``.
    """

    path: Path
    stated_motors: MotorConstants | None = None
    """Constants of the motors in place of those that the model file states."""
    names: PartNames | None = field(default=None, compare=False)
    """The user's names of its parts; None: by the tree of its bodies."""

    @staticmethod
    def load(
        path: Path | str = DEFAULT_MODEL, motors: MotorConstants | None = None, names: PartNames | None = None
    ) -> "Robot":
        """Read and compile a model file; ``InputError`` where it is invalid or lacks what a replay needs."""
        robot = Robot(Path(path), motors, names)
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
    def motors(self) -> MotorConstants | None:
        """Constants of the motors, as stated beside the model file or in it; None where not stated."""
        return self.stated_motors or motors_of(self.model)

    @cached_property
    def sha256(self) -> str:
        """Hash of the model file: exported networks and reports carry it.

        It includes motors stated beside the file, so that robots with different motors have different hashes.
        """
        motors = b"" if self.stated_motors is None else repr(self.stated_motors).encode()
        return hashlib.sha256(self.path.read_bytes() + motors).hexdigest()

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
    def topology(self) -> Topology:
        """Limbs, groups, feet and pairs."""
        joints = dict(zip(self.joints, self._joint_ids.tolist(), strict=True))
        return topology_of(self.model, joints, self.base_body, self.has_free_base, self.names)

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the feet, in the order of the model: what the user named, else spheres that may touch the ground."""
        return self.topology.feet

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
        """Indices, among the joints, of a location: all, front, rear, a joint group, a limb or a joint."""
        return indices(self.topology.joints_at(location), self.joints)

    def feet_at(self, location: str) -> np.ndarray:
        """Indices, among the feet, of a location: all, front, rear, a limb or a foot."""
        return indices(self.topology.feet_at(location), self.feet)

    @property
    def joint_groups(self) -> tuple[str, ...]:
        """``hip``, ``thigh``, ``calf``: joints that are alike in several limbs."""
        return tuple(self.topology.groups)

    def on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjModel:
        """A fresh model with boxes on the floor, as ``spec_on_terrain`` describes it."""
        return self.spec_on_terrain(boxes, slots).compile()

    def spec_on_terrain(self, boxes: Sequence[Box], slots: int | None = None) -> mujoco.MjSpec:
        """Specification of a model with boxes on the floor.

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
