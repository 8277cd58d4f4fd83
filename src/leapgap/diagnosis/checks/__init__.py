"""Consistency before physics: what a log must satisfy by itself, whatever the robot.

A fault of measurement that passes unnoticed is absorbed by every later fit; these checks need no fitted model. They
take logs cut to the rows that are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import centre_of_mass, feet_positions
from leapgap.robot.model import Robot

GRAVITY = 9.81
SPAN_S = 0.02
"""Increments of position are compared with summed velocities over this time."""


@dataclass(frozen=True)
class Check:
    """The outcome of one consistency check over all logs."""

    name: str
    passed: bool
    statistic: float
    threshold: float
    says: str
    per_log: dict[str, float]
    """The statistic's estimate on each log, by the log's name."""


def clock_scale(position: np.ndarray, velocity: np.ndarray, period_s: float) -> float:
    """True over claimed period, from positions that must be the integral of velocities; both (rows, channels).

    Sensors measure velocity in true time, while positions advance by v · (true period) a row: the regression of
    position increments on claimed-time integrals of velocity has that ratio as slope.
    """
    span = max(1, round(SPAN_S / period_s))
    moved = position[span:] - position[:-span]
    middle = (velocity[1:] + velocity[:-1]) / 2
    summed = np.concatenate([np.zeros((1, velocity.shape[1])), np.cumsum(middle, axis=0) * period_s])
    integral = summed[span:] - summed[:-span]
    return float((moved * integral).sum() / (integral**2).sum())


LOCAL_S = 0.02
"""Half width, standard deviation, of the window of a local clock."""
LOCAL_PRIOR = 0.05
"""Weight of the log's mean clock in a local one, as a share of what a window says on average."""


def local_clock(position: np.ndarray, velocity: np.ndarray, period_s: float, every: int) -> np.ndarray:
    """The same ratio as it changes within a log, one value every so many rows, (values,).

    The regression of ``clock_scale`` in a window that slides along; where little moves, the whole log's ratio.
    """
    moved = np.diff(position, axis=0)
    integral = (velocity[1:] + velocity[:-1]) / 2 * period_s
    span = max(1, round(SPAN_S / period_s))
    box = np.ones(span)
    moved, integral = (np.apply_along_axis(np.convolve, 0, x, box, "same") for x in (moved, integral))
    product, square = (moved * integral).sum(axis=1), (integral**2).sum(axis=1)
    rows = np.arange(len(moved)) + 0.5
    at = np.linspace(0, len(position) - 1, max(2, len(position) // every))
    window = np.exp(-0.5 * ((at[:, None] - rows) * period_s / LOCAL_S) ** 2)
    mean, prior = product.sum() / square.sum(), LOCAL_PRIOR * (window @ square).mean()
    return np.asarray((window @ product + prior * mean) / (window @ square + prior))


def joint_clock(jumps: Sequence[Log], robot: Robot, threshold: float) -> Check | None:
    """Do the joints' positions follow from their velocities at the claimed sample period?"""
    if any(f"{q}/{robot.joints[0]}" not in jump for jump in jumps for q in ("joint_pos", "joint_vel")):
        return None
    scales = {
        jump.name: clock_scale(
            jump.per_joint("joint_pos", robot.joints),
            jump.per_joint("joint_vel", robot.joints),
            jump.info.sample_period_s,
        )
        for jump in jumps
    }
    return clock_check("joint_clock", "the joints", scales, threshold)


def base_clock(jumps: Sequence[Log], robot: Robot, threshold: float) -> Check | None:
    """Do the base's positions follow from its velocities at the claimed sample period?"""
    pairs = [("base_pos_x", "base_linvel_x"), ("base_pos_z", "base_linvel_z")]
    if not robot.has_free_base or any(name not in jump for jump in jumps for pair in pairs for name in pair):
        return None
    scales = {
        jump.name: clock_scale(
            jump.stack([p for p, _ in pairs]), jump.stack([v for _, v in pairs]), jump.info.sample_period_s
        )
        for jump in jumps
    }
    return clock_check("base_clock", "the base", scales, threshold)


def clock_check(name: str, what: str, scales: dict[str, float], threshold: float) -> Check:
    """Judge clocks by the median over logs."""
    statistic = float(np.median(list(scales.values()))) - 1
    passed = abs(statistic) <= threshold
    low, high = min(scales.values()), max(scales.values())
    says = (
        f"positions of {what} agree with their velocities at the claimed sample period (median {1 + statistic:.3f})"
        if passed
        else f"{what} move {100 * statistic:+.0f} % against their own velocities at the claimed sample period "
        f"(logs {low:.2f} to {high:.2f}): the loop runs {'slower' if statistic > 0 else 'faster'} than the log claims"
    )
    return Check(name, passed, abs(statistic), threshold, says, scales)


LOCAL_EVERY_S = 0.02
"""A local clock has one value for each stretch of this length."""
SHORTEST_FALL_S = 0.05
"""A shorter stretch of flight does not say how the robot falls."""
PLANTED_EVERY_S = 0.005
"""Planted feet are looked at so often."""


def local_clocks(jumps: Sequence[Log], robot: Robot) -> dict[str, np.ndarray] | None:
    """The joints' clock as it changes within each log."""
    if any(f"{q}/{robot.joints[0]}" not in jump for jump in jumps for q in ("joint_pos", "joint_vel")):
        return None
    return {
        jump.name: local_clock(
            jump.per_joint("joint_pos", robot.joints),
            jump.per_joint("joint_vel", robot.joints),
            jump.info.sample_period_s,
            jump.info.rows(LOCAL_EVERY_S),
        )
        for jump in jumps
    }


def even_clock(clocks: dict[str, np.ndarray] | None, threshold: float) -> Check | None:
    """Does the loop take equally long throughout a log, by the joints' own clock?"""
    if clocks is None:
        return None
    spread = {name: float(clock.std()) for name, clock in clocks.items()}
    statistic = float(np.median(list(spread.values())))
    passed = statistic <= threshold
    low, high = (float(f([f(clock) for clock in clocks.values()])) for f in (min, max))
    says = f"the true period of a row changes by {100 * statistic:.1f} % within a log (standard deviation)" + (
        "" if passed else f", from {low:.2f} to {high:.2f} times the claimed one"
    )
    return Check("even_clock", passed, statistic, threshold, says, spread)


def free_fall(jumps: Sequence[Log], robot: Robot, threshold: float) -> Check | None:
    """Does the centre of mass fall with g in flight, judged from the base's position and the joints?"""
    if not robot.has_free_base or any("base_pos_z" not in jump for jump in jumps):
        return None
    falls = {}
    for jump in jumps:
        schedule = jump.info.schedule
        begin = int(np.searchsorted(jump.time, schedule.take_off_s + 0.05))
        end = int(np.searchsorted(jump.time, schedule.landing_s - 0.05))
        if end - begin < jump.info.rows(SHORTEST_FALL_S):
            continue
        height = centre_of_mass(robot, motion_of(jump, robot, slice(begin, end)).qpos)[:, 2]
        time = jump.time[begin:end] - jump.time[begin]
        falls[jump.name] = float(-2 * np.polyfit(time, height, 2)[0] / GRAVITY)
    if not falls:
        return None
    statistic = float(np.median(list(falls.values()))) - 1
    passed = abs(statistic) <= threshold
    says = f"in flight the centre of mass falls with {1 + statistic:.2f} g" + (
        ""
        if passed
        else f" by the log's clock, which would be right if a row took {np.sqrt(1 + statistic):.2f} "
        "times the claimed period"
    )
    return Check("free_fall", passed, abs(statistic), threshold, says, falls)


def planted_feet(jumps: Sequence[Log], robot: Robot, threshold_m: float) -> Check | None:
    """Do feet that are planned to stand keep their place (forward kinematics of base pose and encoders)?"""
    if not robot.has_free_base or not robot.feet or any("base_pos_x" not in jump for jump in jumps):
        return None
    drift = {}
    for jump in jumps:
        end = int(np.searchsorted(jump.time, 0.8 * jump.info.schedule.double_contact_s))
        rows = slice(0, end, jump.info.rows(PLANTED_EVERY_S))
        feet = feet_positions(robot, motion_of(jump, robot, rows).qpos)
        drift[jump.name] = float(np.linalg.norm(feet - feet[0], axis=2).max())
    statistic = float(np.median(list(drift.values())))
    says = f"planted feet wander by {1000 * statistic:.0f} mm (median over logs) while all four stand"
    return Check("planted_feet", statistic <= threshold_m, statistic, threshold_m, says, drift)
