"""Networks for h, C and G of the deviation from a plan: small ones, one for each mode of contact, an ensemble."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.deviation_ensemble import DeviationNetworks
from leapgap.jumping.learning.deviation_recipe import DeviationRecipe, DeviationTask
from leapgap.jumping.learning.models.deviation_kernel import REGRESSORS
from leapgap.jumping.learning.network import random_mlp
from leapgap.jumping.learning.recipe import Fitting, ModelSettings
from leapgap.logs.pair_force import FORCES

MODES = ("both", "rear", "none")
OUTPUTS = 3 * REGRESSORS


@dataclass
class DeviationNetworksConfig(ModelSettings):
    """Size, units and training of the networks."""

    section: ClassVar[str] = "deviation_networks"
    hidden: list[int] = field(default_factory=lambda: [64])
    seeds: int = 3
    """Members of the ensemble."""
    phase_s: float = 0.1
    target_m: float = 0.3
    stance_rad: float = 0.3
    """Units of the inputs."""
    error_unit: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.05, 0.1, 0.1, 0.4])
    force_unit_n: float = 40.0
    """Deviations whose effects are of the size of the outputs."""
    acceleration_unit: list[float] = field(default_factory=lambda: [2.0, 2.0, 8.0])
    """Of the outputs, m/s² and rad/s²."""
    horizon: int = 10
    """Steps of the roll-outs in the loss (K)."""
    bias_spread: float = 4.0
    """Of the first biases, so that units differ in phase."""
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
