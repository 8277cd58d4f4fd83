"""Logs that depart from their fellows: found by robust statistics, named in the report, and left out.

Each statistic says nothing of what motion a log is of. It is high where a sensor failed for a row, a unit is another,
or a column is not what its name says. A log departs where a statistic is many times the median of the other logs, and
beyond a floor. So effects that differ from log to log, such as a clock or a payload, do not make a log depart.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.reading import FEWEST, SetAside
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, quantity_of

FEWEST_LOGS = 3  # Logs from which on one can depart from the others
LONGEST_SPIKE = 3  # Rows of the longest excursion that counts as a spike
SPIKE_FLOORS = {
    "base_pos": 0.05,
    "base_quat": 0.03,
    "base_linvel": 0.5,
    "base_angvel": 2.0,
    "joint_pos": 0.05,
    "joint_vel": 5.0,
    "cmd_pos": 0.1,
    "cmd_vel": 1.0,
    "cmd_tau": 1.0,
    "tau": 1.0,
    "cmd_kp": 5.0,
    "cmd_kd": 0.2,
}
"""Quantity → height of a spike, in its unit, that is one."""
SHARE_OF_SPREAD = 1.0
"""To the floor of a command or torque, this share of the spread of its column is added: commands may leap. So may
torque, where the commands ask for it: to its floor, the largest leap of the commanded torque is added."""
ASKED, ASKED_S = 0.05, 0.5
"""A joint is asked to move where its set point moves by so much, rad or m, in so long, s; it has as long again."""

COPY_OF_NOISE, COPY_OF_SPREAD = 0.05, 1e-6
"""Columns of one run differ by less than these shares of their noise or of their spread (commands: of their size, or of
1); those of two runs by √2 of their noise."""
SAME_ROWS, FEWEST_ROWS = 0.9, 10
"""Share of the distinct rows of a log that are rows of another, from which on it is a piece of that one."""
FOLLOWS = 0.8
"""Correlation of positions and set points, at the lag that suits them best, from which on a robot follows its commands
closely enough to tell that lag."""
NEAREST = 0.2
"""A joint follows as in other logs where its distance from the set point is not smaller than this share of theirs, nor
theirs than this share of its own: motions differ."""
LONGEST_LAG_S = 0.5  # Lags of a robot behind its commands are looked for up to this, before and after
LEAST_LAG_S, LEAST_LAG_ROWS, LAG_SPREADS = 0.05, 3, 3.0
"""A lag departs by more than this, s and rows, and by so many times the range of the other logs' lags."""
LAG_EXPLAINS = 4.0  # At the other logs' lag, so many times as much of the motion is left unexplained as at its own

Values = Mapping[str, float]  # Channel → statistic of one log


@dataclass(frozen=True)
class Statistic:
    """One number of each channel of a log, and when it departs from the others."""

    of: Callable[[Log], Values]
    ratio: float  # To the median of the other logs, above which it departs
    floor: float  # It departs above this value only
    says: str  # What is found, with ``{channel}``, ``{value}`` and ``{usual}``


def without_departing(logs: Sequence[Log]) -> tuple[list[Log], list[SetAside]]:
    """The logs that agree with each other, and the others with their reasons.

    Copies are left out in any case. Of the others all are kept where fewer than ``FEWEST`` would be left, or as many
    depart as stay: then nobody can say which are the bad ones.
    """
    originals, copies = without_copies(logs)
    departing = reasons(originals) if len(originals) >= FEWEST_LOGS else {}
    kept = [log for log in originals if log.name not in departing]
    if len(kept) < max(FEWEST, len(departing) + 1):
        return originals, copies
    return kept, [*copies, *(SetAside(name, reason) for name, reason in departing.items())]


def check_motion(logs: Sequence[Log]) -> None:
    """``InputError`` for logs in which no column changes: there is no motion, and no noise to judge a gap by."""
    columns = [values for log in logs for name, values in log.columns.items() if name != "time"]
    if all((values == values[0]).all() for values in columns):
        found = "logs in which nothing moves: every column keeps its first value"
        raise InputError("logs", found, "motions of the robot", "log some, with sensors that measure")


def without_copies(logs: Sequence[Log]) -> tuple[list[Log], list[SetAside]]:
    """The logs without those that are equal to another, or nearly so, or a piece of it, of which the longest stays.

    A cause is judged on logs that it was not fitted on. A copy would be judged by itself.
    """
    rows = {log.name: row_codes(log) for log in logs}
    kept: list[Log] = []
    copies = {}
    for log in sorted(logs, key=len, reverse=True):
        for of in kept:
            how = alike(log, of)
            own, others = rows[log.name], rows[of.name]
            repeats = len(own) >= FEWEST_ROWS and np.isin(own, others, assume_unique=True).mean() > SAME_ROWS
            if how is None and repeats:
                how = f"it is a part of {of.name}, which"
            if how is not None:
                copies[log.name] = SetAside(log.name, f"{how} says nothing more")
                break
        else:
            kept.append(log)
    return [log for log in logs if log.name not in copies], [copies[log.name] for log in logs if log.name in copies]


def row_codes(log: Log) -> np.ndarray:
    """A number for each distinct row of all columns but the time, sorted; rows of equal bits have equal numbers."""
    names = sorted(name for name in log.columns if name != "time")
    odd = 2 * np.random.default_rng(0).integers(2**62, size=len(names), dtype=np.uint64) + 1
    codes = np.zeros(len(log), dtype=np.uint64)
    for name, factor in zip(names, odd, strict=True):
        codes += (np.ascontiguousarray(log[name]).view(np.uint64) ^ (codes >> np.uint64(29))) * factor
    return np.unique(codes)


def alike(one: Log, other: Log) -> str | None:
    """How nearly two logs are one, in words; None where they are two.

    Two runs differ by the noise of the sensors. What differs by far less in every measured column is one run.
    """
    if len(one) != len(other) or one.columns.keys() != other.columns.keys():
        return None
    measured = [name for name in one.columns if name != "time" and not name.startswith("cmd_")]
    commands = [name for name in one.columns if name not in measured]
    equal = True
    for name in [*measured, *commands]:
        a, b = one[name], other[name]
        if np.array_equal(a, b):
            continue
        equal = False
        noise = noise_of(np.diff(a)[:, None], one.info.sample_period_s)[0] if name in measured else 0.0
        spread = float(np.ptp(a)) if name in measured else max(1.0, float(np.abs(a).max()))
        if rms(a - b) > max(COPY_OF_NOISE * noise, COPY_OF_SPREAD * spread):
            return None
    but = "" if equal else f" but for less than {100 * COPY_OF_NOISE:.0f} % of its noise"
    return f"equal to {other.name} in every column{but}: a copy"


def reasons(logs: Sequence[Log]) -> dict[str, str]:
    """Name → reason of each log that departs, in the order of the logs."""
    found: dict[str, str] = {}
    compared = [*(compare(logs) for compare in (without_gains, late_commands, turned_round))]
    compared += [departures(logs, statistic) for statistic in STATISTICS]
    for name, reason in itertools.chain(*compared):
        found.setdefault(name, reason)
    return {log.name: found[log.name] for log in logs if log.name in found}


Reasons = Iterator[tuple[str, str]]  # Name of each log that departs, and why, in words


def departures(logs: Sequence[Log], statistic: Statistic) -> Reasons:
    """Logs in which a channel's statistic departs from the other logs'."""
    values = [statistic.of(log) for log in logs]
    for one, own in enumerate(values):
        others = [theirs for other, theirs in enumerate(values) if other != one]
        worst, says = statistic.ratio, ""
        for channel, value in own.items():
            usual = float(np.median([theirs.get(channel, 0.0) for theirs in others]))
            if value > statistic.floor and value > worst * usual:
                worst = value / max(usual, 1e-12)
                says = statistic.says.format(channel=channel, value=f"{value:.3g}", usual=f"{usual:.3g}")
        if says:
            yield logs[one].name, says


def spikes(log: Log) -> Values:
    """Height of the highest spike of each column, in units of the floor of its quantity.

    A joint's velocity that its position shows, too, is a motion and no spike, however few rows it lasts.
    """
    found, asked = {}, commanded_torques(log)
    for name, values in log.columns.items():
        quantity = quantity_of(name)
        if quantity is not None and quantity.name in SPIKE_FLOORS:
            floor = SPIKE_FLOORS[quantity.name]
            if quantity.name.startswith(("cmd", "tau")):
                floor += SHARE_OF_SPREAD * float(np.subtract(*np.percentile(values, [99, 1])))
            joint = name.partition("/")[2]
            if quantity.name == "tau" and joint in asked:
                floor += float(np.abs(np.diff(asked[joint])).max())
            height = spike_height(values)
            if quantity.name == "joint_vel" and height > floor and f"joint_pos/{joint}" in log:
                height = min(height, spike_height(values - np.gradient(log[f"joint_pos/{joint}"], log.time)))
            found[name] = height / floor
    return found


def spike_height(values: np.ndarray) -> float:
    """Height of the highest excursion of one to three rows above or below both of its sides."""
    highest = 0.0
    for rows in range(1, min(LONGEST_SPIKE, len(values) - 2) + 1):
        before, after = values[: -rows - 1], values[rows + 1 :]
        inside = np.lib.stride_tricks.sliding_window_view(values[1:-1], rows)
        above = inside.min(axis=1) - np.maximum(before, after)
        below = np.minimum(before, after) - inside.max(axis=1)
        highest = max(highest, float(above.max()), float(below.max()))
    return highest


def acting(log: Log) -> list[str]:
    """Joints whose PD acts in most rows and whose position was measured."""
    return [
        joint
        for joint in log.joints
        if f"joint_pos/{joint}" in log and float(np.mean(log[f"cmd_kp/{joint}"] > 0)) > 0.5
    ]


def tracking_errors(log: Log) -> Values:
    """Median distance of each joint from its set point, rad or m."""
    return {j: float(np.median(np.abs(log[f"cmd_pos/{j}"] - log[f"joint_pos/{j}"]))) for j in acting(log)}


def magnitudes(log: Log) -> Values:
    """Size of positions and of set points, the smaller of the two, rad or m; the median of the joints."""
    sizes = [
        min(float(np.percentile(np.abs(log[f"{one}/{joint}"]), 95)) for one in ("joint_pos", "cmd_pos"))
        for joint in acting(log)
    ]
    return {"joints": float(np.median(sizes))} if sizes else {}


def commanded_torques(log: Log) -> dict[str, np.ndarray]:
    """Torque that was asked of each joint whose position was measured, N·m, (rows,); velocities may be missing."""
    found = {}
    for joint in log.joints:
        if f"joint_pos/{joint}" in log:
            torque = log[f"cmd_tau/{joint}"]
            torque = torque + log[f"cmd_kp/{joint}"] * (log[f"cmd_pos/{joint}"] - log[f"joint_pos/{joint}"])
            if f"joint_vel/{joint}" in log:
                torque = torque + log[f"cmd_kd/{joint}"] * (log[f"cmd_vel/{joint}"] - log[f"joint_vel/{joint}"])
            found[joint] = torque
    return found


def rms(values: np.ndarray) -> float:
    """Root mean square of values of any shape."""
    return float(np.sqrt(np.mean(values**2)))


def torque_sizes(log: Log) -> Values:
    """Root mean square of the torque that was asked of each joint, N·m."""
    return {joint: rms(torque) for joint, torque in commanded_torques(log).items()}


def torque_ratios(log: Log) -> Values:
    """Measured torque over commanded torque of each joint, root mean squares, and the inverse."""
    found: dict[str, float] = {}
    for joint, torque in commanded_torques(log).items():
        if f"tau/{joint}" in log and rms(torque) > 0 and rms(log[f"tau/{joint}"]) > 0:
            ratio = rms(log[f"tau/{joint}"]) / rms(torque)
            found |= {f"tau/{joint}": ratio, f"command of {joint}": 1 / ratio}
    return found


def torque_residuals(log: Log) -> Values:
    """Largest difference of measured and commanded torque of each joint, in root mean squares of the measured one."""
    return {
        joint: float(np.abs(log[f"tau/{joint}"] - torque).max()) / rms(log[f"tau/{joint}"])
        for joint, torque in commanded_torques(log).items()
        if f"tau/{joint}" in log and rms(log[f"tau/{joint}"]) > 0
    }


def still_rows(log: Log) -> Values:
    """Share of the times at which a joint was asked to move and its position stayed the same in every row."""
    rows, found = min(log.info.rows(ASKED_S), len(log) // 4), {}
    for joint in acting(log):
        wanted, position = log[f"cmd_pos/{joint}"], log[f"joint_pos/{joint}"]
        changes = np.concatenate([[0], np.cumsum(position[1:] != position[:-1])])
        asked = np.abs(wanted[rows : len(log) - rows] - wanted[: len(log) - 2 * rows]) > ASKED
        if asked.any():
            found[joint] = float(np.mean((changes[2 * rows :] == changes[: len(log) - 2 * rows])[asked]))
    return found


def without_gains(logs: Sequence[Log]) -> Reasons:
    """Logs whose gains are zero while their joints follow the set points as closely as in the others, where gains act.

    A robot without gains that is carried or falls does not follow; one whose set points are its measured positions is
    nearer to them than any PD brings it.
    """
    joints = [set(acting(log)) for log in logs]
    errors = [tracking_errors(log) for log in logs]
    for one, log in enumerate(logs):
        others = [other for other in range(len(logs)) if other != one]
        usual = [joint for joint in log.joints if sum(joint in joints[other] for other in others) > len(others) / 2]
        idle = [joint for joint in usual if f"joint_pos/{joint}" in log and not log[f"cmd_kp/{joint}"].any()]
        following = []
        for joint in idle:
            error = float(np.median(np.abs(log[f"cmd_pos/{joint}"] - log[f"joint_pos/{joint}"])))
            of_others = [errors[other][joint] for other in others if joint in errors[other]]
            near = NEAREST * min(of_others) < error < max(of_others) / NEAREST
            if near and (lag := lag_of(log, [joint])) and lag.correlation > FOLLOWS:
                following.append(joint)
        named = ", ".join(following)
        if following:
            yield log.name, f"its gains of {named} are 0, and the joints follow their set points as in the other logs"


@dataclass(frozen=True)
class Lag:
    """How far the joints of a log move behind their set points."""

    seconds: float
    correlation: float  # Of positions and set points at that lag, over all joints
    at: Callable[[float], float]  # The same at another lag, s


def lag_of(log: Log, joints: Sequence[str]) -> Lag | None:
    """The lag at which positions and set points of some joints correlate best; None where none of them moves."""
    wanted, position = (log.stack([f"{one}/{joint}" for joint in joints]) for one in ("cmd_pos", "joint_pos"))
    moving = (np.ptp(wanted, axis=0) > 0) & (np.ptp(position, axis=0) > 0)
    rows, period = len(log), log.info.sample_period_s
    reach = min(int(LONGEST_LAG_S / period), rows // 4)
    if not moving.any() or reach < 1:
        return None
    wanted, position = wanted[:, moving], position[:, moving]

    def correlation(lag: int) -> float:
        sent, seen = wanted[max(0, -lag) : rows - max(0, lag)], position[max(0, lag) : rows - max(0, -lag)]
        sent, seen = sent - sent.mean(axis=0), seen - seen.mean(axis=0)
        sizes = np.sqrt((sent**2).sum(axis=0) * (seen**2).sum(axis=0))
        return float(np.mean((sent * seen).sum(axis=0) / np.maximum(sizes, np.finfo(float).tiny)))

    lags = np.arange(-reach, reach + 1)
    values = np.array([correlation(int(lag)) for lag in lags])
    best = int(np.argmax(values))
    return Lag(float(lags[best] * period), float(values[best]), lambda s: float(np.interp(s / period, lags, values)))


def late_commands(logs: Sequence[Log]) -> Reasons:
    """Logs whose joints follow their set points with another lag than in all others: commands of another time."""
    lags = [lag_of(log, acting(log)) if acting(log) else None for log in logs]
    for one, own in enumerate(lags):
        others = [lag for other, lag in enumerate(lags) if other != one and lag is not None]
        if own is None or len(others) < FEWEST_LOGS - 1 or min(lag.correlation for lag in (own, *others)) < FOLLOWS:
            continue
        usual = float(np.median([lag.seconds for lag in others]))
        spread = max(lag.seconds for lag in others) - min(lag.seconds for lag in others)
        least = max(LEAST_LAG_S, LEAST_LAG_ROWS * logs[one].info.sample_period_s, LAG_SPREADS * spread)
        later = own.seconds - usual
        if abs(later) > least and 1 - own.at(usual) > LAG_EXPLAINS * (1 - own.correlation):
            early = f"commands are {1000 * abs(later):.0f} ms too {'early' if later > 0 else 'late'}"
            when = f"{1000 * own.seconds:.0f} ms later, in the other logs {1000 * usual:.0f} ms"
            yield logs[one].name, f"its joints follow the set points {when}: {early}"


def turned_round(logs: Sequence[Log]) -> Reasons:
    """Logs that begin turned by half a turn against all others and move the other way along their heading.

    So it looks where quaternions x y z w were taken for w x y z.
    """
    if not all(BASE_QUATERNION[0] in log and BASE_POSITION[0] in log for log in logs):
        return
    heading = np.array([log.yaw[0] for log in logs])
    moved = np.array([[log[name][-1] - log[name][0] for name in BASE_POSITION[:2]] for log in logs])
    along = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
    for one, log in enumerate(logs):
        others = np.arange(len(logs)) != one
        opposite = (np.cos(heading[others] - heading[one]) < -0.99).all()
        backwards = along[one] * np.median(along[others]) < 0 and abs(along[one]) > 0.1
        says = "its base is turned by half a turn against all other logs, and moves backwards (quaternions x y z w?)"
        if opposite and backwards:
            yield log.name, says


STATISTICS = (
    Statistic(magnitudes, 15.0, 6.3, "positions and set points of its joints are {value} rad, those of others {usual}"),
    Statistic(spikes, 10.0, 1.0, "{channel} has a spike of a few samples, {value} times what counts as one"),
    Statistic(tracking_errors, 10.0, 0.3, "{channel} is {value} rad from its set point, in the other logs {usual}"),
    Statistic(
        torque_ratios, 5.0, 1.0, "{channel} is {value} times what belongs to it, in the other logs {usual} times"
    ),
    Statistic(torque_sizes, 100.0, 1.0, "{value} N·m were asked of {channel}, in the other logs {usual} N·m"),
    Statistic(
        torque_residuals,
        10.0,
        0.3,
        "measured and commanded torque of {channel} differ by {value} times their size, in the other logs by {usual}",
    ),
    Statistic(still_rows, 1.3, 0.5, "{channel} stands still while it is asked to move, and moves in the other logs"),
)
