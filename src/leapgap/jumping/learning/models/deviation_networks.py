"""Networks for h, C and G of the deviation from a plan: small ones, one for each mode of contact, an ensemble."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.models.deviation_kernel import REGRESSORS, mode_of, places
from leapgap.jumping.learning.network import Mlp, random_mlp
from leapgap.jumping.learning.recipe import DeviationRecipe, DeviationTask, Fitting, ModelSettings
from leapgap.jumping.learning.window_extraction import BALLISTIC_S
from leapgap.jumping.models.affine_model import AffineModel
from leapgap.jumping.models.rigid_body import DeviationModel, PlannedSteps, RigidBody
from leapgap.logs.pair_force import FORCES


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


def initial_networks(
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
        from leapgap.jumping.learning import deviation_training

        config = task.settings(DeviationNetworksConfig)
        landing_s = float(max(jump.steps.end_s[-1] for jump in task.jumps))
        start = initial_networks(task, config, landing_s, np.random.default_rng(task.seed))
        calm = [jump for jump in task.jumps if jump.kicked is None]  # roll-outs would go across a kick
        return deviation_training.fit(start, calm, config.horizon, config.fitting, task.seed)
