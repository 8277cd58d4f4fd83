"""What numbers say of columns: which go together, slopes of positions, factors between them, torques of a joint PD."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap.logs.consistency import integral
from leapgap.logs.importers.tables import Table
from leapgap.robot.model import Robot

MOST_ROWS = 20_000  # rows that are looked at: patterns show in a part of a long log
MOST_MEANT, SPAN_S = 10, 0.1
"""Rows, and at most so many s, over which rates are means: ticks of encoders are then small, and motions are not."""
CLEAR = 0.8  # correlation from which on two columns belong together
BETTER = 0.1  # another order, or the opposite sign, must be better by this much
LATEST = 0.25  # what the longest delay costs of a correlation: of two explanations the faster one is believed
DELAYS = 12
MARGIN_RAD = 0.1  # positions may lie beyond the limits by this much: play, soft stops
TURN_RAD = 2 * math.pi - 0.2  # limits further apart are no stops: the joint may turn over, whatever the file says
SPUN_RAD = 3 * math.pi  # a joint without stops that is further from zero is rather one of another unit


def usable_rows(clock: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The first ``MOST_ROWS`` rows in which all numbers are finite and the clock is later than before; indices."""
    rows = np.flatnonzero(np.isfinite(np.column_stack([clock, values])).all(axis=1))
    later = np.diff(np.maximum.accumulate(clock[rows]), prepend=-np.inf) > 0
    return rows[later][:MOST_ROWS]


def rows_meant(step_s: float) -> int:
    """Number of rows over which rates are means, by the step of the clock."""
    return int(np.clip(round(SPAN_S / step_s), 1, MOST_MEANT))


def mean_rates(time: np.ndarray, position: np.ndarray, rows: int) -> np.ndarray:
    """Mean rates of positions, (m, n), from each row to that some ``rows`` later, (m − rows, n)."""
    return (position[rows:] - position[:-rows]) / (time[rows:] - time[:-rows])[:, None]


def mean_values(time: np.ndarray, velocity: np.ndarray, rows: int) -> np.ndarray:
    """Means of velocities, (m, n), over the same rows: what their mean rates are of a position with that rate."""
    return mean_rates(time, integral(velocity, time), rows)


def factors(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """What each column of the second table is multiplied by to be that of the first, by least squares, (n,)."""
    return (first * second).sum(axis=0) / np.maximum((second**2).sum(axis=0), 1e-300)


@dataclass(frozen=True)
class Match:
    """How columns of one table go with those of another, one value for each of the first."""

    of: np.ndarray  # index of the column of the second table
    sign: np.ndarray  # −1 where that is a mirror image, else 1
    lag: np.ndarray  # how many rows later the second one is
    correlation: np.ndarray  # at that lag and with that sign
    clear: np.ndarray  # whether the two belong together; False where the first does not move

    @property
    def moved(self) -> bool:
        """Whether another order than that of the columns is found."""
        return bool((self.of != np.arange(len(self.of))).any())


def match(first: np.ndarray, second: np.ndarray, latest: int, named: bool) -> Match:
    """Match columns, (rows, n) each; the second ones may be late by rows up to ``latest``, or early where negative.

    Orders are tried before signs: the columns as they stand, then in another order, then as mirror images; where names
    of joints state the order, signs come first.
    """
    lags = np.unique(np.round(np.linspace(0, abs(latest), DELAYS)).astype(int)) * (1 if latest >= 0 else -1)
    lags = lags[np.argsort(np.abs(lags))]
    found = np.nan_to_num(np.stack([correlations(*shifted(first, second, int(lag))) for lag in lags]))
    cost = (LATEST * np.abs(lags) / max(1, abs(latest)))[:, None, None]

    def best(signed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = np.argmax(signed - cost, axis=0)[None]
        return (*(np.take_along_axis(one, at, axis=0)[0] for one in (signed, signed - cost)), lags[at[0]])

    (plus, plus_score, plus_lag), (minus, minus_score, minus_lag) = best(found), best(-found)
    turned = (minus_score > plus_score + BETTER) & (minus > CLEAR)
    of = None if named else order_of(np.where(turned, 0.0, plus), np.where(turned, 0.0, plus_score))
    if of is None:
        of = order_of(np.where(turned, minus, plus), np.where(turned, minus_score, plus_score))
    joints = np.arange(first.shape[1])
    at = (joints, joints if of is None else of)
    return Match(
        at[1],
        np.where(turned[at], -1.0, 1.0),
        np.where(turned[at], minus_lag[at], plus_lag[at]),
        np.where(turned, minus, plus)[at],
        np.where(turned, minus, plus)[at] > CLEAR,
    )


def order_of(correlation: np.ndarray, score: np.ndarray) -> np.ndarray | None:
    """The order in which every column has its partner, that of the columns if it does; None where no order does."""
    from scipy.optimize import linear_sum_assignment

    if (np.diag(correlation) > CLEAR).all():
        return np.arange(len(correlation))
    rows, columns = linear_sum_assignment(-score)
    better = score[rows, columns].mean() > np.diag(score).mean() + BETTER
    return columns if better and (correlation[rows, columns] > CLEAR).all() else None


def shifted(first: np.ndarray, second: np.ndarray, lag: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows that belong together where the second table is later by ``lag`` rows."""
    rows = len(first) - abs(lag)
    return first[max(0, -lag) :][:rows], second[max(0, lag) :][:rows]


def correlations(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Correlation of each column of one table with each of another, (n, m); NaN for columns that do not change."""

    def unit(values: np.ndarray) -> np.ndarray:
        centred = values - values.mean(axis=0)
        size = np.sqrt((centred**2).sum(axis=0))
        return centred / np.where(size > 1e-9 * max(1.0, float(np.abs(values).max(initial=0))), size, np.nan)

    return unit(first).T @ unit(second)


SURE, GUESSED, MISSING, ABSENT, UNUSED = "sure", "guessed", "missing", "absent", "unused"
"""How a part of a map is known. Sure: evidence rules out every other reading. Missing: a question that has to be
answered before anything is imported. Absent: not in the logs, or left out of the map; an import goes on without it."""
ASKED = "?"  # stands for a unit that has to be stated; no import takes it


@dataclass
class Draft:
    """A map in the making, with the table as read so far: values in our order of joints, in units that were found.

    Its ``options`` become those of an import when a person passes them.
    """

    table: Table
    robot: Robot
    stated: Mapping[str, Any]
    """What the files say of themselves: ``period_s`` of the rows, ``unit`` of the positions."""
    instants: np.ndarray | None = None  # clock in its own unit, (rows,), and the units it may be in, likeliest first
    time_units: Sequence[str] = ()
    time: np.ndarray | None = None  # the same in s, by the unit that was chosen
    time_known: str = GUESSED
    values: dict[str, np.ndarray] = field(default_factory=dict)  # quantity → (rows, joints), SI, as far as known
    order: Sequence[str] = ()  # the robot's joints in the order of columns that name none
    order_words: str = ""
    their_joints: list[str] | None = None  # what the first family calls our joints, in our order: their ``*``
    named: set[str] = field(default_factory=set)  # quantities whose columns name the robot's joints
    unplaced: set[str] = field(default_factory=set)  # quantities with columns of which nobody can say whose each is
    position_unit: str = "rad"
    certainty: str = GUESSED  # how sure that unit is: what follows from it is no surer
    torque_alone: bool = False  # whether torques that were sent explain the measured ones: no joint PD beside
    options: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)  # how a part of the map is known, and a sentence

    def say(self, kind: str, sentence: str) -> None:
        """Note how sure a part of the map is, or what it leaves out, in a sentence."""
        self.notes.append((kind, sentence))

    def put(self, part: str, ours: str, value: Any) -> None:
        """Add an entry to a part of the options."""
        self.options.setdefault(part, {})[ours] = value

    def put_units(self, columns: Iterable[str], unit: str, ours: str) -> None:
        """Add the unit of some columns, unless it is ours."""
        for column in columns if unit != ours else ():
            self.put("units", column, unit)

    def drop(self, quantity: str) -> None:
        """Take a quantity out of the map, with what was said of its columns."""
        for part in ("columns", "units", "factors", "offsets"):
            entries = self.options.get(part, {})
            for key in [key for key in entries if key.partition("/")[0] == quantity]:
                del entries[key]
        self.notes = [one for one in self.notes if not one[1].startswith((f"{quantity} is", f"{quantity} comes"))]

    def notes_of(self, kind: str) -> list[str]:
        """The sentences of one kind."""
        return [sentence for one, sentence in self.notes if one == kind]

    def leave_out(self, quantity: str, sentence: str) -> None:
        """Take a quantity out of the map and out of what is known of the table, and say so."""
        self.drop(quantity)
        del self.values[quantity]
        self.say(ABSENT, sentence)

    def no_surer(self, *others: str) -> str:
        """Sure where the unit of the positions and all others are, else a guess."""
        return SURE if {self.certainty, *others} == {SURE} else GUESSED


def real_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Limits of each joint, rad (m of a slide), (joints, 2), and whether they are stops; without, ±3π stand there."""
    joints = [robot.model.joint(name).id for name in robot.joints]
    ranges = robot.model.jnt_range[joints]
    real = robot.model.jnt_limited[joints].astype(bool) & (np.ptp(ranges, axis=1) < TURN_RAD)
    limits = np.where(real[:, None], ranges, [-SPUN_RAD, SPUN_RAD])
    return limits, real


def inside(low: np.ndarray, high: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Whether each range of positions, from ``low`` to ``high``, lies within its limits."""
    return (low > limits[..., 0] - MARGIN_RAD) & (high < limits[..., 1] + MARGIN_RAD)
