"""Forward kinematics of whole motions: positions of feet, bodies and the centre of mass in each row; shown geoms.

Poses are iterated over by ``each_pose``.
"""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion

SHOWN_GROUPS = 3  # MuJoCo's viewer shows geom groups 0–2; collision hulls usually sit in group 3
UNSET_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
"""MuJoCo's default geom colour; only a geom of this colour takes the colour of its material."""
KINDS = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")): "ellipsoid" if name == "sphere" else name
    for name in ("box", "sphere", "ellipsoid", "capsule", "cylinder", "mesh")
}
"""Types of geoms that are shown, and how Rerun draws them."""


def configurations(
    robot: Robot,
    joint_pos: np.ndarray,
    base_position: np.ndarray | None = None,
    base_quaternion: np.ndarray | None = None,
    joints: Sequence[str] | None = None,
) -> np.ndarray:
    """``qpos`` of each row, (rows, nq); parts that are not given keep the model's rest pose.

    ``joint_pos`` is (rows, joints) in rad (m for slides), in the order of ``joints`` or of ``robot.joints``;
    ``base_position`` (rows, 3) m and ``base_quaternion`` (rows, 4) w x y z are used for a free base alone.
    """
    model = robot.model
    qpos = np.tile((model.key_qpos[0] if model.nkey else model.qpos0).copy(), (len(joint_pos), 1))
    if robot.has_free_base and base_position is not None:
        qpos[:, POSITION_SLICE] = base_position
    if robot.has_free_base and base_quaternion is not None:
        qpos[:, QUATERNION_SLICE] = base_quaternion
    named = robot.joints if joints is None else tuple(joints)
    qpos[:, robot.joint_qpos[[robot.joints.index(name) for name in named]]] = joint_pos
    return qpos


def each_pose(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray | None = None, com: bool = False
) -> Iterator[mujoco.MjData]:
    """MuJoCo's data with the kinematics of each row; one object is used for all rows, so copy what you keep.

    ``qpos`` is (rows, nq). ``com`` adds centres of mass (needed by ``mj_jac``); ``qvel`` (rows, nv) adds momenta of
    subtrees too.
    """
    data = mujoco.MjData(model)
    for row in range(len(qpos)):
        data.qpos[:] = qpos[row]
        mujoco.mj_kinematics(model, data)
        if com or qvel is not None:
            mujoco.mj_comPos(model, data)
        if qvel is not None:
            data.qvel[:] = qvel[row]
            mujoco.mj_comVel(model, data)
            mujoco.mj_subtreeVel(model, data)
        yield data


def gather(rows: int, values: Iterator[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Stack arrays of one shape, copied row by row, (rows, *shape)."""
    result = np.empty((rows, *shape))
    for row, value in enumerate(values):
        result[row] = value
    return result


def feet_in_world(
    robot: Robot, base_position: np.ndarray, base_quaternion: np.ndarray, joint_pos: np.ndarray
) -> np.ndarray:
    """Centres of the feet, m, world frame, shape (rows, feet, 3).

    The measured pose is ``base_position`` (rows, 3) m, ``base_quaternion`` (rows, 4) w x y z, ``joint_pos``
    (rows, joints) rad in the order of ``robot.joints``.
    """
    return feet_positions(robot, configurations(robot, joint_pos, base_position, base_quaternion))


def feet_positions(robot: Robot, qpos: np.ndarray) -> np.ndarray:
    """Centres of the feet, m, world frame, (rows, feet, 3), of configurations (rows, nq)."""
    positions = (robot.foot_shapes.positions(data) for data in each_pose(robot.model, qpos))
    return gather(len(qpos), positions, (len(robot.feet), 3))


def soles(robot: Robot, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """The lowest point of each foot, m, and the velocity of its material there, m/s, world frame, (rows, feet, 3) each.

    A foot that rolls on the ground has a sole at rest, while its centre moves.
    """
    model = robot.model
    body = model.geom_bodyid[robot.foot_geoms]
    root = model.body_rootid[body]
    places, velocities = (np.empty((len(motion), len(robot.feet), 3)) for _ in range(2))
    for row, data in enumerate(each_pose(robot.model, motion.qpos, motion.qvel)):
        places[row] = robot.foot_shapes.positions(data)
        places[row, :, 2] -= robot.foot_radius
        turn, centre = data.cvel[body, :3], data.cvel[body, 3:]
        velocities[row] = centre + np.cross(turn, places[row] - data.subtree_com[root])
    return places, velocities


def centre_of_mass(robot: Robot, qpos: np.ndarray, model: mujoco.MjModel | None = None) -> np.ndarray:
    """Centre of mass of the whole robot, m, world frame, (rows, 3); ``qpos`` is (rows, nq).

    ``model`` is one of the same robot with other numbers; None: its own.
    """
    centres = (data.subtree_com[robot.base_body] for data in each_pose(model or robot.model, qpos, com=True))
    return gather(len(qpos), centres, (3,))


def momenta(robot: Robot, motion: Motion, model: mujoco.MjModel | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Linear momentum, kg·m/s, and angular momentum about the centre of mass, kg·m²/s, world axes, (rows, 3) each.

    ``model`` as for ``centre_of_mass``.
    """
    model = model or robot.model
    mass = float(model.body_subtreemass[robot.base_body])
    linear, angular = np.empty((len(motion), 3)), np.empty((len(motion), 3))
    for row, data in enumerate(each_pose(model, motion.qpos, motion.qvel)):
        linear[row] = mass * data.subtree_linvel[robot.base_body]
        angular[row] = data.subtree_angmom[robot.base_body]
    return linear, angular


def joint_torque_to_foot_force(
    robot: Robot, base_quaternion: np.ndarray, joint_pos: np.ndarray, torque: np.ndarray
) -> np.ndarray:
    """Ground forces on the robot that are equivalent to joint torques of massless legs, N, (rows, feet, 3).

    u = −(J(q)ᵀ)⁻¹ τ a leg, J the derivative of the foot's position in world axes by the leg's joints
    (paper, data collection; minus because u acts on the robot). ``torque`` is (rows, joints) in N·m.
    """
    model = robot.model
    jacobians = np.empty((len(robot.feet), 3, model.nv))
    of_leg = np.array(
        [[i for i, j in enumerate(robot.joints) if robot.limb_of(j) == robot.limb_of(f)] for f in robot.feet]
    )
    of_rows = np.empty((len(joint_pos), len(robot.feet), 3, 3))
    qpos = configurations(robot, joint_pos, np.zeros((len(joint_pos), 3)), base_quaternion)
    feet, dofs = np.arange(len(robot.feet))[:, None], robot.joint_dofs[of_leg]
    points = [(int(geom), int(model.geom_bodyid[geom])) for geom in robot.foot_geoms]
    for row, data in enumerate(each_pose(robot.model, qpos, com=True)):
        place = data.geom_xpos
        for jacobian, (geom, body) in zip(jacobians, points, strict=True):
            mujoco.mj_jac(model, data, jacobian, None, place[geom], body)
        of_rows[row] = jacobians[feet, :, dofs]
    return -np.linalg.solve(of_rows, torque[:, of_leg, None])[..., 0]


def feet_load(robot: Robot, motion: Motion, acceleration: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Upward force of the ground on all feet together in each row, N, (rows,).

    The joints of a robot in free fall need the torques of ``mj_inverse`` without contacts, for the accelerations
    (rows, nv) of its joints. What the motors deliver besides, (rows, nv), N·m, is the transposed Jacobian of the feet
    times the force of the ground. The acceleration of the base counts as free fall, since its share in the torques of
    light legs is small.
    """
    model, data = copy.copy(robot.model), mujoco.MjData(robot.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    falling = acceleration.copy()
    falling[:, VELOCITY_SLICE] = model.opt.gravity
    jacobian, load = np.zeros((3, model.nv)), np.zeros(len(motion))
    for row, posed in enumerate(each_pose(robot.model, motion.qpos, motion.qvel)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.qpos[row], motion.qvel[row], falling[row]
        mujoco.mj_inverse(model, data)
        lacks = data.qfrc_inverse - torque[row]
        for geom in robot.foot_geoms:
            mujoco.mj_jacGeom(robot.model, posed, jacobian, None, int(geom))
            dofs = robot.joint_dofs[np.abs(jacobian[:, robot.joint_dofs]).sum(axis=0) > 0]
            load[row] += np.linalg.lstsq(jacobian[:, dofs].T, lacks[dofs], rcond=None)[0][2]
    return load


DEEPEST_M = 0.015  # ground that bears a robot's weight no sooner than at this depth does not: motors give way
HALVINGS = 9  # number of times that this depth is halved: to 0.03 mm


def sinking_depths(robot: Robot, qpos: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """How far the base is lower than in each given pose where the ground bears the weight, m, (poses,).

    ``qpos`` is (poses, nq), with the lowest soles just at the ground; ``torque`` (poses, nv) are the torques of the
    motors. At the depth that is found, the model's ground pushes up as much as the robot weighs, at rest. It is NaN
    where the model has no ground, or the motors do not hold the robot up.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weight = robot.total_mass * float(-model.opt.gravity[2])
    up = POSITION_SLICE.stop - 1
    found = np.full(len(qpos), np.nan)

    def bears(pose: np.ndarray, motors: np.ndarray, depth: float) -> bool:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        data.qpos[up] -= depth
        data.qfrc_applied[:] = motors
        mujoco.mj_forward(model, data)
        return bool(data.qfrc_constraint[up] >= weight)

    for k, (pose, motors) in enumerate(zip(qpos, torque, strict=True)):
        low, high = 0.0, DEEPEST_M
        if not bears(pose, motors, high):
            continue
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if bears(pose, motors, middle) else (middle, high)
        found[k] = (low + high) / 2
    return found


@dataclass(frozen=True)
class Poses:
    """Poses of bodies and feet in the world in each row of a motion."""

    bodies: tuple[str, ...]  # names in the order of the model: the base first, the world left out
    positions: np.ndarray  # (rows, bodies, 3) m, origins of the bodies
    quaternions: np.ndarray  # (rows, bodies, 4), w x y z, body to world
    feet: np.ndarray  # (rows, feet, 3) m, centres of the feet, in the order of ``Robot.feet``

    @cached_property
    def base(self) -> np.ndarray:
        """(rows, 3) m, origin of the base."""
        return self.positions[:, 0]


def body_poses(robot: Robot, qpos: np.ndarray) -> Poses:
    """Forward kinematics of a whole motion of configurations (rows, nq)."""
    moving, count = slice(robot.bodies.start, robot.bodies.stop), len(robot.bodies)
    positions, quaternions = np.empty((len(qpos), count, 3)), np.empty((len(qpos), count, 4))
    feet = np.empty((len(qpos), len(robot.feet), 3))
    for row, data in enumerate(each_pose(robot.model, qpos)):
        positions[row], quaternions[row] = data.xpos[moving], data.xquat[moving]
        feet[row] = robot.foot_shapes.positions(data)
    bodies = tuple(robot.model.body(body).name or f"body_{body}" for body in robot.bodies)
    return Poses(bodies, positions, quaternions, feet)


def visual_geoms(model: mujoco.MjModel, body: int) -> dict[str, list[int]]:
    """Shown geoms of a body by their kind: those of groups 0–2, or all where there are none.

    Height fields and signed distance fields have no shape here.
    """
    first, count = model.body_geomadr[body], model.body_geomnum[body]
    geoms = [geom for geom in range(first, first + count) if int(model.geom_type[geom]) in KINDS]
    shown: dict[str, list[int]] = {}
    for geom in [geom for geom in geoms if model.geom_group[geom] < SHOWN_GROUPS] or geoms:
        shown.setdefault(KINDS[int(model.geom_type[geom])], []).append(geom)
    return shown


def geom_rgba(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Colour of a geom, red, green, blue and opacity from 0 to 1, (4,): its material's where it has none of its own."""
    rgba, material = model.geom_rgba[geom], model.geom_matid[geom]
    return model.mat_rgba[material] if material >= 0 and np.array_equal(rgba, UNSET_RGBA) else rgba
