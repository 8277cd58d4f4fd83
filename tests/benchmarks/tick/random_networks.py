"""Networks of given sizes with random weights, in NumPy."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from leapgap.jumping.learning.models.residual_networks import (
    DeviationNetworks,
    DeviationNetworksConfig,
    initial_deviation_networks,
)
from leapgap.jumping.learning.recipe import DeviationTask
from leapgap.jumping.models.rigid_body import GRAVITY, AffineModel, PredictionModel, Situation, rows, selection
from tests.conftest import A1_BODY

INPUTS = ("x_from_start", "z_from_start", "pitch", "front_foot_x", "front_foot_z", "rear_foot_x", "rear_foot_z")
SELECT = selection(INPUTS)
PAPER = ((400, 400), (1000, 1000))
SMALL = ((64, 64), (64, 64))
LIKE_CONTROL = 0.01
"""Outputs this small keep the plans sensible."""
Layers = list[tuple[np.ndarray, np.ndarray]]


def layers(widths: tuple[int, ...], outputs: int, rng: np.random.Generator) -> Layers:
    """Random orthogonal weights (out, in) and zero biases, float32."""
    sizes = (len(INPUTS), *widths, outputs)
    made = []
    for before, after in pairwise(sizes):
        q, _ = np.linalg.qr(rng.normal(size=(max(before, after), min(before, after))))
        weight = (q if after >= before else q.T).astype(np.float32)
        made.append((np.ascontiguousarray(weight), np.zeros(after, np.float32)))
    return [*made[:-1], (LIKE_CONTROL * made[-1][0], made[-1][1])]


@dataclass(frozen=True)
class Weights:
    """Of h1 (contact), h2 (flight) and G1 (forces in contact)."""

    h1: Layers
    h2: Layers
    g1: Layers

    @staticmethod
    def of(widths: tuple[tuple[int, ...], tuple[int, ...]]) -> "Weights":
        rng = np.random.default_rng(0)
        return Weights(layers(widths[0], 3, rng), layers(widths[0], 3, rng), layers(widths[1], 12, rng))


def forward(net: Layers, x: np.ndarray) -> np.ndarray:
    """Tanh network in NumPy, (n, inputs) → (n, outputs)."""
    for weight, bias in net[:-1]:
        x = np.tanh(x @ weight.T + bias)
    return x @ net[-1][0].T + net[-1][1]


class Networks(PredictionModel):
    """Rigid body plus networks, in NumPy."""

    def __init__(self, weights: Weights) -> None:
        self.weights, self.body = weights, A1_BODY

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        x = (rows(situation) @ SELECT).astype(np.float32)
        bias, by_force = np.zeros((len(x), 3)), np.zeros((len(x), 3, 4))
        pushing = slice(None) if contact.all() else contact
        bias[pushing] = forward(self.weights.h1, x[pushing])
        by_force[pushing] = forward(self.weights.g1, x[pushing]).reshape(-1, 3, 4) * LIKE_CONTROL
        by_force[pushing] += self.body.force_rows(situation.foot[pushing])
        if not contact.all():
            bias[~contact] = forward(self.weights.h2, x[~contact])
        bias[:, 1] -= GRAVITY
        return AffineModel(bias, by_force)


def along_plan() -> DeviationNetworks:
    """Networks of the size of the learned MPC's, three members of 64 units a mode, with random weights."""
    config = DeviationNetworksConfig()
    return initial_deviation_networks(DeviationTask((), A1_BODY), config, 1.2, np.random.default_rng(0))
