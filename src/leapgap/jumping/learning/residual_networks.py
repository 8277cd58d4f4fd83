"""Our residual networks as recipes: small, normalised, an ensemble, trained by gradient descent."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.initialisation import Fitting, NetworksConfig, initial_networks
from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.network import NetworkForecast, NetworkModel
from leapgap.jumping.learning.nominal import fit_gains
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe, configured_inputs
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.rigid_body import RigidBody


@dataclass(frozen=True, kw_only=True)
class NetworksRecipe(ModelRecipe):
    """Networks for the residual of the body with fitted gains."""

    model: ClassVar[type[Model]] = NetworkModel
    settings: ClassVar[tuple[type, ...]] = (NetworksConfig,)
    label_is_plural: ClassVar[bool] = True
    uses_phase: bool = True
    """Whether the phase of the jump stays among the configured inputs."""

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train from random weights."""
        config = task.settings(NetworksConfig)
        config = replace(config, inputs=configured_inputs(config.inputs, self.uses_phase))
        nominal = fit_gains(task.train, task.body, task.curvature)
        start = initial_networks(task.train, nominal, config, np.random.default_rng(task.run.seed))
        return train_networks(start, task, config.fitting)


@dataclass(frozen=True, kw_only=True)
class NetworksForecastRecipe(ModelRecipe):
    """Networks for whole accelerations from state and phase, with no nominal body under them.

    What acts later is not known to a forecast, so feet are no inputs and forces are zero.
    """

    model: ClassVar[type[Model]] = NetworkForecast
    settings: ClassVar[tuple[type, ...]] = (NetworksConfig,)
    label_is_plural: ClassVar[bool] = True
    is_forecast: ClassVar[bool] = True
    can_be_exported: ClassVar[bool] = False

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train on the same motion as if nothing pushed."""
        config = task.settings(NetworksConfig)
        config = replace(config, inputs=configured_inputs(config.inputs, uses_phase=True, uses_feet=False))
        blind = replace(task, train=drop_forces(task.train), held_out=drop_forces(task.held_out))
        nothing = Nominal(RigidBody(mass_kg=np.inf, pitch_inertia_kgm2=np.inf), curvature=task.curvature)
        start = initial_networks(blind.train, nothing, config, np.random.default_rng(task.run.seed))
        model, curve = train_networks(start, blind, config.fitting)
        return NetworkForecast(**vars(model)), curve


def drop_forces(windows: Windows) -> Windows:
    """The same motion with forces and feet at zero."""
    return replace(windows, force=np.zeros_like(windows.force), foot=np.zeros_like(windows.foot))


def train_networks(start: NetworkModel, task: FitTask, fitting: Fitting) -> tuple[NetworkModel, LearningCurve]:
    """Move the weights of ``start``; torch and Lightning take seconds to import, so they are imported here."""
    from leapgap.jumping.learning import training

    held_out = task.held_out if len(task.held_out) else None
    return training.fit(start, task.train, held_out, fitting, task.run)


RECIPES: tuple[ModelRecipe, ...] = (
    NetworksRecipe(name="networks", colour="#2563c9", uncertainty_from="kernel"),
    NetworksRecipe(name="networks_no_phase", uses_phase=False, colour="#7ba7ea", uncertainty_from="kernel_no_phase"),
    NetworksForecastRecipe(
        name="networks_forecast", colour="#b3cdf3", forecast_name="networks", uncertainty_from="kernel_forecast"
    ),
)
