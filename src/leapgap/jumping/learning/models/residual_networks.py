"""Our residual networks: small, normalised, an ensemble, trained by gradient descent."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.models.nominal import fit_gains
from leapgap.jumping.learning.network import NetworkForecast, NetworkModel, Scaling, orthogonal_mlp, random_mlp
from leapgap.jumping.learning.recipe import (
    FitTask,
    Fitting,
    LearningCurve,
    ModelRecipe,
    ModelSettings,
    configured_inputs,
)
from leapgap.jumping.learning.windows import TimeGrid, Transitions, Windows, drop_forces, extract_transitions
from leapgap.jumping.models.affine_model import check_names, columns
from leapgap.jumping.models.rigid_body import RigidBody


def fit_scaling(
    steps: Transitions, names: tuple[str, ...], weight: np.ndarray, nominal: Nominal, force_scale: float
) -> Scaling:
    """Means and spreads of the steps of one phase; units where it has no step."""
    if not len(steps.step):
        return unit_scaling(len(names), 1.0)
    raw = np.stack(columns(names, steps.situation), axis=-1)
    residual = steps.acceleration - nominal.at(steps.situation.foot).acceleration(steps.force)
    return Scaling(
        input_mean=raw.mean(axis=0),
        input_scale=(raw.std(axis=0) + 1e-6) / weight,
        force_mean=steps.force.mean(axis=0),
        force_scale=(steps.force.std(axis=0) + 1e-6) * force_scale,
        mean=residual.mean(axis=0),
        scale=residual.std(axis=0) + 1e-6,
    )


def unit_scaling(inputs: int, output: float) -> Scaling:
    """The scaling that leaves inputs and forces raw; ``output`` is the unit of h and G."""
    return Scaling(np.zeros(inputs), np.ones(inputs), np.zeros(4), np.ones(4), np.zeros(3), np.full(3, output))


INPUTS = {
    **{"z": 0.15, "pitch": 0.15, "vx": 0.15, "vz": 0.15, "pitch_rate": 1.0},
    **{"front_foot_x": 0.5, "front_foot_z": 0.5, "rear_foot_x": 0.5, "rear_foot_z": 0.5, "phase": 8.0},
}
"""Of the networks, chosen by cross-validation over jumps of one contact schedule."""


@dataclass
class NetworksConfig(ModelSettings):
    """Small normalised networks with better inputs; an ensemble."""

    section: ClassVar[str] = "networks"

    inputs: dict[str, float] = field(default_factory=lambda: dict(INPUTS))
    """Inputs, each with its weight after scaling to unit variance: a large weight lets the model change fast."""
    hidden: list[int] = field(default_factory=lambda: [128])  # Units of each hidden layer of h1, G1 and h2
    seeds: int = 3  # Members of the ensemble
    force_scale: float = 5.0  # Standard deviations of a force that count like one of an input
    output_gain: float = 0.1
    bias_spread: float = 2.5
    fitting: Fitting = field(default_factory=Fitting)


def initial_networks(
    windows: Windows, nominal: Nominal, config: NetworksConfig, random: np.random.Generator
) -> NetworkModel:
    """Our networks before training: inputs and outputs scaled by the spread of the training steps."""
    names = tuple(config.inputs)
    check_names(names, "train.networks.inputs")
    steps = extract_transitions(windows)
    weight = np.array(list(config.inputs.values()))
    contact = fit_scaling(steps.at(steps.contact), names, weight, nominal, config.force_scale)
    flight = fit_scaling(steps.at(~steps.contact), names, weight, nominal, config.force_scale)
    outputs = {"contact/h": 3, "contact/G": 12, "flight/h": 3}
    found = {
        name: random_mlp(
            [len(names), *config.hidden, size], config.seeds, config.output_gain, config.bias_spread, random
        )
        for name, size in outputs.items()
    }
    return NetworkModel(nominal, names, contact, flight, found)


class NetworksRecipe(ModelRecipe):
    """Networks for the residual of the body with fitted gains."""

    name = "networks"
    model = NetworkModel
    settings = NetworksConfig
    colour = "#2563c9"
    label_is_plural = True
    uncertainty_from = "kernel"
    uses_phase: ClassVar[bool] = True  # Whether the phase of the jump stays among the configured inputs

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train from random weights."""
        config = task.settings(NetworksConfig)
        config = replace(config, inputs=configured_inputs(config.inputs, self.uses_phase))
        nominal = fit_gains(task.train, task.body, task.curvature)
        start = initial_networks(task.train, nominal, config, np.random.default_rng(task.run.seed))
        return train_networks(start, task, config.fitting)


class NetworksWithoutPhaseRecipe(NetworksRecipe):
    """The same for any contact schedule."""

    name = "networks_no_phase"
    colour = "#7ba7ea"
    uncertainty_from = "kernel_no_phase"
    uses_phase = False


class NetworksForecastRecipe(ModelRecipe):
    """Networks for whole accelerations from state and phase, with no nominal body under them.

    What acts later is not known to a forecast, so feet are no inputs and forces are zero.
    """

    name = "networks_forecast"
    model = NetworkForecast
    settings = NetworksConfig
    colour = "#b3cdf3"
    label_is_plural = True
    is_forecast = True
    can_be_exported = False
    forecast_name = "networks"
    uncertainty_from = "kernel_forecast"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Train on the same motion as if nothing pushed."""
        config = task.settings(NetworksConfig)
        config = replace(config, inputs=configured_inputs(config.inputs, uses_phase=True, uses_feet=False))
        blind = replace(task, train=drop_forces(task.train), held_out=drop_forces(task.held_out))
        nothing = Nominal(RigidBody(mass_kg=np.inf, pitch_inertia_kgm2=np.inf), curvature=task.curvature)
        start = initial_networks(blind.train, nothing, config, np.random.default_rng(task.run.seed))
        model, curve = train_networks(start, blind, config.fitting)
        return NetworkForecast(**vars(model)), curve


def train_networks(start: NetworkModel, task: FitTask, fitting: Fitting) -> tuple[NetworkModel, LearningCurve]:
    """Move the weights of ``start``; torch and Lightning take seconds to import, so they are imported here."""
    from leapgap.jumping.learning import training

    held_out = task.held_out if len(task.held_out) else None
    return training.fit(start, task.train, held_out, fitting, task.run)


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
