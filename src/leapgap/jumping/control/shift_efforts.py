"""Limits of the ground forces, the friction and the torques of a plan while its goal is shifted."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.shifted_plan import ShiftedPlan
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from leapgap.robot.topology import PAIRS

BEFORE_NEXT_S = 0.002
"""The last sample of a step is this long before its end."""


@dataclass(frozen=True)
class EffortLimits:
    """What is limited, and how softly."""

    force: ForceLimits
    torque_nm: float
    soft: tuple[float, float]
    """Violations of a force limit, N, and of a torque limit, N·m, that cost alike."""


@dataclass(frozen=True)
class Efforts:
    """The m limits of the steps of one horizon, each at a sample of a step.

    slope · shift of its step − soft · slack ≤ room, which depends on how far goal and stance were moved before.
    ``axes`` are those of the plan. Forces are limited where the plan itself pushes.
    """

    step: np.ndarray
    """Step of the horizon, int, (m,)."""
    slope: np.ndarray
    """Change of the effort by goal and stance, (m, axes)."""
    soft: np.ndarray
    """(m,)."""
    distance: np.ndarray
    """Distance of the plan itself to the limit, (m,)."""

    def room(self, change: np.ndarray) -> np.ndarray:
        """Distance to the limit where goal and stance were changed (axes,), (m,)."""
        return self.distance - self.slope @ change


def efforts_of(plan: ShiftedPlan, grid: ShiftGrid, edges: np.ndarray, limits: EffortLimits) -> Efforts:
    """The limits of a horizon whose steps begin and end at the updates ``edges`` (steps + 1,)."""
    reference = plan.reference
    # Left and right legs have equal torques: one of each is enough.
    joints = np.unique(reference.torque, axis=1, return_index=True)[1]
    first, last = grid.period_s * edges[:-1], grid.period_s * edges[1:]
    times = np.stack([first, (first + last) / 2, last - BEFORE_NEXT_S], axis=1)
    parts: list[tuple[np.ndarray, ...]] = []
    for step, rows in enumerate(reference.rows(times)):
        force, force_slope = reference.force[rows], plan.slopes["force"][:, rows]
        torque, torque_slope = reference.torque[rows], plan.slopes["torque"][:, rows]
        stands = reference.schedule.in_contact(rows * reference.period_s)
        for pair in range(len(PAIRS)):
            on = stands[:, pair] & (force[:, FORCE_Z][:, pair] > limits.force.smallest_n)
            x, z = (force[on][:, axis][:, pair] for axis in (FORCE_X, FORCE_Z))
            dx, dz = (force_slope[:, on][:, :, axis][:, :, pair].T for axis in (FORCE_X, FORCE_Z))
            friction, smallest_n, largest_n = limits.force.friction, limits.force.smallest_n, limits.force.largest_n
            for excess, slope in (
                (x - friction * z, dx - friction * dz),
                (-x - friction * z, -dx - friction * dz),
                (z - largest_n, dz),
                (smallest_n - z, -dz),
            ):
                parts.append((np.full(len(z), step), slope, np.full(len(z), limits.soft[0]), -excess))
        for sign in (1.0, -1.0):
            distance = (limits.torque_nm - sign * torque[:, joints]).ravel()
            slope = sign * torque_slope[:, :, joints].reshape(plan.axes, -1).T
            count = len(distance)
            parts.append((np.full(count, step), slope, np.full(count, limits.soft[1]), distance))
    return Efforts(*(np.concatenate(part) for part in zip(*parts, strict=True)))
