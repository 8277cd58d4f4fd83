"""What is compared between logs and replays: rows, channels, sensors and their scales, chosen from the logs alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.diagnosis.channels import (
    BASE_TURNS,
    JUMP,
    Channel,
    is_logged,
    jump_channels,
    logged_channels,
    sensor_noise,
    sized_channels,
)
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.contacts import has_feet_in_world, sole_heights
from leapgap.logs.log import Log
from leapgap.logs.metadata import FLIGHT, TOUCH_DOWN
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion
from leapgap.simulation.rollout import Rollout

LEAST_SHARE, MOST_SHARE = 0.5, 2.0
"""Over a log an accelerometer measures gravity on average, and feet bear the weight; within these factors."""
GAIN_CHANGE_MARGIN_S = 0.010
"""Time left out before a change of gains, which reaches the motors at an unknown instant near its row."""
SURELY_IN_FLIGHT = 1 / 3  # After this share of the planned flight no foot can still be at the ground from before
TOUCHING_M = 0.005  # Largest height of a sole above the ground that counts as touching


@dataclass(frozen=True)
class ScoredSensors:
    """Columns of sensors that are compared, and why others are not."""

    columns: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot) -> "ScoredSensors":
        """The sensors of some logs."""
        can = sensor_columns(robot)
        columns: list[str] = []
        notes: list[str] = []
        for group, quantity, lack in (
            (IMU_ACCELERATION, "imu_acc", "the model has neither an accelerometer nor a site of an IMU"),
            (tuple(FOOT_FORCE + foot for foot in robot.feet), "foot_force", "the model has no such feet"),
        ):
            if not any(name.startswith(quantity) and is_logged(log, name) for log in logs for name in log.columns):
                continue
            if not group or any(name not in can for name in group):
                notes.append(f"{quantity} ({lack})")
            elif not all(is_logged(log, name) for log in logs for name in group):
                notes.append(f"{quantity} (some log lacks some of {', '.join(group)})")
            else:
                doubt = acceleration_doubt(logs, robot) if group == IMU_ACCELERATION else force_doubt(logs, robot)
                notes += [f"{quantity} ({doubt})"] if doubt else []
                columns += [] if doubt else group
        return ScoredSensors(tuple(columns), tuple(notes))


def acceleration_doubt(logs: Sequence[Log], robot: Robot) -> str | None:
    """Why an accelerometer is none, in words; None where it measures gravity."""
    gravity = float(np.linalg.norm(robot.model.opt.gravity))
    mean = float(np.mean([np.linalg.norm(log.stack(IMU_ACCELERATION), axis=1).mean() for log in logs]))
    if LEAST_SHARE * gravity < mean < MOST_SHARE * gravity:
        return None
    return (
        f"its mean is {mean:.2g} m/s² where gravity alone gives {gravity:.2f}: gravity was removed, or the unit differs"
    )


def force_doubt(logs: Sequence[Log], robot: Robot) -> str | None:
    """Why forces of the feet are none, in words; None where they bear the weight of the robot."""
    weight = robot.total_mass * float(np.linalg.norm(robot.model.opt.gravity))
    names = [FOOT_FORCE + foot for foot in robot.feet]
    borne = float(np.mean([log.stack(names).sum(axis=1).mean() for log in logs])) / weight
    if LEAST_SHARE < borne < MOST_SHARE:
        return None
    return f"the feet bear {borne:.2g} of the robot's weight: the unit is not N, or something else bears it"


def headline_rows(log: Log, robot: Robot) -> int:
    """Number of judged rows: up to touch-down or the first change of gains, whichever is first."""
    rows = log.rows_before_gain_change
    if rows < len(log):
        rows -= round(GAIN_CHANGE_MARGIN_S / log.info.sample_period_s)
    return max(2, min(rows, touch_down_row(log, robot)))


def touch_down_row(log: Log, robot: Robot) -> int:
    """First row after the beginning of flight in which a sole is at the ground; all rows of a log without a flight."""
    if not is_jump(log):
        return len(log)
    flight = next(segment for segment in log.info.segments if segment.name == FLIGHT)
    if not has_feet_in_world(log, robot):
        return min(len(log), int(np.searchsorted(log.time, flight.end_s)) + 1)
    begin = int(np.searchsorted(log.time, flight.begin_s + SURELY_IN_FLIGHT * (flight.end_s - flight.begin_s)))
    if begin >= len(log):
        return len(log)
    touching = (sole_heights(log, robot, slice(begin, None)) < TOUCHING_M).any(axis=1)
    return begin + int(np.argmax(touching)) if touching.any() else len(log)


@dataclass(frozen=True)
class JudgedLogs:
    """Logs with the rows and channels that are compared; the one holder of each log's states and noise."""

    robot: Robot
    whole: tuple[States, ...]  # States of all rows of each log
    states: tuple[States, ...]  # Those of the judged rows
    sensors: ScoredSensors  # Columns beside the state that are compared
    logged: tuple[Channel, ...]  # Channels that every log has
    channels: tuple[Channel, ...]  # Those of the headline gap, with their sizes
    mapped: tuple[Channel, ...]  # Those of the map of where the gap lies
    preset: str  # ``jump`` for the planar channels of jumps at fixed sizes, ``all`` for every channel by its spread
    row_weights: tuple[float, ...] = ()
    """How many rows each row of a log stands for, by log, where some were written at one instant; empty: one."""

    @staticmethod
    def of(
        logs: Sequence[Log],
        robot: Robot,
        sizes: Mapping[str, float] | None = None,
        rows: Sequence[int] | None = None,
    ) -> "JudgedLogs":
        """Choose rows and channels from the logs alone, so that every hypothesis is judged on the same ones.

        ``sizes`` of channels, by name or quantity, stand in place of their spread; ``rows`` of the logs that are judged
        in place of those that the logs ask for.
        """
        if not logs:
            raise InputError("logs", "no log", "one or more", "convert your logs first: leapgap import")
        logged = logged_channels(logs, robot)
        if not logged:
            expected = "positions of the joints, or the state of the base, in every log"
            raise InputError(logs[0].name, "nothing measured that every log has", expected, "log it")
        planar = jump_channels(logged)
        of_jumps = bool(planar) and not sizes and all(is_jump(log) or "schedule" in log.info.extra for log in logs)
        sensors = ScoredSensors() if of_jumps else ScoredSensors.of(logs, robot)
        whole = tuple(States.of(log, robot, sensors.columns) for log in logs)
        judged = [headline_rows(log, robot) for log in logs] if rows is None else rows
        states = tuple(of_log.first_rows(number) for of_log, number in zip(whole, judged, strict=True))
        if of_jumps:
            names = {*JUMP, *(f"{of}/{joint}" for of in ("joint_pos", "joint_vel") for joint in robot.joints)}
            joints = tuple(channel for channel in logged if channel.name in names)
            return JudgedLogs(robot, whole, states, sensors, logged, planar, joints, "jump")
        logged = logged_channels(logs, robot, sensors.columns)
        every = sized_channels([of_log.motion for of_log in states], logged, robot, sizes or {})
        return JudgedLogs(robot, whole, states, sensors, logged, every, every, "all")

    @cached_property
    def logs(self) -> tuple[Log, ...]:
        """Logs, cut after the judged rows."""
        return tuple(of_log.log for of_log in self.states)

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """Measured motions of the judged rows."""
        return tuple(of_log.motion for of_log in self.states)

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """Number of judged rows of each log."""
        return tuple(len(log) for log in self.logs)

    @cached_property
    def value_counts(self) -> np.ndarray:
        """Number of compared values of each log, (logs,), counted as its rows are weighted."""
        counts = np.array(self.rows) * len(self.channels)
        return counts * np.array(self.row_weights) if self.row_weights else counts

    @cached_property
    def scales(self) -> np.ndarray:
        """Size of each channel, (channels,)."""
        return np.array([c.scale for c in self.channels], dtype=float)

    @cached_property
    def noise(self) -> tuple[dict[str, float], ...]:
        """Standard deviation of the sensor noise of each log by channel, for all that were logged."""
        names = [channel.name for channel in self.logged]
        return tuple(dict(zip(names, self.noise_of(of), strict=True)) for of in self.states)

    def noise_of(self, states: States) -> np.ndarray:
        """Standard deviation of the sensor noise of one log, (channels that were logged,)."""
        log = states.log
        return sensor_noise(states.motion, log.info.sample_period_s, self.logged, self.robot, log.uneven_steps)

    def noise_in(self, channels: Sequence[Channel]) -> list[np.ndarray]:
        """Standard deviation of the sensor noise of each log in some channels, (channels,) each."""
        return [np.array([of_log[channel.name] for channel in channels]) for of_log in self.noise]

    def start_noise(self, log: int, row: int = 0) -> np.ndarray:
        """Noise of the state in a row of a log, (nq + nv,), in the channels of the map and in what was not measured.

        An orientation is disturbed as the imaginary part of its quaternion, for small angles.
        """
        robot, deviation = self.robot, self.states[log].deviation[row]
        nq, nv = robot.model.nq, robot.model.nv
        found = np.concatenate([np.zeros(nq), deviation[nv:]])
        if robot.has_free_base:
            found[POSITION_SLICE] = deviation[VELOCITY_SLICE]
        for channel in filter(lambda channel: channel.is_state, self.mapped):
            sigma = self.noise[log][channel.name]
            if channel.entry >= nv:
                found[nq + channel.entry - nv] = sigma
            elif channel.quantity == "base_turn":
                found[QUATERNION_SLICE][1 + BASE_TURNS.index(channel.name)] = sigma / 2
            elif channel.quantity == "base_pos":
                found[channel.entry] = sigma
            else:
                (joint,) = np.flatnonzero(robot.joint_dofs == channel.entry)
                found[robot.joint_qpos[joint]] = sigma
        return found

    def trials(self, effects: Sequence[tuple[Effect, ...]] | None = None) -> list[Rollout]:
        """Replays of the judged rows of each log, with its own effects."""
        return trials_of(self.states, effects)

    def whole_trials(self, effects: Sequence[tuple[Effect, ...]] | None = None) -> list[Rollout]:
        """Replays of all rows of each log, with its own effects."""
        return trials_of(self.whole, effects)


def trials_of(states: Sequence[States], effects: Sequence[tuple[Effect, ...]] | None) -> list[Rollout]:
    """One replay of each log, from its measured states; None: by the nominal robot."""
    own = [()] * len(states) if effects is None else effects
    return [Rollout(of.log, acting, measured=of.motion) for of, acting in zip(states, own, strict=True)]


def is_jump(log: Log) -> bool:
    """Whether a log states a flight and its touch-down."""
    return {FLIGHT, TOUCH_DOWN} <= {segment.name for segment in log.info.segments}
