"""The nominal rigid body as a model: as configured, as published, or with the gain of each velocity row fitted."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model, Nominal, Part, ResidualModel
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.windows import RolloutInputs, Windows, extract_transitions
from leapgap.jumping.models.rigid_body import GRAVITY, POSITION, PUBLISHED, VELOCITY, RigidBody


@dataclass(frozen=True)
class NominalModel(ResidualModel):
    """The rigid body alone, its gains maybe fitted."""

    kind: ClassVar[str] = "nominal"
    nominal: Nominal

    def flat_residual(self, phase: str) -> tuple[np.ndarray, tuple[Part, ...]]:
        """Nothing is added to the nominal body."""
        return np.zeros(3), ()

    def settings(self) -> dict[str, Any]:
        """The body and its gains, as JSON."""
        return {"nominal": self.nominal.to_json()}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "NominalModel":
        """The model whose nominal body is stored in the settings."""
        return cls(Nominal.from_json(settings["nominal"]))


def fit_gains(windows: Windows, body: RigidBody, curvature: float = 0.0) -> Nominal:
    """The body with the gain of each velocity row that fits the steps in contact best (least squares, no offset)."""
    steps = extract_transitions(windows)
    steps = steps.at(steps.contact)
    pushed = np.einsum("nij,nj->ni", body.force_rows(steps.situation.foot), steps.force)
    measured = steps.acceleration - [0.0, -GRAVITY, 0.0]
    power = (pushed**2).sum(axis=0)
    gains = np.divide((pushed * measured).sum(axis=0), power, out=np.ones(3), where=power > 0)
    return Nominal(body, (float(gains[0]), float(gains[1]), float(gains[2])), curvature)


class NominalRecipe(ModelRecipe):
    """The rigid body alone, with explicit Euler steps as in the paper."""

    name = "nominal"
    model = NominalModel
    shown_by_step = False
    body: ClassVar[RigidBody | None] = None  # The body, where it is not the configured one

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Nothing is fitted: the body is taken as it is."""
        return NominalModel(Nominal(self.body or task.body)), []


class NominalPublishedRecipe(NominalRecipe):
    """The rigid body of the published planner."""

    name = "nominal_published"
    body = PUBLISHED


class NominalFittedRecipe(ModelRecipe):
    """The configured body with fitted gains: what the residuals of the learned models are added to."""

    name = "nominal_fitted"
    model = NominalModel
    colour = "#e2542f"
    shown_by_step = False

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Fit three gains by least squares."""
        return NominalModel(fit_gains(task.train, task.body, task.curvature)), []


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


@dataclass(frozen=True)
class Playback(Model):
    """The mean training jump, played back from the measured first state: no model, no inputs."""

    kind: ClassVar[str] = "playback"
    increments: np.ndarray  # Mean change of the state during each step of the jump, (N, 6)

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
