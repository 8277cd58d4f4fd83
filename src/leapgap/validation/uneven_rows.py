"""Logs whose rows do not last one period each, and which show samples that are not of their row.

Every family says, for a planned log, how long the controller holds each command, which of these rows are written, and
which rows show the sample of the row before. The simulation then runs on these instants. Nothing here knows how a
diagnosis finds a clock.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.segments import Segment
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.validation.off_table.base import OffTableEffect


@dataclass(frozen=True)
class Timing:
    """How the rows of a log come about from those of its plan."""

    held: np.ndarray
    """How long each planned command is held, in claimed periods, (planned rows,); 0 where the next one replaces it."""
    written: np.ndarray
    """Whether the log has this row, bool, (planned rows,)."""
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

    lengths: np.ndarray | None = None
    """True length of each row, in claimed periods, (rows,); None: one."""
    shown: np.ndarray | None = None
    """The row whose sample each row shows, of the base and of each limb, (rows, 1 + limbs); None: its own."""

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


@dataclass(frozen=True)
class ClockFamily(ABC):
    """One way in which logs get rows that are not what they claim; its fields are its sizes."""

    name: ClassVar[str]

    @abstractmethod
    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """The timing of one log of so many planned rows."""

    @property
    def sizes(self) -> dict[str, float]:
        """Its fields as a mapping, for the truth of a case."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True)
class LateWriter(ClockFamily):
    """A loop that wakes when it is let: rows last 0 to 3 periods."""

    name = "late_writer"

    share: float
    """Share of the rows that do not last one period."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Draw the length of every row on its own."""
        chance = (0.35 * self.share, 1 - self.share, 0.45 * self.share, 0.2 * self.share)
        return replace(Timing.even(rows, limbs), held=rng.choice(4, rows, p=chance).astype(float))


@dataclass(frozen=True)
class LostRows(ClockFamily):
    """Rows that never reached the file, while the robot went on: a row lasts one or several periods."""

    name = "lost_rows"

    share: float
    """Share of the rows that are lost."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Lose every row but the first with the same chance."""
        written = rng.random(rows) >= self.share
        written[0] = True
        return replace(Timing.even(rows, limbs), written=written)


@dataclass(frozen=True)
class Stalls(ClockFamily):
    """A loop that hangs now and then for 4 to 12 periods, while the last command is held."""

    name = "stalls"

    per_1000: float
    """Mean number of stalls in 1000 rows."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Draw the instants of the stalls and their lengths."""
        held = np.ones(rows)
        hangs = rng.random(rows) < self.per_1000 / 1000
        held[hangs] = rng.uniform(4.0, 12.0, int(hangs.sum()))
        return replace(Timing.even(rows, limbs), held=held)


@dataclass(frozen=True)
class StaleSamples(ClockFamily):
    """Messages that come too late for their row, which then shows the sample of the row before; rows are even."""

    name = "stale_samples"

    share: float
    """Share of the rows, of the base and of each limb on its own."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Draw for the base and each limb which rows lack a new sample; the first row has one."""
        stale = rng.random((rows, 1 + limbs)) < self.share
        stale[0] = False
        return replace(Timing.even(rows, limbs), stale=stale)


@dataclass(frozen=True)
class Drift(ClockFamily):
    """A period that changes slowly within a log: half a wave to one and a half, from any phase."""

    name = "drift"

    size: float
    """Largest change of the period, as a share of it."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Draw the number of waves and the phase."""
        waves, phase = rng.uniform(0.5, 1.5), rng.uniform(0, 2 * np.pi)
        wave = np.sin(2 * np.pi * waves * np.arange(rows) / rows + phase)
        return replace(Timing.even(rows, limbs), held=1 + self.size * wave)


@dataclass(frozen=True)
class OtherPeriod(ClockFamily):
    """A period that is a whole number of steps of the simulation, but not of as many as the log claims."""

    name = "other_period"

    length: float
    """True over claimed period; rounded to quarters, other than 1."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Every row lasts the same."""
        quarters = round(4 * self.length)
        return replace(Timing.even(rows, limbs), held=np.full(rows, (5 if quarters == 4 else quarters) / 4))


@dataclass(frozen=True)
class LateMessages(ClockFamily):
    """A loop that wakes late, hangs now and then and shows late messages, all at once."""

    name = "late_messages"

    share: float
    """Share of the rows that do not last one period, and of the messages that come too late for their row."""
    per_1000: float
    """Mean number of stalls in 1000 rows."""

    def draw(self, rows: int, limbs: int, rng: np.random.Generator) -> Timing:
        """Draw each as in the families of their own."""
        wakes = LateWriter(self.share).draw(rows, limbs, rng).held
        hangs = Stalls(self.per_1000).draw(rows, limbs, rng).held
        stale = StaleSamples(self.share / 2).draw(rows, limbs, rng).stale
        return Timing(np.where(hangs > 1, hangs, wakes), np.ones(rows, dtype=bool), stale)


FAMILIES: Mapping[str, type[ClockFamily]] = {
    kind.name: kind for kind in (LateWriter, LostRows, Stalls, StaleSamples, Drift, OtherPeriod, LateMessages)
}
"""All families by name."""


def clock_family(name: str, sizes: Mapping[str, Any]) -> ClockFamily:
    """The family of this name with these sizes; an unknown name is an ``InputError``."""
    if name not in FAMILIES:
        raise InputError("withhold", f"clock family {name}", f"one of {', '.join(FAMILIES)}", "correct the name")
    return FAMILIES[name](**sizes)


def draw_timings(
    family: ClockFamily | None, rows: Sequence[int], robot: Robot, rng: np.random.Generator
) -> list[Timing | None]:
    """A timing for each log of so many planned rows; None where the rows are what they claim."""
    if family is None:
        return [None] * len(rows)
    return [family.draw(number, len(limbs_of(robot)), rng) for number in rows]
