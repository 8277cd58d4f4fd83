"""Are the set points what was commanded, in one unit and one direction?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
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


class SetPoints(Check):
    """A log whose set points are its measured positions does not hold what was commanded.

    The statistic is the number of joints of which that is so, or whose set points of positions and velocities have
    other units or signs, in all logs.
    """

    name = "set_points"
    threshold = 0.0
    place: ClassVar[int] = 6
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
