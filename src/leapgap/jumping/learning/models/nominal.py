"""The nominal rigid body as a model: as configured, as published, or with the gain of each velocity row fitted."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.flat_model import Part
from leapgap.jumping.learning.model import Model, Nominal, ResidualModel
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.transitions import extract_transitions
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.affine_model import AffineModel, Situation
from leapgap.jumping.models.rigid_body import GRAVITY, PUBLISHED, RigidBody


@dataclass(frozen=True)
class NominalModel(ResidualModel):
    """The rigid body alone, its gains maybe fitted."""

    kind: ClassVar[str] = "nominal"
    nominal: Nominal

    def residual(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """No residual: zeros of shapes (n, 3) and (n, 3, 4)."""
        return AffineModel(np.zeros((len(contact), 3)), np.zeros((len(contact), 3, 4)))

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
    body: ClassVar[RigidBody | None] = None
    """The body, where it is not the configured one."""

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
