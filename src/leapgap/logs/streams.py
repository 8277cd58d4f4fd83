"""The messages that a log was written from, each with channels that are sampled at the same instants."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.noise import resolution_of
from leapgap.logs.schema import BASE_POSITION, BASE_VELOCITY

BASE = "base"
POSITION, VELOCITY = "joint_pos/", "joint_vel/"  # columns of a joint begin so
NOISE_WINDOW = 20  # rows over which noise is taken; the quietest windows count, since uneven rows scatter moving joints
QUIETEST = 0.02  # share of the windows that is quieter than the noise
MOVES = 3.0  # a channel moves where its velocity carries it by so many deviations of its noise in a row
COUNTS = 2.0  # it also moves by more than so many counts of its encoder: between counts an encoder repeats itself

CURVATURE = 0.1  # error of a mean of two velocities, as a share of their difference
OUTLIER = 2.0  # an equation of motion that misses by more standard deviations counts less and less


@dataclass(frozen=True)
class Stream:
    """Channels that one message brings: their positions and velocities are sampled at the same instants."""

    name: str
    columns: tuple[str, ...]  # all columns of the message
    position: np.ndarray  # (rows, channels), rad or m
    velocity: np.ndarray  # (rows, channels), per s

    @cached_property
    def fresh(self) -> np.ndarray:
        """Whether each row shows a sample that the row before did not, bool, (rows,)."""
        both = np.concatenate([self.position, self.velocity], axis=1)
        return np.concatenate([[True], (np.diff(both, axis=0) != 0).any(axis=1)])

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation of the positions' noise or rounding, (channels,)."""
        return quiet_noise(self.position[self.fresh])

    def moves(self, period_s: float) -> np.ndarray:
        """Whether its velocity moves a channel visibly within a row, for all rows but the last, bool, (rows − 1,)."""
        least = np.maximum(MOVES * self.noise, COUNTS * self.resolution)
        return np.asarray((np.abs(self.velocity[:-1]) * period_s > least).any(axis=1))

    @cached_property
    def resolution(self) -> np.ndarray:
        """Distance between neighbouring values of each position, (channels,): an encoder's count, or the last digit."""
        return resolution_of(self.position)

    def channel(self, chosen: int | Sequence[int]) -> "Stream":
        """The message with some of its channels."""
        at = [chosen] if isinstance(chosen, int) else list(chosen)
        return replace(self, position=self.position[:, at], velocity=self.velocity[:, at])

    def repeats(self, period_s: float) -> float:
        """Share of the rows that repeat the sample of the row before, of those in which a channel moves."""
        moves = self.moves(period_s)
        return float((~self.fresh[1:])[moves].mean()) if moves.any() else 0.0


def quiet_noise(values: np.ndarray) -> np.ndarray:
    """Noise of values (samples, channels) in the windows in which it is least, standard deviation, (channels,)."""
    second = np.diff(values, n=2, axis=0) / np.sqrt(6)
    if len(second) < 2:
        return np.full(values.shape[1], 1e-9)
    windows = np.array_split(second, max(1, len(second) // NOISE_WINDOW))
    spread = np.array([np.sqrt((window**2).mean(axis=0)) for window in windows])
    return np.maximum(np.quantile(spread, QUIETEST, axis=0), 1e-9)


def streams_of(log: Log, joints: Sequence[str]) -> list[Stream]:
    """The messages that a log was written from: joints that repeat together come together, and the base."""
    together: dict[bytes, list[Stream]] = {}
    for joint in joints:
        columns = (f"joint_pos/{joint}", f"joint_vel/{joint}")
        if all(name in log for name in columns):
            stream = Stream(joint, columns, *(log[name][:, None] for name in columns))
            together.setdefault(stream.fresh.tobytes(), []).append(stream)
    merged = [merge(streams) for streams in together.values()]
    if all(name in log for name in (*BASE_POSITION, *BASE_VELOCITY)):
        own = tuple(name for name in log.columns if name.startswith("base_"))
        merged.append(Stream(BASE, own, log.stack(BASE_POSITION), log.stack(BASE_VELOCITY)))
    return merged


def merge(streams: Sequence[Stream]) -> Stream:
    """One message with the channels of several."""
    return Stream(
        streams[0].name,
        tuple(name for stream in streams for name in stream.columns),
        np.concatenate([stream.position for stream in streams], axis=1),
        np.concatenate([stream.velocity for stream in streams], axis=1),
    )


def mean_row(log: Log, streams: Sequence[Stream]) -> float:
    """Mean length of a row by the motion of all joints, s."""
    moved = span = 0.0
    for stream in (stream for stream in streams if stream.name != BASE):
        rows = np.flatnonzero(stream.fresh)
        mean = (stream.velocity[rows][1:] + stream.velocity[rows][:-1]) / 2
        moved += float((np.diff(stream.position[rows], axis=0) * mean).sum())
        span += float((mean**2 * np.diff(rows)[:, None]).sum())
    return moved / span if moved > 0 else log.info.sample_period_s
