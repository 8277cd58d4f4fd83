"""Size of the gap: the headline figure and its noise floor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import (
    HEADLINE,
    Channel,
    channel_values,
    measured_values,
    scaled_channels,
    sensor_noise,
    state_channels,
)
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.contacts import has_feet_in_world, sole_heights
from leapgap.logs.log import Log
from leapgap.logs.segments import FLIGHT, TOUCH_DOWN
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer, Rollout

GAIN_CHANGE_MARGIN_S = 0.010
"""Time left out before a change of gains, which reaches the motors at an unknown instant near its row."""
SURELY_IN_FLIGHT = 1 / 3
"""After this share of the planned flight no foot can still be at the ground from before."""
TOUCHING_M = 0.005
"""Largest height of a sole above the ground that counts as touching."""
DIVERGED_ERROR = 100.0
"""Error assigned to diverged (non-finite) rollouts, and the bound of all scaled errors."""


def headline_rows(log: Log, robot: Robot) -> int:
    """Number of judged rows: up to touch-down or the first change of gains, whichever is first."""
    rows = log.rows_before_gain_change
    if rows < len(log):
        rows -= round(GAIN_CHANGE_MARGIN_S / log.info.sample_period_s)
    return max(2, min(rows, touch_down_row(log, robot)))


def touch_down_row(log: Log, robot: Robot) -> int:
    """First row after the beginning of flight in which a sole is at the ground; all rows of a log without a flight."""
    segments = {segment.name: segment for segment in log.info.segments}
    if not {FLIGHT, TOUCH_DOWN} <= set(segments):
        return len(log)
    flight = segments[FLIGHT]
    if not has_feet_in_world(log, robot):
        return min(len(log), int(np.searchsorted(log.time, flight.end_s)) + 1)
    begin = int(np.searchsorted(log.time, flight.begin_s + SURELY_IN_FLIGHT * (flight.end_s - flight.begin_s)))
    if begin >= len(log):
        return len(log)
    touching = (sole_heights(log, robot, slice(begin, None)) < TOUCHING_M).any(axis=1)
    return begin + int(np.argmax(touching)) if touching.any() else len(log)


def final_position_errors(motions: Sequence[Motion], judged: "JudgedLogs") -> list[float] | None:
    """Error of the trunk's x in the last judged row (touch-down) of each replay, m; None without a base."""
    if all(channel.name != "base_pos_x" for channel in judged.channels):
        return None
    return [
        float(motion.qpos[rows - 1, 0] - log["base_pos_x"][rows - 1])
        for motion, log, rows in zip(motions, judged.logs, judged.rows, strict=True)
    ]


@dataclass(frozen=True)
class JudgedLogs:
    """Logs with the rows and channels that are compared."""

    logs: tuple[Log, ...]
    """Logs, cut after the judged rows."""
    channels: tuple[Channel, ...]
    """Headline channels that every log has."""

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot) -> "JudgedLogs":
        """Choose rows and channels from the logs alone, so that every hypothesis is judged on the same ones."""
        if not logs:
            raise InputError("diagnose.logs", "no log", "one or more", "import or collect logs first")
        headline = tuple(c for c in scaled_channels(logs, robot) if c.name in HEADLINE or not robot.has_free_base)
        if not headline:
            raise InputError(
                logs[0].name,
                "no base state in every log",
                f"some of {', '.join(HEADLINE)}",
                "log the base state",
            )
        return JudgedLogs(tuple(log.first_rows(headline_rows(log, robot)) for log in logs), headline)

    @property
    def rows(self) -> tuple[int, ...]:
        """Number of judged rows of each log."""
        return tuple(len(log) for log in self.logs)

    @property
    def scales(self) -> np.ndarray:
        """Scale of each channel, (channels,)."""
        return np.array([c.scale for c in self.channels], dtype=float)


def scaled_errors(
    judged: JudgedLogs, replayer: Replayer, candidates: Sequence[Sequence[tuple[Effect, ...]]]
) -> list[list[np.ndarray]]:
    """Simulated − measured, scaled, of every candidate on every log: ``[candidate][log]`` (rows, channels).

    ``candidates[c][j]`` are the effects of candidate c on log j; all of them roll out as one batch.
    """
    trials = [
        Rollout(log, effects)
        for of_candidate in candidates
        for log, effects in zip(judged.logs, of_candidate, strict=True)
    ]
    motions = iter(replayer.motions(trials))
    return [[scaled_error(next(motions), log, judged, replayer.robot) for log in judged.logs] for _ in candidates]


def scaled_error(motion: Motion, log: Log, judged: JudgedLogs, robot: Robot) -> np.ndarray:
    """Simulated − measured, scaled, in the judged rows of a log, (rows, channels); ``motion`` may go on longer."""
    difference = channel_values(motion[: len(log)], judged.channels, robot) - measured_values(log, judged.channels)
    return np.clip(np.nan_to_num(difference / judged.scales, nan=DIVERGED_ERROR), -DIVERGED_ERROR, DIVERGED_ERROR)


def motion_squares(motions: Sequence[Motion], judged: JudgedLogs, robot: Robot) -> np.ndarray:
    """Sum of squared scaled errors of one motion for each log, (logs,)."""
    errors = (scaled_error(motion, log, judged, robot) for motion, log in zip(motions, judged.logs, strict=True))
    return np.array([float((error**2).sum()) for error in errors])


def candidate_squares(
    judged: JudgedLogs, replayer: Replayer, candidates: Sequence[Sequence[tuple[Effect, ...]]]
) -> np.ndarray:
    """Sum of squared scaled errors of each candidate on each log, (candidates, logs)."""
    return np.array([[float((e**2).sum()) for e in of_logs] for of_logs in scaled_errors(judged, replayer, candidates)])


def value_counts(judged: JudgedLogs) -> np.ndarray:
    """Number of values in each log's sum of squares, (logs,)."""
    return np.array(judged.rows) * len(judged.channels)


def headline_gap(sum_of_squares: np.ndarray, judged: JudgedLogs) -> float:
    """The headline gap: root mean square over rows, channels and logs."""
    return float(np.sqrt(sum_of_squares.sum() / value_counts(judged).sum()))


def noise_floor(
    judged: JudgedLogs,
    replayer: Replayer,
    draws: int,
    rng: np.random.Generator,
    nominal: Sequence[Motion] | None = None,
) -> np.ndarray:
    """Mean sum of squares that sensor noise alone gives for each log, (logs,), summed over rows and channels.

    The motion of the nominal robot plus noise of each channel is taken as measured, and replayed from its noisy first
    row. ``nominal`` are its motions, where they are known already.
    """
    robot = replayer.robot
    every = scaled_channels(judged.logs, robot)
    total = np.zeros(len(judged.logs))
    sigma = [dict(zip((c.name for c in every), sensor_noise(log, every), strict=True)) for log in judged.logs]
    motions = nominal or replayer.motions([Rollout(log) for log in judged.logs])
    true = [motion[: len(log)] for motion, log in zip(motions, judged.logs, strict=True)]
    for _ in range(draws):
        trials = []
        for log, own in zip(judged.logs, sigma, strict=True):
            state = replayer.first_state(Rollout(log))
            trials.append(Rollout(log, first_state=state + rng.standard_normal(len(state)) * state_noise(own, robot)))
        for j, motion in enumerate(replayer.motions(trials)):
            for c in judged.channels:
                seen = c.values(true[j], robot) + rng.standard_normal(judged.rows[j]) * sigma[j][c.name]
                total[j] += float((((c.values(motion, robot) - seen) / c.scale) ** 2).sum())
    return total / draws


def state_noise(sigma: Mapping[str, float], robot: Robot) -> np.ndarray:
    """Noise of the first state, (nq + nv,), where it was measured; orientation only in pitch, about y.

    ``sigma`` is the noise of the headline's and the joints' channels by name.
    """
    noise_of = Motion(np.zeros((1, robot.model.nq)), np.zeros((1, robot.model.nv)))
    for channel in state_channels(robot):
        known = float(sigma.get(channel.name, 0.0))
        if channel.name == "base_pitch":
            noise_of.base_quaternion[0, 2] = known / 2
        elif channel.quantity != "base_turn":
            channel.values(noise_of, robot)[:] = known
    return noise_of.first_state
