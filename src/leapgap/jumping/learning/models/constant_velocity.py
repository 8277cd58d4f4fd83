"""Constant velocity, the simplest prediction that a learned model must beat."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.windows import RolloutInputs
from leapgap.jumping.models.rigid_body import POSITION, VELOCITY


@dataclass(frozen=True)
class ConstantVelocity(Model):
    """Everything goes on as at the first sample: no forces, no gravity."""

    kind: ClassVar[str] = "constant_velocity"

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """Positions grow with the first velocities."""
        elapsed = np.concatenate([np.zeros((len(inputs), 1)), np.cumsum(inputs.step_s, axis=1)], axis=1)
        states = np.repeat(inputs.state[:, None], elapsed.shape[1], axis=1)
        states[..., POSITION] += elapsed[..., None] * inputs.state[:, None, VELOCITY]
        return states

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "ConstantVelocity":
        """The model, which has no parts."""
        return cls()


class ConstantVelocityRecipe(ModelRecipe):
    """Constant velocity needs no training and looks at nothing measured after the first step."""

    name = "constant_velocity"
    model = ConstantVelocity
    colour = "#8a93a3"
    can_be_exported = False
    shown_by_step = False
    forecast_name = "constant_velocity"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Return the model, which has nothing to fit."""
        return ConstantVelocity(), []
