"""The paper's networks and training to the letter, but for the number of steps."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.models.residual_networks import train_networks, unit_scaling
from leapgap.jumping.learning.network import NetworkModel, orthogonal_mlp
from leapgap.jumping.learning.recipe import FitTask, Fitting, LearningCurve, ModelRecipe, ModelSettings
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import RigidBody

PUBLISHED_INPUTS = (
    "x_from_start",
    "z_from_start",
    "pitch",
    "front_foot_x",
    "front_foot_z",
    "rear_foot_x",
    "rear_foot_z",
)
"""q, with positions from the window's start, and r (paper, residual)."""
PUBLISHED_FITTING = Fitting(
    steps=20, learning_rate=2e-4, cosine_decay=False, weight_decay=0.0, clip_norm=0.0, loss="sum"
)
"""As the paper fits, but for the number of steps."""


@dataclass
class PublishedRecipeConfig(ModelSettings):
    """The paper's networks to the letter, but for the number of steps (20 000, hours)."""

    section: ClassVar[str] = "published_recipe"

    hidden_h: list[int] = field(default_factory=lambda: [400, 400])
    hidden_G: list[int] = field(default_factory=lambda: [1000, 1000])  # noqa: N815 - the paper's letter
    orthogonal_gain: float = 0.1
    mass_kg: float = 12.0
    pitch_inertia_kgm2: float = 0.17
    fitting: Fitting = field(default_factory=lambda: replace(PUBLISHED_FITTING))


def initial_published_networks(
    grid: TimeGrid, nominal: Nominal, config: PublishedRecipeConfig, random: np.random.Generator
) -> NetworkModel:
    """The paper's networks before training, with raw inputs.

    Their outputs are velocity changes a step, as in the residual of the released code, which has no Δt.
    """
    sizes = {
        "contact/h": [7, *config.hidden_h, 3],
        "contact/G": [7, *config.hidden_G, 12],
        "flight/h": [7, *config.hidden_h, 3],
    }
    return NetworkModel(
        nominal,
        PUBLISHED_INPUTS,
        unit_scaling(7, 1 / grid.contact_step_s),
        unit_scaling(7, 1 / grid.flight_step_s),
        {name: orthogonal_mlp(size, config.orthogonal_gain, random) for name, size in sizes.items()},
    )


class PublishedRecipe(ModelRecipe):
    """Raw inputs, one large network a residual, the paper's own body and explicit Euler steps."""

    name = "published_recipe"
    model = NetworkModel
    settings = PublishedRecipeConfig
    colour = "#a3476b"
    shown_by_step = False

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train from small orthogonal weights."""
        config = task.settings(PublishedRecipeConfig)
        nominal = Nominal(RigidBody(config.mass_kg, config.pitch_inertia_kgm2))
        start = initial_published_networks(task.train.grid, nominal, config, np.random.default_rng(task.run.seed))
        return train_networks(start, task, config.fitting)
