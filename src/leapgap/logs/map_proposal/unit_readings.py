"""Every reading of the units of a log that numbers do not rule out: of its clock, its positions and its velocities.

A reading is ruled out where steps of the clock are those of no loop of a robot, where joints would be faster than any,
where they would leave the space between their stops by far, and where velocities would not be the rates of the
positions at all joints alike. What all readings that are left agree on is sure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.robot.model import Robot

NORMALISED, PERCENT = "−100…100 of each joint's range", "0…100 of each joint's range"
TICKS = "tick4096"
FASTEST, LEAST_RAD = 300.0, 0.1
"""No joint of a robot is faster most of the time, rad/s; in most logs some joint moves by more, rad."""
USUAL_SPEED = 2.0
SAME = 0.15
"""Two factors this near to each other, relatively, are the same."""
HUNDRED = 100.5
ROOM = 2.5
"""Limits in models are often too tight: a joint that moves so many times as far as they allow is of another unit."""
OFF_ZERO = 0.3
"""Limits that zero lies outside of by this much, rad, tell a scale: small numbers of other units lie elsewhere."""
DISTINCT = ("rad", "deg", "rad/s", "deg/s")
"""Units that no other one in use is near to; of the others none is ever sure."""
CLOSE = 0.05
"""Velocities whose unit is sure are the rates of positions to within this share."""
HABIT = {NORMALISED: "deg", PERCENT: "deg"}
"""Units whose rates come in that of another."""
LIKELY = {"rad": 0.0, "deg": 0.3, TICKS: 0.6, NORMALISED: 0.7, PERCENT: 0.8, "rev": 0.9, "mrad": 1.2} | {
    "decideg": 1.1,
    "centideg": 1.3,
}
"""What a reading of positions costs where nothing but habit speaks for another."""
OUTSIDE_COST, UNNAMED_COST, STILL_COST, NO_RATE_COST, TURNED_COST, LATER_COST = 3.0, 2.0, 1.0, 0.5, 0.5, 0.2
STILL_SHARE_COST = 2.5
"""Of positions that would be shares of the joints' ranges, none of which moves by more than a few of a hundred."""
MARGIN_RAD = 0.1
"""Positions may lie beyond the limits by this much: play, soft stops."""
TURN_RAD = 2 * math.pi - 0.2
"""Limits that are further apart are no stops: the joint may turn over, whatever the model file says."""
SPUN_RAD = 3 * math.pi
"""A joint without stops that is further from zero is rather one of another unit."""


def real_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Limits of each joint, rad (m of a slide), (joints, 2), and whether they are stops; without, ±3π stand there."""
    limits, real = np.full((len(robot.joints), 2), [-SPUN_RAD, SPUN_RAD]), np.zeros(len(robot.joints), dtype=bool)
    for i, name in enumerate(robot.joints):
        joint = robot.model.joint(name)
        if joint.limited[0] and np.ptp(joint.range) < TURN_RAD:
            limits[i], real[i] = joint.range, True
    return limits, real


def inside(low: np.ndarray, high: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Whether each range of positions, from ``low`` to ``high``, lies within its limits."""
    return (low > limits[..., 0] - MARGIN_RAD) & (high < limits[..., 1] + MARGIN_RAD)


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
    velocity_error: float
    """How far the rates of the positions are from such velocities, relatively."""
    is_inside: bool
    """Whether the positions lie within the limits of their joints."""
    tells: bool
    """Whether they do within limits that zero lies outside of."""
    cost: float
    """How unlikely the reading is where nothing rules it out."""


@dataclass(frozen=True)
class JointNumbers:
    """What the readings are judged by: of the joints, in our order and in the units of the file."""

    low: np.ndarray
    high: np.ndarray
    whole: bool
    """Whether all positions are whole numbers."""
    speed: np.ndarray | None
    """Rate of each position that a tenth of the rows exceeds, a unit of the clock; None without a clock."""
    rate: np.ndarray | None
    """Rate of each position over its velocity, NaN where the two do not go together; None without velocities."""
    exact: bool
    """Whether the two go together so well that the factor between them is believed."""


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
