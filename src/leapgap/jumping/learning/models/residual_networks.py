"""Our residual networks: small, normalised, an ensemble, trained by gradient descent."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model, Nominal
from leapgap.jumping.learning.models.kernel import REGRESSORS, mode_of, places
from leapgap.jumping.learning.models.nominal import fit_gains
from leapgap.jumping.learning.network import Mlp, NetworkForecast, NetworkModel, Scaling, orthogonal_mlp, random_mlp
from leapgap.jumping.learning.recipe import (
    DeviationRecipe,
    DeviationTask,
    FitTask,
    Fitting,
    LearningCurve,
    ModelRecipe,
    ModelSettings,
    configured_inputs,
)
from leapgap.jumping.learning.window_extraction import BALLISTIC_S
from leapgap.jumping.learning.windows import TimeGrid, Transitions, Windows, drop_forces, extract_transitions
from leapgap.jumping.models.rigid_body import AffineModel, DeviationModel, PlannedSteps, RigidBody, check_names, columns
from leapgap.logs.pair_force import FORCES


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


@dataclass(frozen=True)
class DeviationNetworks(DeviationModel):
    """The mean of the members: h, then C, then G in units, from scaled phase, target and stance."""

    body: RigidBody
    scale: np.ndarray  # Divides phase, s, target x and z, m, and stance, rad, (4,)
    unit: np.ndarray  # Of what an output multiplies: 1, the errors and the forces, (11,)
    acceleration_unit: np.ndarray  # (3,), m/s² and rad/s²
    networks: Mapping[str, Mlp]  # By mode, 4 inputs to 3 × 11 outputs
    landing_s: float

    def residual(self, steps: PlannedSteps) -> AffineModel:
        """h, G and C, the mean over members; zero in the last flight step, in which feet touch down."""
        found = np.zeros((len(steps), 3, REGRESSORS))
        modes, inputs = mode_of(steps), places(steps, self.scale).astype(np.float32)
        learned = steps.time_s < self.landing_s - BALLISTIC_S - 1e-6
        for name, network in self.networks.items():
            mine = (modes == name) & learned
            if mine.any():
                found[mine] = network(inputs[mine]).mean(axis=0).reshape(-1, 3, REGRESSORS)
        found *= self.acceleration_unit[:, None] / self.unit
        return AffineModel(found[:, :, 0], found[:, :, 7:], found[:, :, 1:7])

    def arrays(self) -> dict[str, np.ndarray]:
        """Units, and by mode the weights and biases of each layer."""
        found = {"scale": self.scale, "unit": self.unit, "acceleration_unit": self.acceleration_unit}
        for name, network in self.networks.items():
            found |= network.arrays(name)
        return found


MODES = ("both", "rear", "none")
OUTPUTS = 3 * REGRESSORS


@dataclass
class DeviationNetworksConfig(ModelSettings):
    """Size, units and training of the networks."""

    section: ClassVar[str] = "deviation_networks"
    hidden: list[int] = field(default_factory=lambda: [64])
    seeds: int = 3  # Members of the ensemble
    phase_s: float = 0.1
    target_m: float = 0.3
    stance_rad: float = 0.3  # Units of the inputs
    error_unit: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.05, 0.1, 0.1, 0.4])
    force_unit_n: float = 40.0  # Deviations whose effects are of the size of the outputs
    acceleration_unit: list[float] = field(default_factory=lambda: [2.0, 2.0, 8.0])  # Of the outputs, m/s² and rad/s²
    horizon: int = 10  # Steps of the roll-outs in the loss (K)
    bias_spread: float = 4.0  # Of the first biases, so that units differ in phase
    fitting: Fitting = field(
        default_factory=lambda: Fitting(steps=300, learning_rate=0.01, weight_decay=0.01, clip_norm=1.0)
    )


def initial_deviation_networks(
    task: DeviationTask, config: DeviationNetworksConfig, landing_s: float, random: np.random.Generator
) -> DeviationNetworks:
    """Before training: outputs near zero, so that training starts near the rigid body."""
    scale = np.array([config.phase_s, config.target_m, config.target_m, config.stance_rad])
    sizes = [len(scale), *config.hidden, OUTPUTS]
    networks = {name: random_mlp(sizes, config.seeds, 0.1, config.bias_spread, random) for name in MODES}
    return DeviationNetworks(
        task.body,
        scale,
        np.array([1.0, *config.error_unit, *[config.force_unit_n] * FORCES]),
        np.array(config.acceleration_unit),
        networks,
        landing_s,
    )


class DeviationNetworksRecipe(DeviationRecipe):
    """Trained by Lightning on roll-outs over the horizon."""

    name = "deviation_networks"
    settings = DeviationNetworksConfig

    def fit(self, task: DeviationTask) -> DeviationNetworks:
        """Train from random weights; torch and Lightning take seconds to import, so they are imported here."""
        from leapgap.jumping.learning import training

        config = task.settings(DeviationNetworksConfig)
        landing_s = float(max(jump.steps.end_s[-1] for jump in task.jumps))
        start = initial_deviation_networks(task, config, landing_s, np.random.default_rng(task.seed))
        calm = [jump for jump in task.jumps if jump.kicked is None]  # roll-outs would go across a kick
        return training.fit_deviation(start, calm, config.horizon, config.fitting, task.seed)
