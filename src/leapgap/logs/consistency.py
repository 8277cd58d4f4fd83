"""Whether columns make a log that can be used, and whether they agree with physics: units, order, lost rows.

The tests of physics are wide: a clock that is wrong by a third, late measurements, noise and samples that repeat all
pass. What fails is a log whose numbers are not what their names say."""

from collections.abc import Mapping, Sequence

import numpy as np

from leapgap.errors import CONTROL, InputError
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, COMMANDS
from leapgap.robot.rotations import turn_between

Columns = Mapping[str, np.ndarray]  # columns of a log by name


def check_complete(columns: Columns, joints: Sequence[str], where: str) -> None:
    """Raise ``InputError`` for columns that make no log; ``joints`` are those with a commanded torque."""
    check_names(columns, where)
    check_rows(columns, where)
    check_commands(columns, joints, where)
    check_base(columns, where)


def check_names(columns: Columns, where: str) -> None:
    """No control characters in the name of the log or of a column: names are printed, and written into pages."""
    for name in ("", *columns) if CONTROL.search(where + "".join(columns)) else ():
        if CONTROL.search(name or where):
            found, do = f"the name {name or where}", "rename it"
            raise InputError(f"{where}, columns" if name else where, found, "printable characters, on one line", do)


def check_rows(columns: Columns, where: str) -> None:
    """Two or more rows in every column, with finite numbers, and a time that never stands still or runs back."""
    if "time" not in columns:
        raise InputError(where, "no column time", "a strictly increasing time, s", "add the column")
    rows = len(columns["time"])
    if rows < 2:
        raise InputError(where, f"{rows} rows", "two or more", "log the whole motion")
    for name, values in columns.items():
        if values.shape != (rows,):
            raise InputError(f"{where}, column {name}", f"shape {values.shape}", f"({rows},)", "export it again")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            found = f"{len(bad)} values that are no number, first in row {bad[0]}"
            do = "repair the log, or leave the column out if it was not measured"
            raise InputError(f"{where}, column {name}", found, "finite numbers", do)
    back = np.flatnonzero(np.diff(columns["time"]) <= 0)
    if len(back):
        found = f"a step of {np.diff(columns['time'])[back[0]]:g} s after row {back[0]}"
        if all((values[back] == values[back + 1]).all() for values in columns.values()):
            found += f" ({len(back)} rows are there twice, equal in every column)"
        do = "sort the rows, or repair the clock"
        raise InputError(f"{where}, column time", found, "strictly increasing times", do)


def check_commands(columns: Columns, joints: Sequence[str], where: str) -> None:
    """Commands and gains of every joint; the log of a free body, whose pose it has, needs none."""
    free = set(BASE_POSITION) | set(BASE_QUATERNION) <= set(columns) and not any("/" in name for name in columns)
    if not joints and not free:
        raise InputError(where, "no column cmd_tau/<joint>", "commands of every joint", "log the commands")
    for quantity in COMMANDS:
        missing = [joint for joint in joints if f"{quantity}/{joint}" not in columns]
        if missing:
            do = "log them; the gap cannot be judged without the commands"
            raise InputError(where, f"no {quantity} of {', '.join(missing)}", "commands and gains of every joint", do)


def check_base(columns: Columns, where: str) -> None:
    """All of the base's position and attitude or none, and attitudes of length one."""
    for group in (BASE_POSITION, BASE_QUATERNION):
        present = [name for name in group if name in columns]
        if present and len(present) != len(group):
            raise InputError(where, f"only {', '.join(present)}", f"all of {', '.join(group)}, or none", "log all")
    if BASE_QUATERNION[0] in columns:
        length = np.linalg.norm(np.stack([columns[name] for name in BASE_QUATERNION], axis=-1), axis=1)
        worst = int(np.argmax(np.abs(length - 1)))
        if abs(length[worst] - 1) > 1e-3:
            found = f"length {length[worst]:g}"
            do = "normalise them, and check their order"
            raise InputError(f"{where}, base_quat, row {worst}", found, "unit quaternions w x y z", do)


WINDOW_S = 0.05  # displacements over this time are held against integrals of velocities; shorter ones are mostly noise
MOVES = 0.02  # root mean square of displacements, rad or m, from which on a column counts as moving
SAME_MOTION = 0.9  # correlation of two descriptions of one motion from which on their ratio is a matter of units
OTHER_MOTION = 0.3  # correlation below which they describe different motions
LARGEST_RATIO = 1.8  # ratio of displacements to integrals of velocities; published jumps with their clock reach 1.38
LARGEST_PD_ERROR = 3.0  # median departure of a joint from the set point of its PD, rad or m, that is still a departure
LARGEST_UNIT_RATIO = 5.0  # ratio of the motion of a set point to its joint's; confused units differ by 57 or more
ROUGH, WIDE = 1.0, 0.1  # mean squared step over the variance, 2 for rows in random order; spread, rad, where it counts
JUMP, JUMP_RATIO, JUMPING_SHARE = 0.05, 10.0, 0.5
"""Lost rows: a step beyond what the velocities say, rad, its ratio to the 99th percentile, share of the joints."""
LONGEST_STALL_S = 0.03
"""Longest time, s, for which the velocities on both sides say how joints go on while nothing is logged."""
LONGEST_SPIKE = 3  # rows within which an excursion that returns is a spike, and no leap
LONGEST_STEP = 3.0  # median steps of the time from which on a step is a gap
TYPICAL = ((180 / np.pi, "degrees for radians"), (1000.0, "mm for m, or ms for s"), (100.0, "cm for m"))


def check_physics(columns: Columns, joints: Sequence[str], where: object) -> None:
    """``InputError`` where the columns of a log contradict each other beyond what any robot or sensor explains."""
    time = columns["time"]
    check_order(columns, joints, where)
    # Columns of positions with those of their velocities, as far as both are there
    every = [
        ([f"joint_pos/{joint}" for joint in joints], [f"joint_vel/{joint}" for joint in joints]),
        (list(BASE_POSITION), list(BASE_VELOCITY)),
    ]
    both = [[(p, v) for p, v in zip(*one, strict=True) if p in columns and v in columns] for one in every]
    for positions, velocities in [([p for p, _ in one], [v for _, v in one]) for one in both if one]:
        check_velocities(columns, positions, velocities, time, where)
    check_attitude(columns, time, where)
    check_set_points(columns, joints, where)


def table(columns: Columns, names: Sequence[str]) -> np.ndarray:
    """Columns side by side, (rows, columns), each contiguous in memory."""
    return np.stack([columns[name] for name in names]).T


def integral(velocities: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Integral of velocities (rows, columns) from the first row, by trapezoids."""
    whole = np.zeros_like(velocities)
    np.cumsum(0.5 * (velocities[1:] + velocities[:-1]) * np.diff(time)[:, None], axis=0, out=whole[1:])
    return whole


def rows_of_window(time: np.ndarray) -> int:
    """Number of rows that last ``WINDOW_S``, at least two and at most a quarter of all."""
    rows = WINDOW_S * (len(time) - 1) / (time[-1] - time[0]) if time[-1] > time[0] else len(time)
    return max(2, min(round(rows), len(time) // 4))


def compare(moved: np.ndarray, integrated: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Size of displacements (rows, columns), their ratio to the integrals of velocities, and the correlation."""
    here, there = (np.einsum("ij,ij->j", one, one) for one in (moved, integrated))
    both = np.einsum("ij,ij->j", moved, integrated)
    tiny = np.finfo(float).tiny
    with np.errstate(over="ignore"):
        ratio = np.sqrt(here / np.maximum(there, tiny))
    return np.sqrt(here / len(moved)), ratio, both / np.maximum(np.sqrt(here) * np.sqrt(there), tiny)


def check_velocities(
    columns: Columns, positions: Sequence[str], velocities: Sequence[str], time: np.ndarray, where: object
) -> None:
    """Positions must be the integrals of their velocities, as to units, order and rows."""
    rows = rows_of_window(time)
    if len(time) < 2 * rows:
        return
    position, integrated = table(columns, positions), integral(table(columns, velocities), time)
    size, ratio, alike = compare(position[rows:] - position[:-rows], integrated[rows:] - integrated[:-rows])
    moving = size > MOVES
    for column, (name, other) in enumerate(zip(positions, velocities, strict=True)):
        if np.ptp(columns[other]) == 0:  # a column of one value is no motion
            continue
        speed = float(np.sqrt(np.mean((integrated[rows:, column] - integrated[:-rows, column]) ** 2)))
        if name.startswith("joint_pos/") and np.ptp(position[:, column]) == 0 and speed > MOVES:
            found = f"one value in all samples, while {other} moves by {speed:.2g} in {WINDOW_S:g} s"
            do = "map the measured positions, or repair the sensor"
            raise InputError(f"{where}, column {name}", found, "positions and velocities of one motion", do)
    for column in np.flatnonzero(moving).tolist():
        name, other = positions[column], velocities[column]
        if alike[column] > SAME_MOTION and not 1 / LARGEST_RATIO < ratio[column] < LARGEST_RATIO:
            says = f"displacements of {ratio[column]:.3g} times the integral of {other}{typical(ratio[column])}"
            expected = "the integral of the velocity: one unit, and a clock in s"
            advice = "correct the unit of one of them, or of the time"
            raise InputError(f"{where}, column {name}", says, expected, advice)
        if alike[column] < OTHER_MOTION:
            says = f"a motion that is not the one of {other} (correlation {alike[column]:.2f})"
            expected = "positions and velocities of one motion, rows in the order of time"
            advice = "check the names and the order of the columns, signs, and the order of the rows"
            raise InputError(f"{where}, column {name}", says, expected, advice)
    check_clock_unit(position, integrated, time, positions, where)
    check_steps(position, integrated, time, moving, positions, where)


def check_clock_unit(
    position: np.ndarray, integrated: np.ndarray, time: np.ndarray, names: Sequence[str], where: object
) -> None:
    """All columns must not move many times more or less than their velocities, over whatever time they visibly move.

    Where the time is in ms, ``WINDOW_S`` of it is a row or less, in which nothing moves; so displacements over more and
    more rows are looked at.
    """
    rows = rows_of_window(time)
    while rows <= len(time) // 4:
        size, ratio, alike = compare(position[rows:] - position[:-rows], integrated[rows:] - integrated[:-rows])
        clear = (size > MOVES) & (alike > SAME_MOTION)
        off = float(np.median(ratio[clear])) if clear.any() else 1.0
        if not 1 / LARGEST_UNIT_RATIO < off < LARGEST_UNIT_RATIO:
            steps = float(time[-1] - time[0]) / (len(time) - 1)
            raise InputError(
                f"{where}, time",
                f"a log of {float(time[-1] - time[0]):.4g} s with steps of {1000 * steps:.4g} ms, in which "
                f"{names[int(np.argmax(clear))]} moves {off:.3g} times as far as its velocity says{typical(off)}",
                "time in s, and velocities per s of that time",
                "correct the unit of the time",
            )
        rows *= 2


def check_steps(
    position: np.ndarray,
    integrated: np.ndarray,
    time: np.ndarray,
    moving: np.ndarray,
    names: Sequence[str],
    where: object,
) -> None:
    """Half of the moving columns must not leap in one row beyond what their velocities say.

    A loop that hangs and claims one period is no such leap: all columns go on by their velocities for the same time.
    """
    if moving.sum() < 2:
        return
    drift = position[:, moving] - integrated[:, moving]
    if np.abs(drift[1:] - drift[:-1]).max() <= JUMP:
        return
    rows = np.arange(1, len(drift))
    earlier, later = np.maximum(rows - 1 - LONGEST_SPIKE, 0), np.minimum(rows + LONGEST_SPIKE, len(drift) - 1)
    ends = (drift[rows] - drift[rows - 1], drift[later] - drift[rows - 1], drift[rows] - drift[earlier])
    beyond = np.min(np.abs(ends), axis=0)  # small at both sides of a spike, which returns within a few rows
    steps = np.diff(time)
    beyond[steps > LONGEST_STEP * np.median(steps)] = 0.0  # across a gap that the time states, no velocity is known
    usual = np.percentile(beyond, 99, axis=0)
    stalled = np.flatnonzero((beyond > JUMP).mean(axis=1) >= JUMPING_SHARE)
    # What is left of leaps after these rows if the row was longer than claimed, by the time that suits all columns
    rows = np.asarray(stalled)
    leap = drift[rows + 1] - drift[rows]
    velocity = (integrated[:, moving][rows + 1] - integrated[:, moving][rows]) / steps[rows, None]
    square = np.maximum((velocity**2).sum(axis=1), np.finfo(float).tiny)
    longer = np.clip((velocity * leap).sum(axis=1) / square, 0.0, LONGEST_STALL_S)
    beyond[stalled] = np.minimum(beyond[stalled], np.asarray(np.abs(leap - longer[:, None] * velocity)))
    leaps = ((beyond > JUMP) & (beyond > JUMP_RATIO * usual)).mean(axis=1)
    row = int(np.argmax(leaps))
    if leaps[row] >= JUMPING_SHARE:
        largest = int(np.argmax(beyond[row]))
        name = [one for one, moves in zip(names, moving, strict=True) if moves][largest]
        raise InputError(
            f"{where}, row {row + 1}",
            f"a leap of half of the columns from the row before, {name} by {beyond[row, largest]:.2g} beyond its speed",
            "rows that follow each other",
            "rows were lost here: cut the log, or give it its own time stamps",
        )


def typical(ratio: float) -> str:
    """The confusion of units that a ratio is known for, in words; empty where it is none of them."""
    for factor, words in TYPICAL:
        if abs(np.log(ratio / factor)) < np.log(1.4) or abs(np.log(ratio * factor)) < np.log(1.4):
            return f" ({words}?)"
    return ""


def check_attitude(columns: Columns, time: np.ndarray, where: object) -> None:
    """The attitude must turn as the angular velocity says, in the order w x y z."""
    axes = [axis for axis, name in enumerate(BASE_ANGULAR_VELOCITY) if name in columns]
    rows = rows_of_window(time)
    if not axes or BASE_QUATERNION[0] not in columns or len(time) < 2 * rows:
        return
    rate = integral(table(columns, [BASE_ANGULAR_VELOCITY[axis] for axis in axes]), time)
    integrated, quaternion = rate[rows:] - rate[:-rows], table(columns, BASE_QUATERNION)
    size, ratio, alike = compare(turns(quaternion, rows)[:, axes], integrated)
    moving = size > MOVES
    other = moving & (alike < OTHER_MOTION)
    if other.any():
        _, _, alike_if_last = compare(turns(np.roll(quaternion, 1, axis=1), rows)[:, axes], integrated)
        last = bool((alike_if_last[moving] > SAME_MOTION).all())
        raise InputError(
            f"{where}, base_quat",
            f"turns that are not those of {BASE_ANGULAR_VELOCITY[axes[int(np.argmax(other))]]}"
            + ("; read as x y z w they would be" if last else ""),
            "quaternions w x y z, base to world, with the angular velocity in base axes",
            "map the four columns in their order",
        )
    wrong = moving & (alike > SAME_MOTION) & ~((ratio > 1 / LARGEST_RATIO) & (ratio < LARGEST_RATIO))
    if wrong.any():
        axis = int(np.argmax(wrong))
        found = f"the attitude turns {ratio[axis]:.3g} times as much{typical(ratio[axis])}"
        expected = "rad/s, and a clock in s"
        raise InputError(f"{where}, column {BASE_ANGULAR_VELOCITY[axes[axis]]}", found, expected, "correct the unit")


def turns(quaternion: np.ndarray, rows: int) -> np.ndarray:
    """Rotation vector in base axes from each row to the one ``rows`` later, rad, (rows − that, 3)."""
    return turn_between(quaternion[:-rows], quaternion[rows:])


def check_set_points(columns: Columns, joints: Sequence[str], where: object) -> None:
    """Where a joint PD acts, the joint must be near its set point, and the two in one unit."""
    names = [joint for joint in joints if f"joint_pos/{joint}" in columns and columns[f"cmd_kp/{joint}"].max() > 0]
    if not names:
        return
    wanted, position = (table(columns, [f"{one}/{joint}" for joint in names]) for one in ("cmd_pos", "joint_pos"))
    far = np.abs(wanted - position) > LARGEST_PD_ERROR
    off = (far.mean(axis=0) > 0.5) & (position.std(axis=0) > MOVES / 10)
    wanted_about, about = wanted - wanted.mean(axis=0), position - position.mean(axis=0)
    spread, ratio, alike = compare(wanted_about, about)
    units = (np.minimum(spread, spread / np.maximum(ratio, np.finfo(float).tiny)) > MOVES / 10) & (alike > SAME_MOTION)
    units &= ~((ratio > 1 / LARGEST_UNIT_RATIO) & (ratio < LARGEST_UNIT_RATIO))
    for column in np.flatnonzero(units | off):
        joint = names[column]
        if np.mean(columns[f"cmd_kp/{joint}"] > 0) <= 0.5:
            continue
        found = f"a set point that is {np.median(np.abs(wanted - position)[:, column]):.3g} off in most rows"
        if units[column]:
            found = f"a set point that moves {ratio[column]:.3g} times as much as the joint{typical(ratio[column])}"
        raise InputError(f"{where}, joint {joint}", found, "joint_pos and cmd_pos in one unit", "correct one of them")


def check_order(columns: Columns, joints: Sequence[str], where: object) -> None:
    """Measured positions must be smooth, and no whole numbers."""
    names = [f"joint_pos/{joint}" for joint in joints if f"joint_pos/{joint}" in columns]
    if not names:
        return
    position = table(columns, names)
    variance = position.var(axis=0)
    wide = variance > WIDE**2
    if not wide.any():
        return
    rough = np.mean(np.diff(position, axis=0) ** 2, axis=0) / np.maximum(variance, np.finfo(float).tiny)
    if (rough[wide] > ROUGH).all() and len(position) > 10:
        found = "steps from row to row as large as the whole motion"
        expected = "rows in the order of time, several to a swing"
        raise InputError(f"{where}, column {names[int(np.argmax(wide))]}", found, expected, "sort the rows")
    whole = wide & (position == np.round(position)).all(axis=0)
    if whole.any():
        found = "whole numbers alone"
        do = "turn the counts of the encoder into rad by a factor, or export more digits"
        raise InputError(f"{where}, column {names[int(np.argmax(whole))]}", found, "angles in rad, or m", do)


def remarks(columns: Columns) -> list[str]:
    """Sentences on what is unusual in the rows of a log that can be used: gaps in time, rows that repeat."""
    time, found = columns["time"], []
    steps = np.diff(time)
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > 5 * usual) if usual > 0 else np.zeros(0, dtype=int)
    if len(gaps):
        lost = round(float((steps[gaps] / usual - 1).sum()))
        found.append(f"about {lost} samples lost in {len(gaps)} places, the first after row {gaps[0]}")
    moving = [values for name, values in columns.items() if name.startswith(("joint_pos/", "base_pos_"))]
    if moving and len(time) > 10:
        same = np.logical_and.reduce([np.diff(values) == 0 for values in moving])
        if 0.4 < same.mean() < 0.6:
            found.append("every other row repeats the row before: a log at twice the rate of its measurements")
    return found
