"""Smooth excitation of a held robot: a sum of sines at each joint, gravity fed forward."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.validation.motions.base import PlannedCommands, PlannedMotion, rise


@dataclass(frozen=True)
class SumOfSines(PlannedMotion):
    """A sum of sines at each joint about the keyframe, with amplitudes and phases drawn for each plan."""

    name = "sines"

    frequencies_hz: list[float]
    swing: list[float]  # largest departure of each joint from the keyframe, rad (m for slides), or one number for all
    onset_s: float  # the motion grows from rest over this time

    def commands(self, time: np.ndarray, pose: np.ndarray, robot: Robot, rng: np.random.Generator) -> PlannedCommands:
        """Set points within the joints' ranges, and the torque that holds them against gravity in the model."""
        joints, waves = len(robot.joints), len(self.frequencies_hz)
        size = rng.uniform(0.4, 1.0, (waves, joints))
        phase = rng.uniform(0, 2 * np.pi, (waves, joints))
        angle = 2 * np.pi * np.asarray(self.frequencies_hz)[:, None] * time[:, None, None]
        wave = (size * np.sin(angle + phase)).sum(axis=1)
        wave *= np.broadcast_to(self.swing, joints) / np.abs(wave).max(axis=0)
        position = pose + rise(time, self.onset_s)[:, None] * wave
        # Refuse it where planned joint positions (rows, joints) leave the range of a joint
        for i, joint in enumerate(robot.joints):
            number = robot.model.joint(joint).id
            low, high = robot.model.jnt_range[number]
            if robot.model.jnt_limited[number] and not (low <= position[:, i].min() and position[:, i].max() <= high):
                found = f"{joint} from {position[:, i].min():.3g} to {position[:, i].max():.3g}"
                raise InputError("motion.swing", found, f"within {low:.3g} and {high:.3g}", "make it smaller")
        # Torques that hold a robot of a fixed base at joint positions (rows, joints), N·m, (rows, joints)
        model, data = robot.model, mujoco.MjData(robot.model)
        torque = np.empty_like(position)
        for row, angles in enumerate(position):
            data.qpos[robot.joint_qpos] = angles
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, data.qfrc_bias)
            torque[row] = data.qfrc_bias[robot.joint_dofs]
        return PlannedCommands(position, torque)
