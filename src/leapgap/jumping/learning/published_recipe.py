"""The paper's networks and training to the letter, but for the number of steps."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.initialisation import PublishedRecipeConfig, initial_published_networks
from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.network import NetworkModel
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.residual_networks import train_networks
from leapgap.jumping.models.rigid_body import RigidBody


@dataclass(frozen=True, kw_only=True)
class PublishedRecipe(ModelRecipe):
    """Raw inputs, one large network a residual, the paper's own body and explicit Euler steps."""

    model: ClassVar[type[Model]] = NetworkModel
    settings: ClassVar[tuple[type, ...]] = (PublishedRecipeConfig,)
    shown_by_step: ClassVar[bool] = False

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train from small orthogonal weights."""
        config = task.settings(PublishedRecipeConfig)
        nominal = Nominal(RigidBody(config.mass_kg, config.pitch_inertia_kgm2))
        start = initial_published_networks(task.train.grid, nominal, config, np.random.default_rng(task.run.seed))
        return train_networks(start, task, config.fitting)


RECIPES: tuple[ModelRecipe, ...] = (PublishedRecipe(name="published_recipe", colour="#a3476b"),)
