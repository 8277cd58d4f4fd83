"""Interface of models of the deviation from a plan, and the rigid body as one of them.

The deviation e (6,) of the state and du (4,) of the force from those of a plan move by

    ζ_e⁺ = ζ_e + Δt (h + C e + (B + G) du),        q_e⁺ = q_e + Δt ζ_e + c Δt² (h + C e + (B + G) du)

with B of the rigid body at the feet of the plan, and h, C, G of the step of the plan alone: constants of a jump. What
joint PD adds on the way to the plan is part of h, C and G.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.models.affine_model import AffineModel
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.task import Target
from leapgap.logs.pair_force import per_axis

CURVATURE = 0.5
"""c: positions are exact where a step's acceleration is constant."""


@dataclass(frozen=True)
class PlannedSteps:
    """n steps of one plan."""

    time_s: np.ndarray
    """Start of each, since the start of the jump, (n,)."""
    end_s: np.ndarray
    """End of each, (n,)."""
    foot: np.ndarray
    """Planned foot − base, front x z, rear x z, m, at the start of each, (n, 4)."""
    pushing: np.ndarray
    """Whether the front and the rear pair are planned to push at its start, bool, (n, 2)."""
    target: Target
    stance_rad: float = 0.0
    """Planned pitch of the trunk in the crouch at the start, nose-down: that of the ground under the feet."""

    def __len__(self) -> int:
        return len(self.time_s)


class DeviationModel(ABC):
    """Accelerations of the deviation from a plan."""

    body: RigidBody
    """Whose B(r) is part of the model."""

    @abstractmethod
    def residual(self, steps: PlannedSteps) -> AffineModel:
        """h, G and C at n steps, as ``bias``, ``by_force`` and ``by_state``."""

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """All of its numbers, by name."""

    def along(self, steps: PlannedSteps) -> AffineModel:
        """h, B + G and C at n steps; forces of pairs in the air do nothing."""
        found = self.residual(steps)
        by_force = (self.body.force_rows(steps.foot) + found.by_force) * per_axis(steps.pushing)[:, None, :]
        return AffineModel(found.bias, by_force, found.by_state)


@dataclass(frozen=True)
class NominalDeviation(DeviationModel):
    """No residual: the plan is kept, and forces move a rigid body away from it."""

    body: RigidBody

    def residual(self, steps: PlannedSteps) -> AffineModel:
        """Zero h, G and C at n steps."""
        n = len(steps)
        return AffineModel(np.zeros((n, 3)), np.zeros((n, 3, 4)), np.zeros((n, 3, 6)))

    def arrays(self) -> dict[str, np.ndarray]:
        """Nothing was learned."""
        return {}
