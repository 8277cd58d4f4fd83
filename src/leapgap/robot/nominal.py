"""The nominal rigid body as a prediction model: what the MPC plans with before anything is learned."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.robot.prediction import Affine, PredictionModel, Situation
from leapgap.robot.rigid_body import GRAVITY, RigidBody


@dataclass(frozen=True)
class RigidBodyModel(PredictionModel):
    """Gravity and the forces of the feet; nothing but gravity in flight."""

    body: RigidBody = field(default_factory=RigidBody)

    def affine(self, situation: Situation, contact: np.ndarray) -> Affine:
        """As said in ``PredictionModel``."""
        bias = np.tile([0.0, -GRAVITY, 0.0], (len(contact), 1))
        return Affine(bias, self.body.force_rows(situation.foot) * np.asarray(contact)[:, None, None])
