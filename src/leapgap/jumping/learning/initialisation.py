"""Scales of networks before training, from training windows only."""

import numpy as np

from leapgap.jumping.learning.model import Nominal
from leapgap.jumping.learning.network import Scaling
from leapgap.jumping.learning.transitions import Transitions
from leapgap.jumping.models.affine_model import columns


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
