"""What a named model of the deviation from a plan says of itself: how it is fitted to jumps."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from leapgap.jumping.learning.deviations import DeviatingJump
from leapgap.jumping.learning.recipe import ModelSettings, Settings, settings_in
from leapgap.jumping.models.deviation_model import DeviationModel
from leapgap.jumping.models.rigid_body import RigidBody


@dataclass(frozen=True)
class DeviationTask:
    """The jumps and settings from which a recipe fits one model."""

    jumps: Sequence[DeviatingJump]
    body: RigidBody
    model_settings: Mapping[str, ModelSettings] = field(default_factory=dict)
    """Settings of models by their section, where they are not the defaults."""
    seed: int = 0

    def settings(self, kind: type[Settings]) -> Settings:
        """The settings of one kind of models."""
        return settings_in(self.model_settings, kind)


class DeviationRecipe(ABC):
    """A named model of the deviation from a plan. To add one, add a subclass in a file of the package ``models``."""

    name: ClassVar[str]
    settings: ClassVar[type[ModelSettings] | None] = None
    """Settings of its own that its fit reads."""

    @abstractmethod
    def fit(self, task: DeviationTask) -> DeviationModel:
        """Fit the model to the jumps."""
