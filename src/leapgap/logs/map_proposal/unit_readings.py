"""Every reading of the units of a log that numbers do not rule out: of its clock, its positions and its velocities.

A reading is ruled out where steps of the clock are those of no loop of a robot, where joints would be faster than any,
where they would leave the space between their stops by far, and where velocities would not be the rates of the
positions at all joints alike. What all readings that are left agree on is sure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.clock import PERIOD_TOLERANCE
from leapgap.logs.importers.column_map import UNITS
from leapgap.logs.map_proposal.evidence import GUESSED, MARGIN_RAD, MISSING, SPUN_RAD, SURE, Draft, inside, real_limits
from leapgap.logs.map_proposal.joint_columns import NANOSECONDS, SECONDS, time_columns, words
from leapgap.robot.model import Robot

NORMALISED, PERCENT = "−100…100 of each joint's range", "0…100 of each joint's range"
TICKS = "tick4096"
FASTEST, LEAST_RAD = 300.0, 0.1  # no joint is faster most of the time, rad/s; mostly some joint moves by more, rad
USUAL_SPEED = 2.0
SAME = 0.15  # two factors this near to each other, relatively, are the same
HUNDRED = 100.5
ROOM = 2.5  # limits in models are often too tight: a joint moving so many times as far is of another unit
OFF_ZERO = 0.3  # limits that exclude zero by this much, rad, tell a scale: small numbers of other units lie elsewhere
DISTINCT = ("rad", "deg", "rad/s", "deg/s")  # units that no other one in use is near to; others are never sure
CLOSE = 0.05  # velocities whose unit is sure are the rates of positions to within this share
HABIT = {NORMALISED: "deg", PERCENT: "deg"}  # units whose rates come in that of another
LIKELY = {"rad": 0.0, "deg": 0.3, TICKS: 0.6, NORMALISED: 0.7, PERCENT: 0.8, "rev": 0.9, "mrad": 1.2} | {
    "decideg": 1.1,
    "centideg": 1.3,
}
"""What a reading of positions costs where nothing but habit speaks for another."""
OUTSIDE_COST, UNNAMED_COST, STILL_COST, NO_RATE_COST, TURNED_COST, LATER_COST = 3.0, 2.0, 1.0, 0.5, 0.5, 0.2
STILL_SHARE_COST = 2.5  # of shares of the joints' ranges, none of which moves by more than a few of a hundred


@dataclass(frozen=True)
class Scale:
    """A unit of positions: its name, and the factor and the offset of each joint to rad."""

    name: str
    factor: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class UnitReading:
    """Units of a clock and of positions that go together, and of velocities where one does."""

    time: str
    position: Scale
    velocity: str | None
    velocity_error: float  # how far the rates of the positions are from such velocities, relatively
    is_inside: bool  # whether the positions lie within the limits of their joints
    tells: bool  # whether they do within limits that zero lies outside of
    cost: float  # how unlikely the reading is where nothing rules it out


@dataclass(frozen=True)
class JointNumbers:
    """What the readings are judged by: of the joints, in our order and in the units of the file."""

    low: np.ndarray
    high: np.ndarray
    whole: bool  # whether all positions are whole numbers
    speed: np.ndarray | None  # rate of each position that a tenth of the rows exceeds; None without a clock
    rate: np.ndarray | None  # rate of each position over its velocity, NaN where not alike; None without any
    exact: bool  # whether the two go together so well that the factor between them is believed


def scales(robot: Robot) -> list[Scale]:
    """The units that positions may be in."""
    limits, real = real_limits(robot)
    turns = robot.turning
    found = [Scale(name, np.where(turns, factor, 1.0), 0.0 * turns) for name, factor in UNITS["rad"].items()]
    ticks = next(one for one in found if one.name == TICKS)
    found.append(replace(ticks, offset=np.where(turns, -math.pi, 0.0)))  # ticks with zero in the middle of a turn
    ends = np.where(real[:, None], limits, [-math.pi, math.pi])
    width = np.ptp(ends, axis=1)
    return [*found, Scale(NORMALISED, width / 200, ends.mean(axis=1)), Scale(PERCENT, width / 100, ends[:, 0])]


def readings(
    numbers: JointNumbers, robot: Robot, times: Sequence[str], named: Sequence[str] = (), any_order: bool = False
) -> list[UnitReading]:
    """The readings that are left, the likeliest first. ``named`` are units that a name in the file speaks of.

    With ``any_order`` the columns may be of other joints than they are taken for.
    """
    found = [
        reading
        for rank, time in enumerate(times or [""])
        for scale in scales(robot)
        if (reading := judged(numbers, robot, time, rank, scale, named, any_order)) is not None
    ]
    telling = [one for one in found if one.tells]
    if telling:  # numbers near zero of any other unit would not lie within these limits
        small = max(np.abs(numbers.low).max(), np.abs(numbers.high).max()) <= SPUN_RAD
        shares = () if small else (NORMALISED, PERCENT)
        found = [one for one in found if one.tells or one.position.name in shares]
    return sorted(found, key=lambda one: one.cost)


def judged(
    numbers: JointNumbers, robot: Robot, time: str, rank: int, scale: Scale, named: Sequence[str], any_order: bool
) -> UnitReading | None:
    """One reading; None where the numbers rule it out."""
    limits, real = real_limits(robot)
    low, high = (end * scale.factor + scale.offset for end in (numbers.low, numbers.high))
    shares = scale.name in (NORMALISED, PERCENT)
    if not could_be(numbers, scale):
        return None
    if not shares and not has_room(low, high, limits, real, any_order):
        return None
    cost, velocity, error = LIKELY[scale.name] + LATER_COST * rank, None, math.inf
    still = STILL_SHARE_COST if shares else STILL_COST
    cost += still if np.ptp([low, high], axis=0).max() < LEAST_RAD else 0.0
    if numbers.speed is not None and time:
        speed = float((numbers.speed * scale.factor).max()) / UNITS["s"][time]
        if speed > FASTEST:
            return None
        cost += max(0.0, abs(math.log10(max(speed, 1e-9) / USUAL_SPEED)) - 1)
    if numbers.rate is not None and time and np.isfinite(numbers.rate).any():
        rate = (numbers.rate * scale.factor / UNITS["s"][time])[np.isfinite(numbers.rate)]
        own = float(np.nanmedian(numbers.rate)) / UNITS["s"][time]
        if shares and spread(rate) > 2 * math.log1p(SAME) > 2 * spread(numbers.rate) and abs(math.log(own)) > SAME:
            return None  # the velocities are of one unit at all joints, and not of that of the positions
        velocity = rate_unit(float(np.median(rate)), scale.name, numbers.exact)
        error = abs(float(np.median(rate)) / UNITS["rad/s"][velocity] - 1) if velocity and numbers.exact else math.inf
        cost += NO_RATE_COST if velocity is None else 0.0
    is_inside = bool(inside(low, high, limits).all())
    zero_outside = real & ((limits[:, 0] > OFF_ZERO) | (limits[:, 1] < -OFF_ZERO))
    if not is_inside:
        turned_round = (inside(low, high, limits) | inside(-high, -low, limits)).all()
        cost += TURNED_COST if turned_round else OUTSIDE_COST
    cost += (bool(named) and scale.name not in named) * UNNAMED_COST
    return UnitReading(
        time, scale, velocity, error, is_inside, is_inside and not shares and bool(zero_outside.any()), cost
    )


def rate_unit(rate: float, position: str, exact: bool) -> str | None:
    """The unit of velocities by the rates of positions in it; None for one that is neither near nor the usual one."""
    unit = nearest(rate, "rad/s")
    usual = {f"{position}/s", f"{HABIT.get(position, position)}/s"}
    if unit is None or unit in usual or (exact and abs(rate / UNITS["rad/s"][unit] - 1) < CLOSE):
        return unit
    return None


def spread(values: np.ndarray) -> float:
    """Largest relative distance of finite values from their median, as a logarithm."""
    finite = values[np.isfinite(values)]
    return float(np.abs(np.log(finite / np.median(finite))).max())


def could_be(numbers: JointNumbers, scale: Scale) -> bool:
    """Whether numbers can be of a unit at all: shares end at 100, ticks are whole."""
    if scale.name == TICKS:
        return numbers.whole
    least = {NORMALISED: -HUNDRED, PERCENT: -0.5}.get(scale.name)
    return least is None or bool((numbers.low >= least).all() and (numbers.high <= HUNDRED).all())


def has_room(low: np.ndarray, high: np.ndarray, limits: np.ndarray, real: np.ndarray, any_order: bool) -> bool:
    """Whether the joints have room for such motions between their stops, wherever zero is."""
    from scipy.optimize import linear_sum_assignment

    fits = np.ptp([low, high], axis=0)[:, None] < ROOM * np.ptp(limits, axis=1) + 2 * MARGIN_RAD
    fits &= np.abs(0.5 * (low + high))[:, None] < ROOM * np.abs(limits).max(axis=1) + math.pi
    fits |= ~real
    if any_order:
        return bool(fits[linear_sum_assignment(~fits)].all())
    return bool(np.diag(fits).all())


def nearest(factor: float, dimension: str, within: float = SAME) -> str | None:
    """The unit that a factor to ours stands for; None where no unit is within that share of it."""
    apart = {unit: abs(math.log(max(abs(factor), 1e-300) / size)) for unit, size in UNITS[dimension].items()}
    found = min(apart, key=apart.__getitem__)
    return found if apart[found] < math.log1p(within) else None


STEPS = (1e-4, 0.5)  # periods of loops of robots, s: what a unit of time must give
TIME_UNITS = ("s", "ms", "us", "ns")
LONG_GAP = 20  # a step of the clock that is so many times the median one is a gap
MOST_STATES = 10  # a column with more values than that is no flag


def find_time(columns: Sequence[str], draft: Draft) -> None:
    """The clock: named so, increasing, and with the steps of a loop in some unit; else a column of steps.

    Seconds and nanoseconds in two columns, as stamps of ROS have them, are one clock.
    """
    if pair := seconds_and_nanoseconds(columns):
        whole, rest = (draft.table.instants(column) for column in pair)
        instants = whole + 1e-9 * rest
        if units := units_of_time(instants, "s", draft.stated.get("period_s")):
            draft.put("columns", "time", {pair[0]: 1, pair[1]: 1e-9})
            draft.instants, draft.time_units = instants, units[:1]
            return
    for column in time_columns(columns):
        instants = draft.table.instants(column)
        units = units_of_time(instants, column, draft.stated.get("period_s"))
        if units:
            draft.put("columns", "time", column)
            draft.instants, draft.time_units = instants, units
            return
    for column in columns:
        steps = draft.table.numbers(column)
        if "dt" in words(column) and len(steps) and (steps > 0).all():
            find_steps(column, steps, draft)
            return
    for name, array in draft.table.arrays.items():
        if array.size == 1 and array.dtype.kind in "biuf" and "dt" in words(name) and array.item() > 0:
            find_steps(name, np.full(draft.table.rows, float(array.item())), draft)
            return
    draft.say(MISSING, "a column with time stamps: map columns.time, or state period_s if the rows are even")


def seconds_and_nanoseconds(columns: Sequence[str]) -> tuple[str, str] | None:
    """Two columns that hold whole seconds and the rest in nanoseconds, by their names; None without such."""
    by_words = {tuple(words(column)): column for column in columns}
    for said, column in by_words.items():
        rests = [by_words[*said[:-1], one] for one in NANOSECONDS if (*said[:-1], one) in by_words]
        if said and said[-1] in SECONDS and rests:
            return column, rests[0]
    return None


def units_of_time(instants: np.ndarray, column: str, period_s: float | None) -> list[str]:
    """The units in which the steps of a clock may be those of a robot's loop, the one in its name first.

    None where the column is no clock. A period that the file states leaves one.
    """
    steps = np.diff(instants)
    if len(steps) < 2 or not np.isfinite(steps).all() or np.mean(steps > 0) < 0.99:
        return []
    step = float(np.median(steps))
    found = [unit for unit in TIME_UNITS if STEPS[0] <= step * UNITS["s"][unit] <= STEPS[1]]
    if period_s is not None:
        mean = float(np.mean(steps))
        agree = [one for one in found if abs(mean * UNITS["s"][one] / period_s - 1) < PERIOD_TOLERANCE]
        found = agree or found
    return sorted(found, key=lambda unit: unit not in words(column))


def find_steps(column: str, steps: np.ndarray, draft: Draft) -> None:
    """A column with the length of each step: a period where it is one number, else what the time is the sum of."""
    unit = next((one for one in TIME_UNITS if STEPS[0] <= np.median(steps) * UNITS["s"][one] <= STEPS[1]), None)
    if unit is None:
        draft.say(MISSING, f"a time: {column} has steps of {np.median(steps):.3g}; state period_s")
        return
    draft.instants, draft.time_units = np.concatenate([[0.0], np.cumsum(steps[:-1])]), [unit]
    if np.ptp(steps) == 0:
        draft.options["period_s"] = float(f"{steps[0] * UNITS['s'][unit]:.12g}")
    else:
        draft.options["steps"] = column
    draft.say(GUESSED, f"the spacing of the samples is {column}")


def judge_time(columns: Sequence[str], reading: UnitReading | None, draft: Draft) -> None:
    """The unit of the clock, with those of the positions and velocities that go with it."""
    if draft.instants is None:
        return
    unit = reading.time if reading and reading.time else draft.time_units[0]
    column = draft.options.get("columns", {}).get("time")
    draft.time = draft.instants * UNITS["s"][unit]
    step, back = np.diff(draft.time), int((np.diff(draft.instants) <= 0).sum())
    if unit != "s" and "period_s" not in draft.options:
        draft.put("units", "time", unit)
    if column is not None:
        column = column if isinstance(column, str) else " and ".join(column)
        longest = f"median {1e3 * np.median(step):.4g}, longest {1e3 * step.max():.4g}"
        said = f"time is {column} in {unit}: steps of {1e3 * step.mean():.4g} ms on average ({longest})"
        rivals = [one for one in draft.time_units if one != unit]
        rate_fits = reading is not None and reading.velocity in ("rad/s", "deg/s")
        if bool((np.diff(draft.instants) == 1).all()):
            draft.time_known = GUESSED
            if not rate_fits:
                draft.drop("time")
                draft.say(
                    MISSING,
                    f"the time: {column} counts up by 1, {unit} or rows; state units.time: {unit} with columns.time: "
                    f"{column}, or period_s",
                )
                return
            draft.say(GUESSED, f"{said}; if it counts rows, state period_s instead")
        elif draft.time_known == SURE or not rivals:
            draft.time_known = SURE
            draft.say(SURE, said)
        else:
            draft.say(GUESSED, f"{said}; {', '.join(rivals)} would be a loop of a robot as well")
    find_gaps(columns, draft)
    if back:
        draft.options["repeated_times"] = "drop"
        draft.say(GUESSED, f"{back} time stamps repeat or run back; their rows are dropped")


def find_gaps(columns: Sequence[str], draft: Draft) -> None:
    """Long gaps in the time, and a flag that changes where they are, which then cuts the file."""
    assert draft.time is not None
    step = np.diff(draft.time)
    gaps = np.flatnonzero(step > LONG_GAP * np.median(step))
    if not len(gaps):
        return
    for column in columns:
        values = draft.table.numbers(column)
        if not np.isfinite(values).all() or len(np.unique(values)) > MOST_STATES:
            continue
        changes = np.flatnonzero(np.diff(values) != 0)
        if len(changes) and all(np.abs(changes - gap).min() <= 2 for gap in gaps):
            draft.options["cut_by"] = column
            draft.say(GUESSED, f"{len(gaps)} gaps of up to {step.max():.3g} s where {column} changes: it cuts the file")
            return
    draft.say(MISSING, f"what cuts the file at {len(gaps)} gaps of up to {step.max():.3g} s: cut_by, or pieces")
