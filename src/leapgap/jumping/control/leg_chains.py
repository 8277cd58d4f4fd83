"""Kinematics of the legs as tables, and what is computed from them: places of the feet, joint torques of forces."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.compiler import compiled
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class LegChains:
    """For each foot the links from the base to it, one after another, and the joints that turn them."""

    links_of_foot: np.ndarray
    """First link of each foot in the tables of links, and their number, int, (feet + 1,)."""
    link_position: np.ndarray
    link_rotation: np.ndarray
    """In the link before, m, (links, 3) and (links, 9)."""
    link_joint: np.ndarray
    """Joint that turns the link, or −1, int, (links,)."""
    link_axis: np.ndarray
    link_anchor: np.ndarray
    """Of that joint, in the link, (links, 3)."""
    link_zero: np.ndarray
    """Angle of the joint at which the link is as tabled, rad, (links,)."""
    foot_point: np.ndarray
    """Centre of the foot in its last link, m, (feet, 3)."""
    foot_share: np.ndarray
    """Part of the foot in the mean of the front and of the rear pair, (feet, 2)."""

    @property
    def tables(self) -> dict[str, np.ndarray]:
        """All arrays above by the names of their fields, as compiled code takes them."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @staticmethod
    def of(robot: Robot) -> "LegChains":
        """The legs of a robot; ``InputError`` where a link has more than one joint, or one that is no hinge."""
        model, hinge = robot.model, int(mujoco.mjtJoint.mjJNT_HINGE)
        numbers = {int(body): i for i, body in enumerate(robot.joint_bodies)}
        links: list[tuple[np.ndarray, np.ndarray, int, np.ndarray, np.ndarray, float]] = []
        begins = [0]
        for geom in robot.foot_geoms:
            chain, body = [], int(model.geom_bodyid[geom])
            while body != robot.base_body:
                chain.append(body)
                body = int(model.body_parentid[body])
            for body in reversed(chain):
                joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
                if len(joints) > 1 or any(model.jnt_type[joint] != hinge for joint in joints):
                    found = f"{len(joints)} joints at {model.body(body).name}"
                    raise InputError(robot.path, found, "at most one hinge at each link of a leg", "split the link")
                place, turn = model.body_pos[body], rotation_matrix(model.body_quat[body])
                if not len(joints):
                    links.append((place, turn, -1, np.zeros(3), np.zeros(3), 0.0))
                    continue
                joint = joints[0]
                zero = float(model.qpos0[model.jnt_qposadr[joint]])
                links.append((place, turn, numbers[body], model.jnt_axis[joint], model.jnt_pos[joint], zero))
            begins.append(len(links))
        share = np.zeros((len(robot.feet), len(PAIRS)))
        for pair, name in enumerate(PAIRS):
            feet = robot.feet_at(name)
            share[feet, pair] = 1 / len(feet)
        position, rotation, joint_of, axis, anchor, zeros = zip(*links, strict=True)
        return LegChains(
            np.array(begins, np.int32),
            np.array(position),
            np.array(rotation),
            np.array(joint_of, np.int32),
            np.array(axis),
            np.array(anchor),
            np.array(zeros),
            model.geom_pos[robot.foot_geoms].copy(),
            share,
        )


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion w x y z, row by row, (9,)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix


class CompiledLegs(LegKinematics):
    """The same from the tables, compiled when it is made."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        tables = LegChains.of(robot).tables
        tables["link_rotation"] = tables["link_rotation"].reshape(-1, 3, 3)
        self._chains = tuple(np.ascontiguousarray(table) for table in tables.values())
        # Arrays of another layout would start the compiler in the middle of a jump: all is copied into these.
        self._quaternion, self._joint_pos = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(len(robot.joints))
        self._pair_force, self._measured = np.zeros((2, 3)), np.zeros(13)
        self._follow(self._quaternion, self._joint_pos)
        measure_plane(self._measured, self._quaternion, self._joint_pos, self._chains)

    def planar(self, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """See ``LegKinematics``."""
        measured = self._measured
        measured[:3], measured[3:6], measured[6:9] = estimate.base_position, estimate.base_velocity, frame.forward
        measured[9:] = frame.x_m, frame.y_m, frame.level_m, estimate.base_angular_velocity[1]
        self._quaternion[:], self._joint_pos[:] = estimate.base_quaternion, estimate.joint_pos
        found: tuple[np.ndarray, np.ndarray]
        found = measure_plane(measured, self._quaternion, self._joint_pos, self._chains)
        return found

    def pair_offsets(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """See ``LegKinematics``."""
        return self._follow(base_quaternion, joint_pos)[0]

    def torque(self, base_quaternion: np.ndarray, joint_pos: np.ndarray, pair_force: np.ndarray) -> np.ndarray:
        """See ``LegKinematics``."""
        self._pair_force[:] = pair_force
        return self._follow(base_quaternion, joint_pos)[1]

    def planar_torque(
        self, base_quaternion: np.ndarray, joint_pos: np.ndarray, force: np.ndarray, frame: StartFrame
    ) -> np.ndarray:
        """See ``LegKinematics``."""
        np.multiply(force[FORCE_X, None], frame.forward, out=self._pair_force)
        self._pair_force[:, 2] = force[FORCE_Z]
        return self._follow(base_quaternion, joint_pos)[1]

    def _follow(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Offsets of the pairs, and joint torques for ``_pair_force``."""
        self._quaternion[:], self._joint_pos[:] = base_quaternion, joint_pos
        found: tuple[np.ndarray, np.ndarray]
        found = follow_chains(self._quaternion, self._joint_pos, self._pair_force, *self._chains)
        return found


@compiled
def set_rotation(rotation, w, x, y, z):  # type: ignore[no-untyped-def]
    """Write the matrix of a quaternion of length one, (3, 3)."""
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def turn(rotation, by, i):  # type: ignore[no-untyped-def]
    """Write rotation ← rotation · by[i], (3, 3) and (n, 3, 3)."""
    for row in range(3):
        a, b, c = rotation[row, 0], rotation[row, 1], rotation[row, 2]
        for column in range(3):
            rotation[row, column] = a * by[i, 0, column] + b * by[i, 1, column] + c * by[i, 2, column]


@compiled
def move(places, i, rotation, vectors, j, sign):  # type: ignore[no-untyped-def]
    """Add sign · rotation · vectors[j] to places[i]."""
    for row in range(3):
        along = rotation[row, 0] * vectors[j, 0] + rotation[row, 1] * vectors[j, 1] + rotation[row, 2] * vectors[j, 2]
        places[i, row] += sign * along


@compiled
def follow_chains(  # type: ignore[no-untyped-def]
    quaternion,
    joint_pos,
    pair_force,
    links_of_foot,
    link_position,
    link_rotation,
    link_joint,
    link_axis,
    link_anchor,
    link_zero,
    foot_point,
    foot_share,
):
    """Mean foot − base of each pair, (2, 3), and the joint torques −Jᵀ u of pair forces (2, 3), with ``LegChains``."""
    feet, links = len(foot_point), len(link_joint)
    offsets, torque, at = np.zeros((2, 3)), np.zeros(len(joint_pos)), np.zeros((feet, 3))
    anchors, axes = np.zeros((links, 3)), np.zeros((links, 3))  # of the joints, in world axes
    base, turned, hinge = np.empty((3, 3)), np.empty((3, 3)), np.empty((1, 3, 3))
    w, x, y, z = quaternion
    length = np.sqrt(w * w + x * x + y * y + z * z)
    set_rotation(base, w / length, x / length, y / length, z / length)
    for foot in range(feet):
        turned[:] = base
        for link in range(links_of_foot[foot], links_of_foot[foot + 1]):
            move(at, foot, turned, link_position, link, 1.0)
            turn(turned, link_rotation, link)
            joint = link_joint[link]
            if joint < 0:
                continue
            move(at, foot, turned, link_anchor, link, 1.0)
            anchors[link] = at[foot]
            move(axes, link, turned, link_axis, link, 1.0)
            half = (joint_pos[joint] - link_zero[link]) / 2
            s = np.sin(half)
            set_rotation(hinge[0], np.cos(half), s * link_axis[link, 0], s * link_axis[link, 1], s * link_axis[link, 2])
            turn(turned, hinge, 0)
            move(at, foot, turned, link_anchor, link, -1.0)
        move(at, foot, turned, foot_point, foot, 1.0)
        front, rear = foot_share[foot, 0], foot_share[foot, 1]
        for axis in range(3):
            offsets[0, axis] += front * at[foot, axis]
            offsets[1, axis] += rear * at[foot, axis]
        fx, fy, fz = front * pair_force[0] + rear * pair_force[1]
        for link in range(links_of_foot[foot], links_of_foot[foot + 1]):
            if link_joint[link] >= 0:
                rx, ry, rz = at[foot] - anchors[link]
                ax, ay, az = axes[link]
                moment = ax * (ry * fz - rz * fy) + ay * (rz * fx - rx * fz) + az * (rx * fy - ry * fx)
                torque[link_joint[link]] -= moment
    return offsets, torque


@compiled
def measure_plane(measured, quaternion, joint_pos, chains):  # type: ignore[no-untyped-def]
    """State (6,) and foot − base (4,) in a frame, with ``LegChains``.

    ``measured``: position and velocity of the base, heading of the frame, its x, y and level, pitch rate.
    """
    offsets, _ = follow_chains(quaternion, joint_pos, np.zeros((2, 3)), *chains)
    state, foot = np.empty(6), np.empty(4)
    forward_x, forward_y = measured[6], measured[7]
    w, x, y, z = quaternion
    state[0] = (measured[0] - measured[9]) * forward_x + (measured[1] - measured[10]) * forward_y
    state[1] = measured[2] - measured[11]
    state[2] = np.arcsin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    state[3] = measured[3] * forward_x + measured[4] * forward_y
    state[4], state[5] = measured[5], measured[12]
    for pair in range(2):
        foot[2 * pair] = offsets[pair, 0] * forward_x + offsets[pair, 1] * forward_y
        foot[2 * pair + 1] = offsets[pair, 2]
    return state, foot
