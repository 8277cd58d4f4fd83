"""Visual shapes of a robot, and poses of its bodies over whole motions."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from leapgap.robot.kinematics import configurations, each_pose
from leapgap.robot.model import Robot

SHOWN_GROUPS = 3
"""MuJoCo's viewer shows geom groups 0–2; collision hulls usually sit in group 3."""
UNSET_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
"""MuJoCo's default geom colour; only a geom of this colour takes the colour of its material."""
KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}


@dataclass(frozen=True)
class Shape:
    """One visual shape, fixed to a body: position and orientation in the body's axes."""

    body: str
    kind: str
    """box, sphere, ellipsoid, capsule, cylinder or mesh."""
    size_m: np.ndarray
    """(3,), as in MuJoCo: half edges; radius; half axes; radius and half length along z."""
    position: np.ndarray
    """(3,) m."""
    quaternion: np.ndarray
    """(4,) w x y z."""
    rgba: np.ndarray
    """(4,) from 0 to 1."""
    vertices: np.ndarray | None = None
    """(vertices, 3) m, of a mesh."""
    faces: np.ndarray | None = None
    """(faces, 3) indices of vertices, of a mesh."""


@dataclass(frozen=True)
class Poses:
    """Poses of bodies and feet in the world in each row of a motion."""

    bodies: tuple[str, ...]
    positions: np.ndarray
    """(rows, bodies, 3) m, origins of the bodies."""
    quaternions: np.ndarray
    """(rows, bodies, 4), w x y z, body to world."""
    feet: np.ndarray
    """(rows, feet, 3) m, centres of the feet, in the order of ``Robot.feet``."""

    @cached_property
    def base(self) -> np.ndarray:
        """(rows, 3) m, origin of the base."""
        return self.positions[:, 0]


def bodies(robot: Robot) -> tuple[str, ...]:
    """Names of the moving bodies in the order of the model: the base first, the world left out."""
    model = robot.model
    return tuple(model.body(b).name or f"body_{b}" for b in robot.bodies)


def shapes(robot: Robot) -> tuple[Shape, ...]:
    """Visual shapes of the robot's bodies: geoms of groups 0–2, or every geom of a body that has none there.

    The world's own geoms (the floor) are not part of the robot; height fields and signed distance fields have
    no shape here.
    """
    model, names = robot.model, bodies(robot)
    found = []
    for at, body in enumerate(robot.bodies):
        first, count = model.body_geomadr[body], model.body_geomnum[body]
        geoms = [g for g in range(first, first + count) if int(model.geom_type[g]) in KINDS]
        visual = [g for g in geoms if model.geom_group[g] < SHOWN_GROUPS]
        found += [_shape(model, geom, names[at]) for geom in visual or geoms]
    return tuple(found)


def _shape(model: mujoco.MjModel, geom: int, body: str) -> Shape:
    rgba, material = model.geom_rgba[geom], model.geom_matid[geom]
    if material >= 0 and np.array_equal(rgba, UNSET_RGBA):
        rgba = model.mat_rgba[material]
    kind, mesh = KINDS[int(model.geom_type[geom])], model.geom_dataid[geom]
    vertices = faces = None
    if kind == "mesh":
        at, faces_at = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        vertices = model.mesh_vert[at : at + model.mesh_vertnum[mesh]].copy()
        faces = model.mesh_face[faces_at : faces_at + model.mesh_facenum[mesh]].copy()
    return Shape(
        body=body,
        kind=kind,
        size_m=model.geom_size[geom].copy(),
        position=model.geom_pos[geom].copy(),
        quaternion=model.geom_quat[geom].copy(),
        rgba=rgba.copy(),
        vertices=vertices,
        faces=faces,
    )


def body_poses(
    robot: Robot,
    joint_pos: np.ndarray,
    base_position: np.ndarray | None = None,
    base_quaternion: np.ndarray | None = None,
    joints: Sequence[str] | None = None,
) -> Poses:
    """Forward kinematics of a whole motion; what is not given stays in the model's rest pose.

    ``joint_pos`` is (rows, joints) in rad (m for slides), in the order of ``joints`` or of ``robot.joints``;
    ``base_position`` (rows, 3) m and ``base_quaternion`` (rows, 4) w x y z are used by a free base alone.
    """
    qpos = configurations(robot, joint_pos, base_position, base_quaternion, joints)
    moving, count = slice(robot.bodies.start, robot.bodies.stop), len(robot.bodies)
    positions, quaternions = np.empty((len(qpos), count, 3)), np.empty((len(qpos), count, 4))
    feet = np.empty((len(qpos), len(robot.feet), 3))
    for row, data in enumerate(each_pose(robot.model, qpos)):
        positions[row], quaternions[row] = data.xpos[moving], data.xquat[moving]
        feet[row] = robot.foot_shapes.positions(data)
    return Poses(bodies(robot), positions, quaternions, feet)
