"""Positions of the feet, and joint torques for ground forces, for one pose at a time."""

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from leapgap.logs.pair_force import by_pair, flat
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
    def of(estimate: StateEstimate) -> "StartFrame":
        """The frame at the robot's present position and heading."""
        x, y, _ = estimate.base_position
        return StartFrame(float(x), float(y), float(yaw_of(estimate.base_quaternion)))

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
