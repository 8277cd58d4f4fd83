"""Playback of the mean training jump, which a learned model must beat."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.transitions import extract_transitions
from leapgap.jumping.learning.windows import RolloutInputs, Windows


@dataclass(frozen=True)
class Playback(Model):
    """The mean training jump, played back from the measured first state: no model, no inputs."""

    kind: ClassVar[str] = "playback"
    increments: np.ndarray
    """Mean change of the state during each step of the jump, (N, 6)."""

    @staticmethod
    def fit(windows: Windows) -> "Playback":
        """Mean over the jumps of each step's change."""
        steps = extract_transitions(windows)
        increments = [steps.increment[steps.step == n].mean(axis=0) for n in range(steps.step.max() + 1)]
        return Playback(np.array(increments))

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """Add the mean changes, by the number of the step in the jump."""
        steps = inputs.start[:, None] + np.arange(inputs.force.shape[1])
        changes = np.cumsum(self.increments[steps], axis=1)
        return np.concatenate([inputs.state[:, None], inputs.state[:, None] + changes], axis=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """The mean changes, as ``increments``."""
        return {"increments": self.increments}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "Playback":
        """The model of stored mean changes."""
        return cls(arrays["increments"])


class PlaybackRecipe(ModelRecipe):
    """Playback looks at nothing measured after the first step and cannot say how forces move the base."""

    name = "playback"
    model = Playback
    colour = "#d19a1b"
    can_be_exported = False
    forecast_name = "playback"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """The mean motion of the training jumps; there is nothing to iterate, hence no curve."""
        return Playback.fit(task.train), []
