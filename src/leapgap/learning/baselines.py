"""What a learned model must beat: the nominal body, constant velocity, playback of the mean training jump."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.learning.model import Model, Nominal, ResidualModel
from leapgap.learning.transitions import transitions
from leapgap.recording.windows import RolloutInputs, Windows
from leapgap.robot.prediction import Affine, Situation
from leapgap.robot.rigid_body import GRAVITY, POSITION, VELOCITY, RigidBody


@dataclass(frozen=True)
class NominalModel(ResidualModel):
    """The rigid body alone, its gains maybe fitted."""

    kind: ClassVar[str] = "nominal"
    nominal: Nominal

    def residual(self, situation: Situation, contact: np.ndarray) -> Affine:
        """None."""
        return Affine(np.zeros((len(contact), 3)), np.zeros((len(contact), 3, 4)))

    def settings(self) -> dict[str, Any]:
        """The body and its gains."""
        return {"nominal": self.nominal.to_json()}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "NominalModel":
        """Read back."""
        return cls(Nominal.from_json(settings["nominal"]))


def fit_gains(windows: Windows, body: RigidBody, curvature: float = 0.0) -> Nominal:
    """The body with the gain of each velocity row that fits the steps in contact best (least squares, no offset)."""
    steps = transitions(windows)
    steps = steps.at(steps.contact)
    pushed = np.einsum("nij,nj->ni", body.force_rows(steps.situation.foot), steps.force)
    measured = steps.acceleration - [0.0, -GRAVITY, 0.0]
    power = (pushed**2).sum(axis=0)
    gains = np.divide((pushed * measured).sum(axis=0), power, out=np.ones(3), where=power > 0)
    return Nominal(body, (float(gains[0]), float(gains[1]), float(gains[2])), curvature)


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
        """Nothing to read back."""
        return cls()


@dataclass(frozen=True)
class Playback(Model):
    """The mean training jump, played back from the measured first state: no model, no inputs."""

    kind: ClassVar[str] = "playback"
    increments: np.ndarray
    """Mean change of the state during each step of the jump, (N, 6)."""

    @staticmethod
    def fit(windows: Windows) -> "Playback":
        """Mean over the jumps of each step's change."""
        steps = transitions(windows)
        increments = [steps.increment[steps.step == n].mean(axis=0) for n in range(steps.step.max() + 1)]
        return Playback(np.array(increments))

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """Add the mean changes, by the number of the step in the jump."""
        steps = inputs.start[:, None] + np.arange(inputs.force.shape[1])
        changes = np.cumsum(self.increments[steps], axis=1)
        return np.concatenate([inputs.state[:, None], inputs.state[:, None] + changes], axis=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """The mean changes."""
        return {"increments": self.increments}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "Playback":
        """Read back."""
        return cls(arrays["increments"])
