"""The mean of several residual models: their errors differ, so the mean's is smaller."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import FlatPhase, Model, Nominal, ResidualModel, average_flat_models
from leapgap.jumping.learning.model_files import arrays_below
from leapgap.jumping.learning.models.kernel import KernelModel
from leapgap.jumping.learning.network import NetworkModel
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.models.rigid_body import AffineModel, Situation

MEMBER_CLASSES: dict[str, type[ResidualModel]] = {member.kind: member for member in (KernelModel, NetworkModel)}


@dataclass(frozen=True)
class ModelEnsemble(ResidualModel):
    """Accelerations are the members' mean, so it is affine in the force as they are."""

    kind: ClassVar[str] = "blend"
    members: tuple[ResidualModel, ...]

    @property
    def nominal(self) -> Nominal:  # type: ignore[override]
        """The nominal body of the first member, from which the residual is counted."""
        return self.members[0].nominal

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """The mean of the members' accelerations."""
        terms = [member.affine(situation, contact) for member in self.members]
        return AffineModel(np.mean([t.bias for t in terms], axis=0), np.mean([t.by_force for t in terms], axis=0))

    def flatten(self) -> dict[str, FlatPhase]:
        """The mean of the members' flat forms."""
        return average_flat_models([member.flatten() for member in self.members])

    def arrays(self) -> dict[str, np.ndarray]:
        """The members' arrays, as ``0/…``."""
        return {f"{i}/{name}": a for i, member in enumerate(self.members) for name, a in member.arrays().items()}

    def settings(self) -> dict[str, Any]:
        """The members' kinds and settings."""
        return {"members": [{"kind": member.kind, "settings": member.settings()} for member in self.members]}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "ModelEnsemble":
        """The ensemble of stored members."""
        members: Any = [
            MEMBER_CLASSES[about["kind"]].from_parts(arrays_below(arrays, str(i)), about["settings"])
            for i, about in enumerate(settings["members"])
        ]
        return cls(tuple(members))


class BlendRecipe(ModelRecipe):
    """The mean of models that other recipes fitted on the same split before."""

    name = "blend"
    model = ModelEnsemble
    members = ("networks", "kernel")
    colour = "#7c3aed"
    uncertainty_from = "kernel"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Nothing is fitted again: the members are read."""
        members = []
        for name in self.members:
            member = task.member(name)
            assert isinstance(member, ResidualModel)
            members.append(member)
        return ModelEnsemble(tuple(members)), []


class BlendWithoutPhaseRecipe(BlendRecipe):
    """The same for any contact schedule."""

    name = "blend_no_phase"
    members = ("networks_no_phase", "kernel_no_phase")
    colour = "#bb9bf3"
    uncertainty_from = "kernel_no_phase"
