"""A plan that can be moved to neighbouring goals, and to another stance, while it is carried out.

Set points, velocities, torques and forces of a smooth family of plans are nearly linear in the goal and in the pitch of
the ground they start from. Their slopes are differences to the plans of neighbouring goals, and of a neighbouring
stance. All of them move together, so that joint PD and feed-forward agree.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.reference import Reference

QUANTITIES = ("state", "foot", "joint_pos", "joint_vel", "torque", "force")
GOAL_AXES = 3
"""x and z of the landing, m, and its pitch, rad."""
DEVIATIONS = 10
"""Trunk (x z pitch and their rates) and feet (front x z, rear x z, relative to the base) − those of a shifted plan."""


@dataclass(frozen=True)
class ShiftedPlan:
    """A plan and its slopes: ``slopes[quantity]`` of shape (axes, rows, n), per m, m, rad and rad.

    The axes are those of the goal and, where the plan can be moved to another stance, the pitch of the ground at the
    start, rad, nose-down.
    """

    reference: Reference
    slopes: dict[str, np.ndarray]

    @staticmethod
    def of(reference: Reference, neighbours: Sequence[Reference], steps: Sequence[float]) -> "ShiftedPlan":
        """From the plans of the goals that are ``steps`` (m, m, rad) farther along each axis."""
        of_axes = [differences(reference, other, step) for other, step in zip(neighbours, steps, strict=True)]
        return ShiftedPlan(reference, {name: np.stack([slopes[name] for slopes in of_axes]) for name in QUANTITIES})

    def with_stance(self, slopes: Mapping[str, np.ndarray]) -> "ShiftedPlan":
        """The same with slopes by the stance, (rows, n) for each quantity, per rad."""
        return ShiftedPlan(self.reference, {name: np.stack([*self.slopes[name], slopes[name]]) for name in QUANTITIES})

    @property
    def axes(self) -> int:
        """Number of axes along which the plan can be moved: 3, or 4 with the stance."""
        return len(self.slopes["state"])

    def at(self, quantity: str, row: int | np.ndarray, shift: np.ndarray) -> np.ndarray:
        """A quantity at one or several rows, (n,) or (rows, n), for a shift (3,) or, with the stance, (4,)."""
        values: np.ndarray = getattr(self.reference, quantity)[row]
        return values + np.tensordot(shift, self.slopes[quantity][: len(shift), row], axes=1)


def differences(reference: Reference, other: Reference, step: float) -> dict[str, np.ndarray]:
    """(Other plan − plan) / step of each quantity, (rows, n)."""
    return {name: (getattr(other, name) - getattr(reference, name)) / step for name in QUANTITIES}
