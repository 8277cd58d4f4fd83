"""A base state that is reported late; the joints are reported at once."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class StateLatency(Effect):
    """The log's pose and velocity of the base are those of ``delay_s`` earlier.

    Between rows the state is interpolated linearly (attitude: chord of the quaternions). Before the first row the base
    is taken to have moved with its first velocity, and so the true start is found from the reported one: exact for
    a robot that stands, wrong by g·delay²/2 for one that falls.
    """

    name = "state_latency"
    needs_base = True

    delay_s: float = parameter(0.0, "s", 0.0, 0.06, 0.015)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Replace the state of the base by that of ``delay_s`` before each row."""
        if self.is_nominal or not robot.has_free_base:
            return motion
        qpos, qvel = motion.qpos.copy(), motion.qvel.copy()
        row, after_start_s = self._rows_before(motion, period_s)
        first = np.clip(np.floor(row).astype(int), 0, max(len(qpos) - 2, 0))
        share = np.clip(row - first, 0.0, 1.0)[:, None]
        after = np.minimum(first + 1, len(qpos) - 1)
        for of_base, values in ((qpos[:, :7], motion.qpos[:, :7]), (qvel[:, :6], motion.qvel[:, :6])):
            of_base[:] = (1 - share) * values[first] + share * values[after]
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        for i in np.flatnonzero(after_start_s < 0):
            qpos[i, :7] = integrate_pose(motion.qpos[0, :7], motion.qvel[0, :6], after_start_s[i])
        return Motion(qpos, qvel)

    def _rows_before(self, motion: Motion, period_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The instants ``delay_s`` before each row, as fractions of rows and in s after the first row, (rows,) each."""
        if motion.time is None:
            row = np.arange(len(motion)) - self.delay_s / period_s
            return row, row * period_s
        instant = motion.time - self.delay_s
        return np.interp(instant, motion.time, np.arange(len(motion))), instant - motion.time[0]

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Extrapolate the base by ``delay_s`` from the state that is reported first."""
        if self.is_nominal or not robot.has_free_base:
            return start
        qpos = start.qpos.copy()
        qpos[0, :7] = integrate_pose(start.qpos[0, :7], start.qvel[0, :6], self.delay_s)
        return Motion(qpos, start.qvel)


def integrate_pose(pose: np.ndarray, velocity: np.ndarray, seconds: float) -> np.ndarray:
    """Pose (7,) after some seconds at constant velocity (6,): linear in world axes, angular in base axes."""
    quaternion = pose[3:7].copy()
    mujoco.mju_quatIntegrate(quaternion, velocity[3:6], seconds)
    return np.concatenate([pose[:3] + velocity[:3] * seconds, quaternion])
