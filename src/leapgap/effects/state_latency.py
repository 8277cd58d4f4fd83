"""Latency of the base state estimate."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class StateLatency(Effect):
    """The log's pose and velocity of the base are those of ``delay_s`` earlier.

    Between rows the state is interpolated linearly (attitude: chord of the quaternions). The true start of a
    piece within a log is what the log reports ``delay_s`` later. At a log's first row, and before it, the base is taken
    to move with its reported velocity: exact for a robot that stands, and with the noise of one row. The velocity of
    others is wrong by acceleration times delay, the position by half of that times the delay.
    """

    name = "state_latency"
    needs_base = True

    delay_s: float = parameter(0.0, "s", 0.0, 0.15, 0.015)

    @property
    def reported_late_s(self) -> float:
        """All of the delay: pose and velocity of the base are reported late together."""
        return self.delay_s

    @property
    def memory_s(self) -> float:
        """All of the delay."""
        return self.delay_s

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
        """The base as it is reported ``delay_s`` later, or extrapolated by that from its first state."""
        if self.is_nominal or not robot.has_free_base:
            return start
        qpos, qvel = start.qpos.copy(), start.qvel.copy()
        if len(start) > 1 and start.time is not None:
            share = self.delay_s / start.time[1]
            qpos[0, :7] += share * (start.qpos[1, :7] - start.qpos[0, :7])
            qpos[0, 3:7] /= np.linalg.norm(qpos[0, 3:7])
            qvel[0, :6] += share * (start.qvel[1, :6] - start.qvel[0, :6])
        else:
            qpos[0, :7] = integrate_pose(start.qpos[0, :7], start.qvel[0, :6], self.delay_s)
        return Motion(qpos, qvel, time=start.time)


def integrate_pose(pose: np.ndarray, velocity: np.ndarray, seconds: float) -> np.ndarray:
    """Pose (7,) after some seconds at constant velocity (6,): linear in world axes, angular in base axes."""
    quaternion = pose[3:7].copy()
    mujoco.mju_quatIntegrate(quaternion, velocity[3:6], seconds)
    return np.concatenate([pose[:3] + velocity[:3] * seconds, quaternion])
