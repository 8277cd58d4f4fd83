"""Are the set points what was commanded, in one unit and direction, and does the robot hold them as the log does?"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints
from leapgap.diagnosis.checks.pieces import Pieces, shares
from leapgap.logs.held_set_points import hold_of, on_lines
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.robot.model import Robot

SEEN = 5.0  # Positions move that spread by so many standard deviations of their noise
SAME = 1e-3
"""Set points that differ from the positions by less than this share of their motion in the same or a near row are
these positions."""
NEAR_ROWS = 3
ONE_MOTION, OTHER = 0.9, 5.0
"""Correlation of set points with the integral of their velocities from which on they are of one motion, and ratio from
which on they have two units."""
HOLDS, SHORTEST_S = 6, 0.2  # Pieces last so many holds, and so long at least
FEWEST = 3  # Fewer pieces tell nothing
SURE = 3.0  # Standard errors by which set points stand, or do not


class SetPoints(Check):
    """A log whose set points are its measured positions does not hold what was commanded.

    The statistic is the number of joints of which that is so, or whose set points of positions and velocities have
    other units or signs, in all logs.
    """

    name = "set_points"
    threshold = 0.0
    place = 6
    needs_robot = False

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Hold set points against positions, and against the integrals of their velocities."""
        joints = [joint for joint in logs[0].joints if all(joint in log.joints for log in logs)]
        acting = [j for j in joints if all(log[f"cmd_kp/{j}"].any() and f"joint_pos/{j}" in log for log in logs)]
        if not any(np.ptp(log[f"cmd_pos/{joint}"]) > 0 for log in logs for joint in acting):
            return None
        copies = [j for j in acting if all(is_copy(log, f"cmd_pos/{j}", f"joint_pos/{j}") for log in logs)]
        ratios = {j: ratio for j in acting if (ratio := ratio_of(logs, j)) is not None}
        said = (
            [f"set points of {', '.join(copies)} are the measured positions: no log says what was asked"]
            if copies
            else []
        )
        said += [
            f"set points of {joint} move {ratio:.3g} times as far as their velocities say: two units or directions"
            for joint, ratio in ratios.items()
        ]
        found = float(len({*copies, *ratios}))
        says = "; ".join(said) or "set points are not measurements, and match their velocities"
        return CheckResult(self.name, found <= threshold, found, threshold, says, {log.name: found for log in logs})


def ratio_of(logs: Sequence[Log], joint: str) -> float | None:
    """How many times as far set points move as their velocities say, where these have two units; None elsewhere."""
    slopes = []
    for log in logs:
        position, velocity = log[f"cmd_pos/{joint}"], log[f"cmd_vel/{joint}"]
        if not log[f"cmd_kd/{joint}"].any():
            return None
        slopes.append(slope_of(np.diff(position), (velocity[1:] + velocity[:-1]) / 2 * np.diff(log.time)))
    known = [slope for slope in slopes if slope is not None]
    if len(known) < len(slopes) or any(1 / OTHER < slope < OTHER for slope in known):
        return None
    return float(np.median(known))


def slope_of(moved: np.ndarray, summed: np.ndarray) -> float | None:
    """Slope of displacements by integrals of velocities; None where they are not of one motion."""
    here, there, both = moved @ moved, summed @ summed, moved @ summed
    if here <= 0 or there <= 0 or abs(both) < ONE_MOTION * np.sqrt(here * there):
        return None
    return float(both / there)


def is_copy(log: Log, point: str, position: str) -> bool:
    """Whether a moving column of set points is that of positions, some rows before or after."""
    wanted, measured = log[point], log[position]
    spread = float(measured.std())
    noise = float(noise_of(np.diff(measured)[:, None], log.info.sample_period_s)[0])
    if spread <= SEEN * noise or len(log) < 4 * NEAR_ROWS:
        return False
    inner = slice(NEAR_ROWS, len(log) - NEAR_ROWS)
    rows = range(-NEAR_ROWS, NEAR_ROWS + 1)
    off = [wanted[inner] - measured[NEAR_ROWS + row : len(log) - NEAR_ROWS + row] for row in rows]
    return min(float(np.sqrt(np.mean(of**2))) for of in off) < max(SAME * spread, noise / 2)


class HeldSetPoints(Check):
    """A controller that goes on in straight lines where the log has steps moves the robot more smoothly.

    The statistic is how much of the steps is missing in the motion: 0 for a robot whose set points stand as they are
    logged, 1 for one that goes on in straight lines; gains that act weaker than logged make some of it, too. Short
    pieces are replayed with both, and what is slower than a hold is left out: that is a matter of causes. Where the
    check fails, the diagnosis goes on with lines.
    """

    name = "held_set_points"
    threshold = 0.8
    place = 8
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Replay pieces with set points as logged, and on straight lines to the next and from the one before."""
        if robot is None or not have_joints(logs, robot.joints):
            return None
        holds = {log.name: hold.rows for log in logs if (hold := hold_of(log)) is not None}
        if 2 * len(holds) <= len(logs):
            return None
        held = [log for log in logs if log.name in holds]
        rows = int(np.median(list(holds.values())))
        period = float(np.median([log.info.sample_period_s for log in held]))
        says = f"set points are held for {rows} samples ({1000 * rows * period:.3g} ms) at a time"
        of_logs = {name: float(own) for name, own in holds.items()}
        length = 1 + max(HOLDS * rows, round(SHORTEST_S / period))
        starts = [list(range(0, len(log) - length, length)) for log in held]
        lines, late = ([on_lines(log, late) for log in held] for late in (False, True))
        of_reads = [Pieces.of(read, robot, starts, length) for read in (held, lines, late)]
        if len(of_reads[0].logs) < FEWEST:
            return None
        rates = not any("joint_vel" in log.derived for log in held)
        (as_held, measured), (ahead, _) = (of.motions(velocities=rates) for of in of_reads[:2])
        errors, steps = (without_mean(of, rows) for of in (measured - ahead, as_held - ahead))
        size, error = size_of_steps(errors, steps, rows)
        missing = 1 - size
        passed = missing <= threshold or missing < SURE * error
        if passed:
            told = size > SURE * error and missing < threshold
            says += (
                ", and so they do in the robot" if told else "; the motion does not show whether they do in the robot"
            )
            return CheckResult(self.name, True, min(max(missing, 0.0), threshold), threshold, says, of_logs)
        (ahead, measured), (behind, _) = (of.motions() for of in of_reads[1:])
        back = bool(shares(measured - ahead, [behind - ahead])[0][0] > 0.5)
        line = "from the one before" if back else "to the next one"
        says += (
            f" while the robot goes on ({100 * missing:.0f} ± {max(1.0, 100 * error):.0f} % of their steps are missing"
            f" in its motion): its controller interpolates, or the log is coarser; read on lines {line}"
        )
        return CheckResult(self.name, False, missing, threshold, says, of_logs, reads=partial(on_lines, late=back))


def size_of_steps(errors: np.ndarray, steps: np.ndarray, rows: int) -> tuple[float, float]:
    """How large the response to steps is in the errors, as a share of what it is in a replay, and its standard error.

    Arrays are (pieces, rows, joints). A robot may be late by any time: the response is looked for as it is and a
    quarter of a hold later.
    """
    if rows < 3:
        (share,), (error,) = shares(errors, [steps])
        return float(abs(share)), float(error)
    later = max(1, round(rows / 4))
    both, errors_of = shares(errors[:, later:], [steps[:, later:], steps[:, :-later]])
    return float(np.hypot(*both)), float(np.hypot(*errors_of) / np.sqrt(2))


def without_mean(values: np.ndarray, rows: int) -> np.ndarray:
    """Values (pieces, rows, joints) less their mean over so many rows about each: what follows steps, and no drift."""
    summed = np.cumsum(np.concatenate([0 * values[:, :1], values], axis=1), axis=1)
    mean = (summed[:, rows:] - summed[:, :-rows]) / rows
    if rows % 2 == 0:  # an even number of rows has its middle between two
        mean = (mean[:, 1:] + mean[:, :-1]) / 2
    return np.asarray(values[:, rows // 2 : rows // 2 + mean.shape[1]] - mean)
