"""Networks before training: their inputs, scales and random first weights. Everything from training windows only."""

from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.network import NetworkModel, Scaling, orthogonal_mlp, random_mlp
from leapgap.jumping.learning.transitions import Transitions, extract_transitions
from leapgap.jumping.learning.windows import TimeGrid, Windows
from leapgap.jumping.models.affine_model import check_names, columns

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


@dataclass
class Fitting:
    """How the optimiser moves the weights."""

    steps: int = 120
    """Full-batch steps of the optimiser."""
    learning_rate: float = 0.02
    cosine_decay: bool = True
    """Whether the learning rate falls to zero along a cosine."""
    weight_decay: float = 0.1
    dropout: float = 0.0
    clip_norm: float = 1.0
    """Longest gradient; 0: any."""
    output_penalty: float = 1e-3
    """Weight of the mean absolute outputs of h and G (paper, loss)."""
    loss: str = "mean"
    """Of squared errors over windows, steps and components: ``mean``, or ``sum`` as published."""
    patience: int = 0
    """Points of the curve without a smaller error on the stopping jumps until training ends; 0: all steps."""
    stopping_jumps: int = 0
    """How many of the training jumps, the last ones, are kept for that; the held-out ones are never asked."""


INPUTS = {
    **{"z": 0.15, "pitch": 0.15, "vx": 0.15, "vz": 0.15, "pitch_rate": 1.0},
    **{"front_foot_x": 0.5, "front_foot_z": 0.5, "rear_foot_x": 0.5, "rear_foot_z": 0.5, "phase": 8.0},
}
"""Of the networks, chosen by cross-validation over jumps of one contact schedule."""
PUBLISHED_FITTING = Fitting(
    steps=20, learning_rate=2e-4, cosine_decay=False, weight_decay=0.0, clip_norm=0.0, loss="sum"
)
"""As the paper fits, but for the number of steps."""


@dataclass
class NetworksConfig:
    """Small normalised networks with better inputs; an ensemble."""

    inputs: dict[str, float] = field(default_factory=lambda: dict(INPUTS))
    """Inputs, each with its weight after scaling to unit variance: a large weight lets the model change fast."""
    hidden: list[int] = field(default_factory=lambda: [128])
    """Units of each hidden layer of h1, G1 and h2."""
    seeds: int = 3
    """Members of the ensemble."""
    force_scale: float = 5.0
    """Standard deviations of a force that count like one of an input."""
    output_gain: float = 0.1
    bias_spread: float = 2.5
    fitting: Fitting = field(default_factory=Fitting)


@dataclass
class PublishedRecipeConfig:
    """The paper's networks to the letter, but for the number of steps (20 000, hours)."""

    hidden_h: list[int] = field(default_factory=lambda: [400, 400])
    hidden_G: list[int] = field(default_factory=lambda: [1000, 1000])  # noqa: N815 - the paper's letter
    orthogonal_gain: float = 0.1
    mass_kg: float = 12.0
    pitch_inertia_kgm2: float = 0.17
    fitting: Fitting = field(default_factory=lambda: replace(PUBLISHED_FITTING))


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
