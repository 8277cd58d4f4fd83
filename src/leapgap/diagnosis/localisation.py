"""Localisation of the gap: its share by phase of the motion and channel, above sensor noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from leapgap.diagnosis.channels import Channel, channel_errors
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.logs.log import Log
from leapgap.logs.metadata import segment_of_rows
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

T = TypeVar("T")
MOST_PIECES = 1000  # Largest number of pieces that are replayed of all logs, spread evenly
OUTSIDE = "outside"  # Name of the rows that are in none of the log's segments
RESAMPLES = 200  # Number of resamples of logs and noise for the intervals of the shares
ALIKE = 0.15
"""Left and right that differ by less than this share of their sum are alike: a few logs give too narrow intervals,
and the noise that shares are measured in is known to some per cent."""


@dataclass(frozen=True)
class Place:
    """Share and size of the gap in one segment of the logs and one channel."""

    phase: str  # Name of the segment
    channel: str
    share: float  # Share of the whole squared gap above noise, each channel in units of its noise
    rms: float  # Root mean square of the gap, noise included
    unit: str
    share_ci95: tuple[float, float] = (0.0, 1.0)  # 95 % interval of the share over resampled logs and draws of noise
    as_one_with: str | None = None
    """The channel of the other side, where these logs do not tell left from right; both then have half of their sum."""


def phase_names(logs: Sequence[Log]) -> tuple[str, ...]:
    """Names of the segments of all logs, in the order of their first begin, then ``outside``."""
    segments = sorted((one for log in logs for one in log.segments), key=lambda one: one.begin_s)
    return (*dict.fromkeys(one.name for one in segments), OUTSIDE)


def phase_of_rows(log: Log, names: Sequence[str]) -> np.ndarray:
    """Index into ``names`` of the segment of each row, (rows,)."""
    of_segments = np.array([*(names.index(one.name) for one in log.segments), names.index(OUTSIDE)])
    return of_segments[segment_of_rows(log.segments, log.time)]


@dataclass(frozen=True)
class Piece:
    """Some rows of a log with a replay of their own; it is compared in the second half, after its start settled."""

    log: Log
    measured: Motion
    phases: np.ndarray  # Index of the phase of each row, (rows,)
    phase_number: int  # Number of phases of all logs
    sigma: np.ndarray  # Sensor noise of each channel of its log, (channels,)

    def squares(self, errors: np.ndarray) -> np.ndarray:
        """Sums of squares of errors (rows, channels) by phase, (phases, channels)."""
        half = len(errors) // 2
        phases = self.phases[half:]
        return np.stack([(errors[half:][phases == p] ** 2).sum(axis=0) for p in range(self.phase_number)])

    @property
    def counts(self) -> np.ndarray:
        """Number of compared rows of each phase, (phases,)."""
        return np.bincount(self.phases[len(self.phases) // 2 :], minlength=self.phase_number)


def evenly(values: Sequence[T], most: int) -> list[T]:
    """At most so many values, evenly spread."""
    at = np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int)
    return [values[i] for i in at]


def localise(
    judged: JudgedLogs, replayer: Replayer, horizon_s: float, draws: int, rng: np.random.Generator
) -> list[Place]:
    """The gap by phase and channel, largest share first, with 95 % intervals over logs.

    Replays restart from the log every ``horizon_s``, so that an error counts in the phase in which it arises. The mean
    effect of sensor noise over ``draws`` is subtracted from the shares. Left and right joints whose shares may be equal
    get half of their sum each.
    """
    names, channels = phase_names(judged.logs), judged.mapped
    pieces, starts, of_log = [], [], []
    most = max(1, MOST_PIECES // len(judged.logs))
    for log, sigma in enumerate(judged.noise_in(channels)):
        for piece, phases, first in evenly(pieces_of(judged.logs[log], names, horizon_s), most):
            measured = judged.motions[log][first : first + len(piece)]
            pieces.append(Piece(piece, measured, phases, len(names), sigma))
            starts.append(judged.start_noise(log, first))
            of_log.append(log)
    least = np.array([least_noise(c) for c in channels])
    motions = replayer.motions([Rollout(piece.log, first_state=piece.measured.first_state) for piece in pieces])
    errors = [
        channel_errors(motion, piece.measured, channels, judged.robot)
        for piece, motion in zip(pieces, motions, strict=True)
    ]
    of_noise = noise_errors(pieces, starts, motions, channels, replayer, draws, rng)

    def scaled(of: Sequence[np.ndarray]) -> np.ndarray:
        """Sums of squares in units of noise by log, phase and channel, (logs, phases, channels)."""
        found = np.zeros((len(judged.logs), len(names), len(channels)))
        for log, piece, error in zip(of_log, pieces, of, strict=True):
            found[log] += piece.squares(error / np.maximum(piece.sigma, least))
        return found

    number = np.sum([piece.counts for piece in pieces], axis=0)
    square = np.sum([piece.squares(e) for piece, e in zip(pieces, errors, strict=True)], axis=0)
    shares = Shares.of(scaled(errors), np.stack([scaled(one) for one in of_noise]), rng)
    shares = shares.with_sides(twins_of(channels, judged.robot))
    found = [
        Place(
            names[p],
            c.name,
            float(shares.value[p, k]),
            float(np.sqrt(square[p, k] / number[p])),
            c.unit,
            (float(shares.low[p, k]), float(shares.high[p, k])),
            channels[shares.twin[p, k]].name if shares.twin[p, k] >= 0 else None,
        )
        for p in range(len(names))
        for k, c in enumerate(channels)
        if number[p]
    ]
    return sorted(found, key=lambda place: -place.share)


@dataclass(frozen=True)
class Shares:
    """Shares of the squared gap above noise by phase and channel, and those of resampled logs and noise."""

    value: np.ndarray  # (phases, channels)
    sample: np.ndarray  # (resamples, phases, channels)
    twin: np.ndarray
    """Index of the channel of the other side that a channel is told as one with, (phases, channels); −1: none."""

    @staticmethod
    def of(squares: np.ndarray, noise: np.ndarray, rng: np.random.Generator) -> "Shares":
        """From sums of squares (logs, phases, channels), and those that noise alone gives, (draws, logs, …)."""
        logs, draws = len(squares), len(noise)
        sample = []
        for _ in range(RESAMPLES):
            chosen, of_noise = rng.integers(logs, size=logs), rng.integers(draws, size=draws)
            sample.append(normalised(squares[chosen].sum(axis=0) - noise[of_noise][:, chosen].sum(axis=1).mean(axis=0)))
        value = normalised(squares.sum(axis=0) - noise.sum(axis=1).mean(axis=0))
        return Shares(value, np.array(sample), np.full(value.shape, -1))

    @property
    def low(self) -> np.ndarray:
        """Lower end of the 95 % intervals, (phases, channels), at most the value."""
        return np.minimum(np.percentile(self.sample, 2.5, axis=0), self.value)

    @property
    def high(self) -> np.ndarray:
        """Upper end of the 95 % intervals, (phases, channels), at least the value."""
        return np.maximum(np.percentile(self.sample, 97.5, axis=0), self.value)

    def with_sides(self, twins: Mapping[int, int]) -> "Shares":
        """The same with left and right as one where their difference may be less than ``ALIKE`` of their sum."""
        value, sample, twin = self.value.copy(), self.sample.copy(), self.twin.copy()
        for left, right in twins.items():
            low, high = np.percentile(self.sample[:, :, left] - self.sample[:, :, right], [2.5, 97.5], axis=0)
            both = self.value[:, left] + self.value[:, right]
            one = (low <= ALIKE * both) & (high >= -ALIKE * both) & (both > 0)
            for of in (value, sample):
                mean = (of[..., left] + of[..., right]) / 2
                of[..., left], of[..., right] = np.where(one, mean, of[..., left]), np.where(one, mean, of[..., right])
            twin[one, left], twin[one, right] = right, left
        return Shares(value, sample, twin)


def normalised(squares: np.ndarray) -> np.ndarray:
    """Shares of the positive sums of squares."""
    above = np.maximum(squares, 0.0)
    return np.asarray(above / max(above.sum(), 1e-300))


def twins_of(channels: Sequence[Channel], robot: Robot) -> dict[int, int]:
    """Pairs of channels of left and right joints: index of the one → index of the other."""
    at = {channel.name: k for k, channel in enumerate(channels)}
    found = {}
    for name, k in at.items():
        quantity, slash, joint = name.partition("/")
        first = robot.topology.sides.get(joint, joint)
        if slash and first != joint and f"{quantity}/{first}" in at:
            found[at[f"{quantity}/{first}"]] = k
    return found


def noise_errors(
    pieces: Sequence[Piece],
    starts: Sequence[np.ndarray],
    nominal: Sequence[Motion],
    channels: Sequence[Channel],
    replayer: Replayer,
    draws: int,
    rng: np.random.Generator,
) -> list[list[np.ndarray]]:
    """Errors ``[draw][piece]`` (rows, channels) that sensor noise alone gives, where ``nominal`` are the true motions.

    Every piece is replayed from a first state with noise ``starts`` (nq + nv,), and compared with noisy rows.
    """
    states = [piece.measured.first_state for piece in pieces]
    trials = [
        Rollout(piece.log, first_state=state + rng.standard_normal(len(state)) * noise)
        for _ in range(draws)
        for piece, state, noise in zip(pieces, states, starts, strict=True)
    ]
    motions = iter(replayer.motions(trials))
    found = []
    for _ in range(draws):
        of_pieces = (channel_errors(next(motions), true, channels, replayer.robot) for true in nominal)
        found.append(
            [e - rng.standard_normal(e.shape) * piece.sigma for e, piece in zip(of_pieces, pieces, strict=True)]
        )
    return found


def pieces_of(log: Log, names: Sequence[str], horizon_s: float) -> list[tuple[Log, np.ndarray, int]]:
    """Pieces of one horizon of the judged rows, with the phase of each row, and the first row of each."""
    length = max(4, round(horizon_s / log.info.sample_period_s)) + 1
    phases = phase_of_rows(log, names)
    starts = range(0, len(log) - length + 1, length - 1)
    return [
        (replace(log, columns={k: v[s : s + length] for k, v in log.columns.items()}), phases[s : s + length], s)
        for s in starts
    ]


def least_noise(channel: Channel) -> float:
    """Lower bound of a channel's noise, since logs are rounded to a last digit."""
    return {"m": 1e-3, "rad": 1e-3, "m/s": 1e-2, "rad/s": 1e-2, "m/s²": 1e-1, "N": 1.0}[channel.unit]
