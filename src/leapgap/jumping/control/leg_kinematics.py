"""Positions of the feet, and joint torques for ground forces, for one pose at a time."""

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.compiler import compiled
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, by_pair, flat
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of, yaw_of
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class StartFrame:
    """Frame of a jump's start: x along the heading from the start, z up from the ground there."""

    x_m: float
    y_m: float
    yaw_rad: float
    level_m: float = 0.0  # Height in the world of the reference's z = 0

    @staticmethod
    def of(estimate: StateEstimate, level_m: float = 0.0) -> "StartFrame":
        """The frame at the robot's present position and heading."""
        x, y, _ = estimate.base_position
        return StartFrame(float(x), float(y), float(yaw_of(estimate.base_quaternion)), level_m)

    @cached_property
    def forward(self) -> np.ndarray:
        """Unit vector of the heading in the world, (3,)."""
        return np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0])

    def state(self, estimate: StateEstimate) -> np.ndarray:
        """Measured x z pitch and their rates in this frame, as in ``Reference``, (6,)."""
        x, y, z = estimate.base_position
        ahead = (x - self.x_m) * self.forward[0] + (y - self.y_m) * self.forward[1]
        velocity, pitch_rate = estimate.base_velocity, estimate.base_angular_velocity[1]
        pitch = pitch_of(estimate.base_quaternion)
        return np.array([ahead, z - self.level_m, pitch, velocity @ self.forward, velocity[2], pitch_rate])

    def foot(self, estimate: StateEstimate, legs: "LegKinematics") -> np.ndarray:
        """Foot − base, mean of each pair, front x z, rear x z, m, as in ``Reference``, (4,)."""
        offset = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
        return flat(np.stack([offset @ self.forward, offset[:, 2]], axis=1))

    def in_world(self, force: np.ndarray) -> np.ndarray:
        """Planar pair forces (4,) along the heading as vectors in the world, (2, 3)."""
        planar = by_pair(force)
        return planar[:, :1] * self.forward + planar[:, 1:] * np.array([0.0, 0.0, 1.0])


class LegKinematics:
    """Kinematics of the legs by MuJoCo; remembers one pose, so it belongs to one controller."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = mujoco.MjData(robot.model)
        self._jacobian = np.zeros((len(robot.feet), 3, robot.model.nv))
        self._bodies = robot.model.geom_bodyid[robot.foot_geoms]
        self._share = foot_share(robot)

    def offsets(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """Centre of each foot − base, m, world axes, shape (feet, 3)."""
        self._place(base_quaternion, joint_pos)
        return self._data.geom_xpos[self.robot.foot_geoms]

    def pair_offsets(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """Mean over the feet of each pair, front then rear, m, world axes, shape (2, 3)."""
        return self._share.T @ self.offsets(base_quaternion, joint_pos)

    def torque(self, base_quaternion: np.ndarray, joint_pos: np.ndarray, pair_force: np.ndarray) -> np.ndarray:
        """Joint torques that make the ground push with the given force, N·m, (joints,): τ = −Jᵀ u.

        ``pair_force`` (2, 3) is the ground's force on the robot, N, world axes, front then rear pair, split evenly
        between the feet of a pair; J is the derivative of a foot's position in world axes by the joints. As in the
        paper, the legs have no mass here; their weight and inertia are left to the joint PD.
        """
        self._place(base_quaternion, joint_pos)
        model, data = self.robot.model, self._data
        mujoco.mj_comPos(model, data)
        for jacobian, geom, body in zip(self._jacobian, self.robot.foot_geoms, self._bodies, strict=True):
            mujoco.mj_jac(model, data, jacobian, None, data.geom_xpos[geom], body)
        of_feet = (self._share @ pair_force).ravel()
        return -(of_feet @ self._jacobian.reshape(len(of_feet), -1))[self.robot.joint_dofs]

    def planar(self, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Measured state (6,) and foot − base (4,) in a frame, as in ``Reference``."""
        return frame.state(estimate), frame.foot(estimate, self)

    def planar_torque(
        self, base_quaternion: np.ndarray, joint_pos: np.ndarray, force: np.ndarray, frame: StartFrame
    ) -> np.ndarray:
        """``torque`` for planar pair forces (4,) along the heading of a frame."""
        return self.torque(base_quaternion, joint_pos, frame.in_world(force))

    def _place(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> None:
        qpos = self._data.qpos
        qpos[:3], qpos[3:7] = 0.0, base_quaternion
        qpos[self.robot.joint_qpos] = joint_pos
        mujoco.mj_kinematics(self.robot.model, self._data)


def foot_share(robot: Robot) -> np.ndarray:
    """Part of each foot in the mean of the front and of the rear pair, (feet, 2)."""
    share = np.zeros((len(robot.feet), len(PAIRS)))
    for pair, name in enumerate(PAIRS):
        feet = robot.feet_at(name)
        share[feet, pair] = 1 / len(feet)
    return share


@dataclass(frozen=True)
class LegChains:
    """For each foot the links from the base to it, one after another, and the joints that turn them."""

    links_of_foot: np.ndarray  # First link of each foot in the tables of links, and their number, int, (feet + 1,)
    link_position: np.ndarray
    link_rotation: np.ndarray  # In the link before, m, (links, 3) and (links, 9)
    link_joint: np.ndarray  # Joint that turns the link, or −1, int, (links,)
    link_axis: np.ndarray
    link_anchor: np.ndarray  # Of that joint, in the link, (links, 3)
    link_zero: np.ndarray  # Angle of the joint at which the link is as tabled, rad, (links,)
    foot_point: np.ndarray  # Centre of the foot in its last link, m, (feet, 3)
    foot_share: np.ndarray  # Part of the foot in the mean of the front and of the rear pair, (feet, 2)

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
                place, turn = model.body_pos[body], np.zeros(9)
                mujoco.mju_quat2Mat(turn, model.body_quat[body])
                if not len(joints):
                    links.append((place, turn, -1, np.zeros(3), np.zeros(3), 0.0))
                    continue
                joint = joints[0]
                zero = float(model.qpos0[model.jnt_qposadr[joint]])
                links.append((place, turn, numbers[body], model.jnt_axis[joint], model.jnt_pos[joint], zero))
            begins.append(len(links))
        position, rotation, joint_of, axis, anchor, zeros = zip(*links, strict=True)
        return LegChains(
            np.array(begins, np.int32),
            *(np.array(position), np.array(rotation), np.array(joint_of, np.int32)),
            *(np.array(axis), np.array(anchor), np.array(zeros)),
            *(model.geom_pos[robot.foot_geoms].copy(), foot_share(robot)),
        )


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
        """Compiled: measured state (6,) and foot − base (4,) in a frame, as of ``LegKinematics``."""
        measured = self._measured
        measured[:3], measured[3:6], measured[6:9] = estimate.base_position, estimate.base_velocity, frame.forward
        measured[9:] = frame.x_m, frame.y_m, frame.level_m, estimate.base_angular_velocity[1]
        self._quaternion[:], self._joint_pos[:] = estimate.base_quaternion, estimate.joint_pos
        found: tuple[np.ndarray, np.ndarray]
        found = measure_plane(measured, self._quaternion, self._joint_pos, self._chains)
        return found

    def pair_offsets(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """Compiled: mean over the feet of each pair, front then rear, m, world axes, shape (2, 3)."""
        return self._follow(base_quaternion, joint_pos)[0]

    def torque(self, base_quaternion: np.ndarray, joint_pos: np.ndarray, pair_force: np.ndarray) -> np.ndarray:
        """Compiled: joint torques that make the ground push with the given force, N·m, (joints,)."""
        self._pair_force[:] = pair_force
        return self._follow(base_quaternion, joint_pos)[1]

    def planar_torque(
        self, base_quaternion: np.ndarray, joint_pos: np.ndarray, force: np.ndarray, frame: StartFrame
    ) -> np.ndarray:
        """Compiled: joint torques for a force in the plane of a frame, N·m, (joints,)."""
        np.multiply(force[FORCE_X, None], frame.forward, out=self._pair_force)
        self._pair_force[:, 2] = force[FORCE_Z]
        return self._follow(base_quaternion, joint_pos)[1]

    def _follow(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Offsets of the pairs, and joint torques for ``_pair_force``."""
        self._quaternion[:], self._joint_pos[:] = base_quaternion, joint_pos
        found: tuple[np.ndarray, np.ndarray]
        found = follow_chains(self._quaternion, self._joint_pos, self._pair_force, self._chains)
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
def follow_chains(quaternion, joint_pos, pair_force, chains):  # type: ignore[no-untyped-def]
    """Mean foot − base of each pair, (2, 3), and the joint torques −Jᵀ u of pair forces (2, 3), with ``LegChains``."""
    links_of_foot, link_position, link_rotation, link_joint, link_axis = chains[:5]
    link_anchor, link_zero, foot_point, foot_share = chains[5:]
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
    offsets, _ = follow_chains(quaternion, joint_pos, np.zeros((2, 3)), chains)
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
