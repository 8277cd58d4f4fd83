"""What a log reports of a motion: encoders, the measuring frame, latency, the clock, and the steps of a simulator."""

from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Commands, Effect, ForceContext, Parameter, parameter
from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion


def lean(roll_rad: float, pitch_rad: float) -> np.ndarray:
    """Quaternion w x y z of a turn by the roll about the world's x axis, then by the pitch about its y axis."""
    roll = np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])
    pitch = np.array([np.cos(pitch_rad / 2), 0.0, np.sin(pitch_rad / 2), 0.0])
    turn = np.empty(4)
    mujoco.mju_mulQuat(turn, pitch, roll)
    return turn


def rotated(vectors: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors (rows, 3) turned by a quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, turn)
    return np.asarray(vectors @ matrix.reshape(3, 3).T)


@dataclass(frozen=True)
class EncoderBias(Effect):
    """Reported − true joint position. The joint PD acts on the reported position, and the log holds it."""

    name = "encoder_bias"
    words = "encoder bias"
    places = "joints"

    bias_rad: float = parameter(0.0, "rad", -0.6, 0.6, 0.03)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Less stiffness times the bias, within the limits; what is measured changes beside it."""
        return at.at_motors(location, -at.kp * at.within)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the set points: kp (q* − (q + bias)) = kp ((q* − bias) − q)."""
        position = commands.position.copy()
        position[:, robot.joints_at(self.location)] -= self.bias_rad
        return replace(commands, position=position)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Add the bias to the joint positions."""
        return self._shifted(motion, self.bias_rad, robot)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Subtract the bias from the first joint positions."""
        return self._shifted(start, -self.bias_rad, robot)

    def _shifted(self, motion: Motion, angle: float, robot: Robot) -> Motion:
        qpos: np.ndarray = motion.qpos.copy()
        qpos[:, robot.joint_qpos[robot.joints_at(self.location)]] += angle
        return replace(motion, qpos=qpos)


@dataclass(frozen=True)
class FrameTilt(Effect):
    """The reported pose and velocity of the base are the true ones turned about the world's origin.

    The turn is a roll about x, then a pitch about y. Joints, and the angular velocity in the axes of the base, are
    reported as they are.
    """

    name = "frame_tilt"
    words = "tilt of the measuring frame (motion capture)"
    by_default = False
    needs_base = True

    roll_rad: float = parameter(0.0, "rad", -0.3, 0.3, 0.03)
    pitch_rad: float = parameter(0.0, "rad", -0.3, 0.3, 0.03)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Turn the state of the base."""
        return self._turned(motion, lean(self.roll_rad, self.pitch_rad), robot)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Turn the first state of the base back."""
        return self._turned(start, (lean(self.roll_rad, self.pitch_rad) * np.array([1.0, -1.0, -1.0, -1.0])), robot)

    def _turned(self, motion: Motion, turn: np.ndarray, robot: Robot) -> Motion:
        if self.is_nominal or not robot.has_free_base:
            return motion
        qpos, qvel = motion.qpos.copy(), motion.qvel.copy()
        qpos[:, POSITION_SLICE] = rotated(motion.base_position, turn)
        qvel[:, VELOCITY_SLICE] = rotated(motion.base_velocity, turn)
        for true, reported in zip(motion.base_quaternion, qpos[:, QUATERNION_SLICE], strict=True):
            mujoco.mju_mulQuat(reported, turn, true)
        return replace(motion, qpos=qpos, qvel=qvel)


@dataclass(frozen=True)
class StateLatency(Effect):
    """The log's pose and velocity of the base are those of ``delay_s`` earlier.

    Between rows the state is interpolated linearly (attitude: chord of the quaternions). The true start of a
    piece within a log is what the log reports ``delay_s`` later. At a log's first row, and before it, the base is taken
    to move with its reported velocity: exact for a robot that stands, and with the noise of one row. The velocity of
    others is wrong by acceleration times delay, the position by half of that times the delay.
    """

    name = "state_latency"
    words = "latency of the base state estimate"
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


@dataclass(frozen=True)
class SamplePeriod(Effect):
    """Ratio of the true to the logged period of a row; each command is held for the true period.

    The ratio depends on the load of the computer, so it may differ from log to log and within a log.
    """

    name = "sample_period"
    words = "sample period error"
    differs_per_log = True

    scale: float = parameter(1.0, "1", 0.5, 1.9, 1.07)
    profile: tuple[float, ...] = ()
    """True length of a row over ``scale``, at rows evenly spaced from the log's first to its last; empty: 1."""

    def with_profile(self, profile: tuple[float, ...]) -> "SamplePeriod":
        """The effect with this profile of row lengths."""
        return replace(self, profile=profile)

    def extend_to(self, rows: int, all_rows: int) -> "SamplePeriod":
        """The effect with one value a row; after the rows that the profile was fitted on, the last value holds."""
        if not self.profile:
            return self
        at = np.linspace(0, rows - 1, len(self.profile))
        return replace(self, profile=tuple(np.interp(np.arange(all_rows), at, self.profile).tolist()))

    def change_period(self, period_s: float) -> float:
        """Scale the period of a row; the number of simulation steps of a row stays."""
        return period_s * self.scale

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """Scale the length of each row by the profile."""
        if not self.profile:
            return lengths
        at = np.linspace(0, len(lengths) - 1, len(self.profile))
        return np.asarray(lengths * np.interp(np.arange(len(lengths)), at, self.profile))


@dataclass(frozen=True)
class Numerics(Effect):
    """Length of the steps of the simulation that moves as the log does, over that of the replay's own steps.

    0 is the limit of short steps: then a finer simulation closes the gap, and the model is right. 2 is a log of a
    simulation with steps twice as long. The error of a step is taken as proportional to its length; a replay with this
    effect is made of one by the usual steps and one by steps of a quarter.
    """

    name = "numerics"
    words = "integration error of the simulator"
    by_default = False

    step_ratio: float = parameter(1.0, "1", 0.0, 4.0, 0.25, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From the limit of short steps, which is an answer, upwards."""
        (declared,) = super().parameters(robot, location)
        return (replace(declared, lower_is_physical=True),)

    def change_step(self, ratio: float) -> float:
        """Scale the length of a step."""
        return ratio * self.step_ratio
