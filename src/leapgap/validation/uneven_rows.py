"""Logs whose rows do not last one period each, and which show samples that are not of their row.

Every family says, for a planned log, how long the controller holds each command, which of these rows are written, and
which rows show the sample of the row before. The simulation then runs on these instants. Nothing here knows how a
diagnosis finds a clock.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.metadata import Segment
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.validation.off_table import OffTableEffect


@dataclass(frozen=True)
class Timing:
    """How the rows of a log come about from those of its plan."""

    held: np.ndarray  # for how many claimed periods each planned command is held, (planned rows,); 0: replaced
    written: np.ndarray  # whether the log has this row, bool, (planned rows,)
    stale: np.ndarray
    """Whether the row shows the sample of the written row before, of the base and of each limb, bool, (planned rows,
    1 + limbs)."""

    @staticmethod
    def even(rows: int, limbs: int) -> "Timing":
        """Rows of one period with samples of their own."""
        return Timing(np.ones(rows), np.ones(rows, dtype=bool), np.zeros((rows, 1 + limbs), dtype=bool))

    @property
    def instants(self) -> np.ndarray:
        """When each written row was written, in claimed periods since the first, (rows,)."""
        begins = np.concatenate([[0.0], np.cumsum(self.held[:-1])])
        return np.asarray(begins[self.written])

    @property
    def shown(self) -> np.ndarray:
        """The written row whose sample each written row shows, of the base and of each limb, (rows, 1 + limbs)."""
        stale = self.stale[self.written]
        return np.maximum.accumulate(np.where(stale, 0, np.arange(len(stale))[:, None]), axis=0)


@dataclass(frozen=True)
class UnevenRows(OffTableEffect):
    """Rows of these lengths and with these samples, of one log."""

    name = "uneven_rows"

    lengths: np.ndarray | None = None  # true length of each row, in claimed periods, (rows,); None: one
    shown: np.ndarray | None = None  # row whose sample each shows, of base and limbs; None: its own

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """True lengths of the rows."""
        return lengths if self.lengths is None else lengths * self.lengths[: len(lengths)]

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """The motion with the samples that the rows show."""
        if self.shown is None:
            return motion
        rows, qpos, qvel = self.shown[: len(motion)], motion.qpos.copy(), motion.qvel.copy()
        limbs = limbs_of(robot)
        of_joint = [1 + limbs.index(robot.limb_of(joint)) for joint in robot.joints]
        of_qpos, of_qvel = np.zeros(qpos.shape[1], dtype=int), np.zeros(qvel.shape[1], dtype=int)
        of_qpos[robot.joint_qpos], of_qvel[robot.joint_dofs] = of_joint, of_joint
        qpos = np.take_along_axis(qpos, rows[:, of_qpos], axis=0)
        qvel = np.take_along_axis(qvel, rows[:, of_qvel], axis=0)
        return replace(motion, qpos=qpos, qvel=qvel)


def limbs_of(robot: Robot) -> tuple[str, ...]:
    """The limbs whose joints come in one message each."""
    return tuple(dict.fromkeys(robot.limb_of(joint) for joint in robot.joints))


def uneven_rows(timing: Timing) -> UnevenRows:
    """The effect of a timing on the log that was written by it; its last row lasts one period."""
    return UnevenRows(lengths=np.append(np.diff(timing.instants), 1.0), shown=timing.shown)


def written_log(log: Log, timing: Timing) -> Log:
    """The rows of a log that were written, which claim to last one period each.

    Intervals that the log names are moved with their rows. The log is returned as it is where every row was written.
    """
    if timing.written.all():
        return log
    columns = {name: values[timing.written] for name, values in log.columns.items()}
    rows = np.flatnonzero(timing.written)
    columns["time"] = log.time[: len(rows)].copy()

    def claimed(time_s: float) -> float:
        return float(np.interp(time_s, log.time[rows], columns["time"]))

    segments = tuple(Segment(one.name, claimed(one.begin_s), claimed(one.end_s)) for one in log.info.segments)
    return replace(log, columns=columns, info=replace(log.info, stated_segments=segments))


def late_writer(even: Timing, rng: np.random.Generator, share: float) -> Timing:
    """A loop that wakes when it is let: a ``share`` of the rows lasts 0, 2 or 3 periods, each drawn on its own."""
    chance = (0.35 * share, 1 - share, 0.45 * share, 0.2 * share)
    return replace(even, held=rng.choice(4, len(even.held), p=chance).astype(float))


def lost_rows(even: Timing, rng: np.random.Generator, share: float) -> Timing:
    """A ``share`` of the rows, never the first, that never reached the file, while the robot went on."""
    written = rng.random(len(even.held)) >= share
    written[0] = True
    return replace(even, written=written)


def stalls(even: Timing, rng: np.random.Generator, per_1000: float) -> Timing:
    """A loop that hangs for 4 to 12 periods in so many of 1000 rows, while the last command is held."""
    held = np.ones(len(even.held))
    hangs = rng.random(len(held)) < per_1000 / 1000
    held[hangs] = rng.uniform(4.0, 12.0, int(hangs.sum()))
    return replace(even, held=held)


def stale_samples(even: Timing, rng: np.random.Generator, share: float) -> Timing:
    """Messages of the base and of each limb that come too late for a ``share`` of the rows, which repeat the last."""
    stale = rng.random(even.stale.shape) < share
    stale[0] = False
    return replace(even, stale=stale)


def drift(even: Timing, rng: np.random.Generator, size: float) -> Timing:
    """A period that changes by up to a share ``size``: half a wave to one and a half, from any phase."""
    waves, phase = rng.uniform(0.5, 1.5), rng.uniform(0, 2 * np.pi)
    rows = len(even.held)
    return replace(even, held=1 + size * np.sin(2 * np.pi * waves * np.arange(rows) / rows + phase))


def other_period(even: Timing, rng: np.random.Generator, length: float) -> Timing:
    """A period of ``length`` claimed ones, rounded to quarters other than 1: whole steps of the simulation."""
    quarters = round(4 * length)
    return replace(even, held=np.full(len(even.held), (5 if quarters == 4 else quarters) / 4))


def late_messages(even: Timing, rng: np.random.Generator, share: float, per_1000: float) -> Timing:
    """A loop that wakes late, hangs now and then and shows late messages, all at once."""
    wakes, hangs = late_writer(even, rng, share).held, stalls(even, rng, per_1000).held
    return replace(stale_samples(even, rng, share / 2), held=np.where(hangs > 1, hangs, wakes))


FAMILIES: Mapping[str, Callable[..., Timing]] = {
    draw.__name__: draw for draw in (late_writer, lost_rows, stalls, stale_samples, drift, other_period, late_messages)
}
"""Ways in which logs get rows that are not what they claim, by name: from an even timing, drawn by sizes."""


@dataclass(frozen=True)
class ClockFamily:
    """One of these ways with its sizes; an unknown name is an ``InputError``."""

    name: str
    sizes: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.name not in FAMILIES:
            expected = f"one of {', '.join(FAMILIES)}"
            raise InputError("withhold", f"clock family {self.name}", expected, "correct the name")

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """The timing of one log of so many planned rows."""
        return FAMILIES[self.name](Timing.even(rows, limbs), rng, **self.sizes)
