"""Positions of the feet, and joint torques for ground forces, for one pose at a time."""

import mujoco
import numpy as np

from leapgap.jumping.control.start_frame import StartFrame
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import StateEstimate


class LegKinematics:
    """Kinematics of the legs by MuJoCo; remembers one pose, so it belongs to one controller."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = mujoco.MjData(robot.model)
        self._jacobian = np.zeros((len(robot.feet), 3, robot.model.nv))
        self._bodies = robot.model.geom_bodyid[robot.foot_geoms]
        self._feet_of_pair = [robot.feet_at(pair) for pair in PAIRS]
        self._share = np.zeros((len(robot.feet), len(PAIRS)))
        for pair, feet in enumerate(self._feet_of_pair):
            self._share[feet, pair] = 1 / len(feet)

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

    def planar(self, estimate: StateEstimate, frame: "StartFrame") -> tuple[np.ndarray, np.ndarray]:
        """Measured state (6,) and foot − base (4,) in a frame, as in ``Reference``."""
        return frame.state(estimate), frame.foot(estimate, self)

    def planar_torque(
        self, base_quaternion: np.ndarray, joint_pos: np.ndarray, force: np.ndarray, frame: "StartFrame"
    ) -> np.ndarray:
        """``torque`` for planar pair forces (4,) along the heading of a frame."""
        return self.torque(base_quaternion, joint_pos, frame.in_world(force))

    def _place(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> None:
        qpos = self._data.qpos
        qpos[:3], qpos[3:7] = 0.0, base_quaternion
        qpos[self.robot.joint_qpos] = joint_pos
        mujoco.mj_kinematics(self.robot.model, self._data)
