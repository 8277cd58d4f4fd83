"""A plan that can be moved to neighbouring goals while it is carried out.

Set points, velocities, torques and forces of a smooth family of plans are nearly linear in the goal. Their slopes are
differences to the plans of neighbouring goals. All of them move together, so that joint PD and feed-forward agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.reference import Reference

QUANTITIES = ("state", "foot", "joint_pos", "joint_vel", "torque", "force")
GOAL_AXES = 3
"""x and z of the landing, m, and its pitch, rad."""
DEVIATIONS = 10
"""Trunk (x z pitch and their rates) and feet (front x z, rear x z, relative to the base) − those of a shifted plan."""


@dataclass(frozen=True)
class ShiftedPlan:
    """A plan, and its slopes by the goal: ``slopes[quantity]`` of shape (3, rows, n), per m, m and rad."""

    reference: Reference
    slopes: dict[str, np.ndarray]

    @staticmethod
    def of(reference: Reference, neighbours: Sequence[Reference], steps: Sequence[float]) -> "ShiftedPlan":
        """From the plans of the goals that are ``steps`` (m, m, rad) farther along each axis."""
        slopes = {
            name: np.stack(
                [
                    (getattr(other, name) - getattr(reference, name)) / step
                    for other, step in zip(neighbours, steps, strict=True)
                ]
            )
            for name in QUANTITIES
        }
        return ShiftedPlan(reference, slopes)

    def at(self, quantity: str, row: int | np.ndarray, shift: np.ndarray) -> np.ndarray:
        """A quantity at one or several rows for one shift (3,) of the goal, (n,) or (rows, n)."""
        values: np.ndarray = getattr(self.reference, quantity)[row]
        return values + np.tensordot(shift, self.slopes[quantity][:, row], axes=1)

    def moved(self, change: dict[str, np.ndarray]) -> "ShiftedPlan":
        """The plan with ``change[quantity]`` (rows, n) added to each quantity, and the same slopes."""
        values = {name: getattr(self.reference, name) + change[name] for name in QUANTITIES}
        return ShiftedPlan(replace(self.reference, **values), self.slopes)

    def change_to(self, shift: np.ndarray) -> dict[str, np.ndarray]:
        """What a shift (3,) of the goal changes in each quantity, (rows, n)."""
        return {name: np.tensordot(shift, self.slopes[name], axes=1) for name in QUANTITIES}
