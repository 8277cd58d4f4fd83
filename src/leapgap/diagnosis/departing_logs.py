"""Logs that depart from their fellows: found by robust statistics, named in the report, and left out.

Each statistic says nothing of what motion a log is of. It is high where a sensor failed for a row, a unit is another,
or a column is not what its name says. A log departs where a statistic is many times the median of the other logs, and
beyond a floor. So effects that differ from log to log, such as a clock or a payload, do not make a log depart.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.reading import FEWEST, SetAside
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, quantity_of

FEWEST_LOGS = 3
"""Logs from which on one can depart from the others."""
LONGEST_SPIKE = 3
"""Rows of the longest excursion that counts as a spike."""
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
"""To the floor of a command or torque, this share of the spread of its column is added: commands may leap."""
SAME = 1e-6
"""Difference between two logs, as a share of the range of a column, that no repetition of a motion has by chance."""
Values = Mapping[str, float]
"""Channel → statistic of one log."""


@dataclass(frozen=True)
class Statistic:
    """One number of each channel of a log, and when it departs from the others."""

    of: Callable[[Log], Values]
    ratio: float
    """To the median of the other logs, above which it departs."""
    floor: float
    """It departs above this value only."""
    says: str
    """What is found, with ``{channel}``, ``{value}`` and ``{usual}``."""


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
        raise InputError("diagnose.logs", found, "motions of the robot", "log some, with sensors that measure")


def without_copies(logs: Sequence[Log]) -> tuple[list[Log], list[SetAside]]:
    """The logs without those that are equal to an earlier one in every column, or as good as equal.

    A cause is judged on logs that it was not fitted on. A copy would be judged by itself.
    """
    originals: list[Log] = []
    copies = []
    for log in logs:
        known = next((other for other in originals if largest_difference(log, other) <= SAME), None)
        if known is None:
            originals.append(log)
            continue
        off = largest_difference(log, known)
        but = f" but for {off:.1g} of its range" if off else ""
        copies.append(SetAside(log.name, f"equal to {known.name} in every column{but}: a copy says nothing more"))
    return originals, copies


def largest_difference(log: Log, other: Log) -> float:
    """Largest difference of two logs in any column, as a share of its range, or of its value where it keeps one.

    Infinite where they differ in length or columns, or by more than ``SAME``.
    """
    if len(log) != len(other) or set(log.columns) != set(other.columns):
        return np.inf
    worst = 0.0
    for name in sorted(log.columns, key=lambda one: not one.startswith("joint_pos")):  # commands are often the same
        values, theirs = log.columns[name], other.columns[name]
        size = float(np.ptp(theirs)) or float(np.abs(theirs[0]))
        off = float(np.abs(values - theirs).max())
        worst = max(worst, off and (off / size if size else np.inf))
        if worst > SAME:
            return np.inf
    return worst


def reasons(logs: Sequence[Log]) -> dict[str, str]:
    """Name → reason of each log that departs, in the order of the logs."""
    found: dict[str, str] = {}
    for statistic in STATISTICS:
        values = [statistic.of(log) for log in logs]
        for log, reason in zip(logs, departures(values, statistic), strict=True):
            if reason:
                found.setdefault(log.name, reason)
    for log, reason in zip(logs, turned_round(logs), strict=True):
        if reason:
            found.setdefault(log.name, reason)
    return {log.name: found[log.name] for log in logs if log.name in found}


def departures(values: Sequence[Values], statistic: Statistic) -> list[str]:
    """What departs in each log, in words; empty where nothing does."""
    found = []
    for one, own in enumerate(values):
        others = [theirs for other, theirs in enumerate(values) if other != one]
        worst, says = statistic.ratio, ""
        for channel, value in own.items():
            usual = float(np.median([theirs.get(channel, 0.0) for theirs in others]))
            if value > statistic.floor and value > worst * usual:
                worst = value / max(usual, 1e-12)
                says = statistic.says.format(channel=channel, value=f"{value:.3g}", usual=f"{usual:.3g}")
        found.append(says)
    return found


def spikes(log: Log) -> Values:
    """Height of the highest spike of each column, in units of the floor of its quantity."""
    found = {}
    for name, values in log.columns.items():
        quantity = quantity_of(name)
        if quantity is not None and quantity.name in SPIKE_FLOORS:
            floor = SPIKE_FLOORS[quantity.name]
            if quantity.name.startswith(("cmd", "tau")):
                floor += SHARE_OF_SPREAD * float(np.subtract(*np.percentile(values, [99, 1])))
            found[name] = spike_height(values) / floor
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
    """Share of rows that repeat a joint's last position, of joints that were asked to move."""
    asked = [joint for joint in acting(log) if float(np.std(log[f"cmd_pos/{joint}"])) > 0.05]
    return {joint: float(np.mean(np.diff(log[f"joint_pos/{joint}"]) == 0)) for joint in asked}


def turned_round(logs: Sequence[Log]) -> list[str]:
    """Logs that begin turned by half a turn against all others and move the other way along their heading.

    So it looks where quaternions x y z w were taken for w x y z.
    """
    if not all(BASE_QUATERNION[0] in log and BASE_POSITION[0] in log for log in logs):
        return [""] * len(logs)
    heading = np.array([log.yaw[0] for log in logs])
    moved = np.array([[log[name][-1] - log[name][0] for name in BASE_POSITION[:2]] for log in logs])
    along = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
    found = []
    for one in range(len(logs)):
        others = np.arange(len(logs)) != one
        opposite = (np.cos(heading[others] - heading[one]) < -0.99).all()
        backwards = along[one] * np.median(along[others]) < 0 and abs(along[one]) > 0.1
        says = "its base is turned by half a turn against all other logs, and moves backwards (quaternions x y z w?)"
        found.append(says if opposite and backwards else "")
    return found


STATISTICS = (
    Statistic(magnitudes, 15.0, 6.3, "positions and set points of its joints are {value} rad, those of others {usual}"),
    Statistic(spikes, 10.0, 1.0, "{channel} leaves its course for a few rows, {value} times what counts as a spike"),
    Statistic(tracking_errors, 10.0, 0.3, "{channel} is {value} rad from its set point, in the other logs {usual}"),
    Statistic(
        torque_ratios, 5.0, 1.0, "{channel} is {value} times what belongs to it, in the other logs {usual} times"
    ),
    Statistic(torque_sizes, 100.0, 1.0, "{value} N·m were asked of {channel}, in the other logs {usual} N·m"),
    Statistic(
        torque_residuals,
        10.0,
        0.3,
        "measured and commanded torque of {channel} differ in a row by {value} times their size, in the others {usual}",
    ),
    Statistic(still_rows, 1.3, 0.98, "{channel} stands still while it is asked to move, and moves in the other logs"),
)
