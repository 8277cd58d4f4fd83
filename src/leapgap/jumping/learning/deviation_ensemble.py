"""Trained networks for h, C and G of the deviation from a plan."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.learning.deviations import BALLISTIC_S
from leapgap.jumping.learning.models.deviation_kernel import REGRESSORS, mode_of, places
from leapgap.jumping.learning.network import Mlp
from leapgap.jumping.models.affine_model import AffineModel
from leapgap.jumping.models.deviation_model import DeviationModel, PlannedSteps
from leapgap.jumping.models.rigid_body import RigidBody


@dataclass(frozen=True)
class DeviationNetworks(DeviationModel):
    """The mean of the members: h, then C, then G in units, from scaled phase, target and stance."""

    body: RigidBody
    scale: np.ndarray
    """Divides phase, s, target x and z, m, and stance, rad, (4,)."""
    unit: np.ndarray
    """Of what an output multiplies: 1, the errors and the forces, (11,)."""
    acceleration_unit: np.ndarray
    """(3,), m/s² and rad/s²."""
    networks: Mapping[str, Mlp]
    """By mode, 4 inputs to 3 × 11 outputs."""
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
            found |= {f"{name}/weight_{i}": weight for i, weight in enumerate(network.weights)}
            found |= {f"{name}/bias_{i}": bias for i, bias in enumerate(network.biases)}
        return found
