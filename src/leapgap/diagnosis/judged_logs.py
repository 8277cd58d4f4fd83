"""What is compared between logs and replays: rows, channels and their scales, chosen from the logs alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import JUMP, Channel, jump_channels, logged_channels, sensor_noise, sized_channels
from leapgap.errors import InputError
from leapgap.logs.contacts import has_feet_in_world, sole_heights
from leapgap.logs.log import Log
from leapgap.logs.segments import FLIGHT, TOUCH_DOWN
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion

GAIN_CHANGE_MARGIN_S = 0.010
"""Time left out before a change of gains, which reaches the motors at an unknown instant near its row."""
SURELY_IN_FLIGHT = 1 / 3
"""After this share of the planned flight no foot can still be at the ground from before."""
TOUCHING_M = 0.005
"""Largest height of a sole above the ground that counts as touching."""


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
    """Logs with the rows and channels that are compared."""

    robot: Robot
    logs: tuple[Log, ...]
    """Logs, cut after the judged rows."""
    motions: tuple[Motion, ...]
    """Their measured motions."""
    channels: tuple[Channel, ...]
    """Channels of the headline gap, which every log has, with their sizes."""
    mapped: tuple[Channel, ...]
    """Channels of the map of where the gap lies."""
    preset: str
    """``jump`` for the planar channels of jumps at fixed sizes, ``all`` for every channel by its spread."""

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot, sizes: Mapping[str, float] | None = None) -> "JudgedLogs":
        """Choose rows and channels from the logs alone, so that every hypothesis is judged on the same ones.

        ``sizes`` of channels, by name or quantity, stand in place of their spread.
        """
        if not logs:
            raise InputError("diagnose.logs", "no log", "one or more", "import or collect logs first")
        logged = logged_channels(logs, robot)
        if not logged:
            expected = "positions of the joints, or the state of the base, in every log"
            raise InputError(logs[0].name, "nothing measured that every log has", expected, "log it")
        cut = tuple(log.first_rows(headline_rows(log, robot)) for log in logs)
        motions = tuple(motion_of(log, robot) for log in cut)
        planar = jump_channels(logged)
        if planar and not sizes and all(is_jump(log) for log in logs):
            joints = [channel for channel in logged if channel.name in planar_and_joints(robot)]
            return JudgedLogs(robot, cut, motions, planar, tuple(joints), "jump")
        every = sized_channels(motions, logged, robot, sizes or {})
        return JudgedLogs(robot, cut, motions, every, every, "all")

    @property
    def rows(self) -> tuple[int, ...]:
        """Number of judged rows of each log."""
        return tuple(len(log) for log in self.logs)

    @property
    def value_counts(self) -> np.ndarray:
        """Number of compared values of each log, (logs,)."""
        return np.array(self.rows) * len(self.channels)

    @property
    def scales(self) -> np.ndarray:
        """Size of each channel, (channels,)."""
        return np.array([c.scale for c in self.channels], dtype=float)

    def noise(self, channels: Sequence[Channel]) -> list[np.ndarray]:
        """Standard deviation of the sensor noise of each log in some channels, (channels,) each."""
        return [
            sensor_noise(motion, log.info.sample_period_s, channels, self.robot)
            for motion, log in zip(self.motions, self.logs, strict=True)
        ]


def is_jump(log: Log) -> bool:
    """Whether a log states a flight and its touch-down."""
    return {FLIGHT, TOUCH_DOWN} <= {segment.name for segment in log.info.segments}


def planar_and_joints(robot: Robot) -> set[str]:
    """Names of the channels in which the gap of jumps is mapped."""
    return {*JUMP, *(f"{quantity}/{joint}" for quantity in ("joint_pos", "joint_vel") for joint in robot.joints)}
