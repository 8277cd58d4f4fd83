"""Residual networks read without torch: h1, G1 in contact and h2 in flight, in NumPy, ensembles in one batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import OUTPUTS, Nominal, Part, ResidualModel
from leapgap.jumping.learning.model_files import arrays_below
from leapgap.jumping.learning.windows import RolloutInputs, drop_forces
from leapgap.jumping.models.rigid_body import AffineModel, Situation, columns, selection

NETWORKS = ("contact/h", "contact/G", "flight/h")  # h1, G1 and h2 of the paper


@dataclass(frozen=True)
class Mlp:
    """A multilayer perceptron with tanh between its layers; S of them, side by side."""

    weights: tuple[np.ndarray, ...]  # Each (S, in, out)
    biases: tuple[np.ndarray, ...]  # Each (S, 1, out)

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Its arrays, as ``<name>/weight_0`` and ``<name>/bias_0``."""
        kinds = {"weight": self.weights, "bias": self.biases}
        return {f"{name}/{kind}_{i}": one for kind, layers in kinds.items() for i, one in enumerate(layers)}

    @staticmethod
    def of(arrays: Mapping[str, np.ndarray]) -> "Mlp":
        """The perceptron of stored arrays ``weight_0``, ``bias_0`` and so on."""
        layers = range(len(arrays) // 2)
        return Mlp(*(tuple(arrays[f"{kind}_{i}"] for i in layers) for kind in ("weight", "bias")))

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """(n, f) → (S, n, outputs)."""
        hidden = np.broadcast_to(inputs, (len(self.weights[0]), *inputs.shape))
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = np.tanh(hidden @ weight + bias)
        return hidden @ self.weights[-1] + self.biases[-1]


@dataclass(frozen=True)
class Scaling:
    """Units of a phase's networks: what their inputs are divided by, their outputs multiplied with."""

    input_mean: np.ndarray  # Taken off the raw inputs, (f,)
    input_scale: np.ndarray  # Divides the inputs after their mean is taken off, (f,)
    force_mean: np.ndarray  # (4,), N: the force at which h alone acts
    force_scale: np.ndarray  # (4,), N: G's outputs are per this much force
    mean: np.ndarray  # Added to h, (3,), m/s² and rad/s²
    scale: np.ndarray  # Of h and G, (3,), m/s² and rad/s²


@dataclass(frozen=True)
class NetworkModel(ResidualModel):
    """An ensemble of residual networks; its prediction rolls out the members' mean acceleration."""

    kind: ClassVar[str] = "network"
    nominal: Nominal
    names: tuple[str, ...]
    contact: Scaling
    flight: Scaling
    networks: dict[str, Mlp]  # By the names of ``NETWORKS``

    def residual_in(self, phase: str, situation: Situation) -> AffineModel | None:
        """h and G, mean of the members."""
        found = self.members(situation, phase == "contact")
        return AffineModel(found.bias.mean(axis=0), found.by_force.mean(axis=0))

    def members(self, situation: Situation, pushing: bool) -> AffineModel:
        """h (S, n, 3) and G (S, n, 3, 4) of each of the S members, at moments of one phase."""
        scaling = self.contact if pushing else self.flight
        inputs = (np.stack(columns(self.names, situation), axis=-1) - scaling.input_mean) / scaling.input_scale
        bias = self.networks["contact/h" if pushing else "flight/h"](inputs) * scaling.scale + scaling.mean
        if not pushing:
            return AffineModel(bias, np.zeros((*bias.shape, 4)))
        raw = self.networks["contact/G"](inputs)
        by_force = raw.reshape(*raw.shape[:-1], 3, 4) * scaling.scale[:, None] / scaling.force_scale
        return AffineModel(bias - by_force @ scaling.force_mean, by_force)

    def flat_residual(self, phase: str) -> tuple[np.ndarray, tuple[Part, ...]]:
        """The mean residual, and the perceptrons with all scalings folded into their weights."""
        scaling = getattr(self, phase)
        return scaling.mean, flatten_networks(self, phase, scaling)

    def arrays(self) -> dict[str, np.ndarray]:
        """Scalings and weights, as ``contact/input_mean`` and ``contact/G/weight_0``."""
        found = {
            f"{phase}/{name}": value
            for phase, part in (("contact", self.contact), ("flight", self.flight))
            for name, value in vars(part).items()
        }
        for name, network in self.networks.items():
            found |= network.arrays(name)
        return found

    def settings(self) -> dict[str, Any]:
        """Nominal body, inputs, and the form of the networks for other readers."""
        return {"nominal": self.nominal.to_json(), "inputs": list(self.names), "activation": "tanh"}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "NetworkModel":
        """The model of stored scalings and weights."""
        contact, flight = (
            Scaling(**{name: arrays[f"{phase}/{name}"] for name in Scaling.__dataclass_fields__})
            for phase in ("contact", "flight")
        )
        networks = {name: Mlp.of(arrays_below(arrays, name)) for name in NETWORKS}
        return cls(Nominal.from_json(settings["nominal"]), tuple(settings["inputs"]), contact, flight, networks)


@dataclass(frozen=True)
class NetworkForecast(NetworkModel):
    """Predicts from the first state and the phase alone; measured feet and forces are not looked at."""

    kind: ClassVar[str] = "network_forecast"

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """States from the first one and the phase; forces and feet of ``inputs`` are dropped."""
        return super().predict(drop_forces(inputs))


def flatten_networks(model: NetworkModel, phase: str, scaling: Scaling) -> tuple[Part, ...]:
    """h and G of every member; those of one hidden layer side by side as one."""
    blocks = []
    for head, outputs in output_heads(scaling, phase):
        network = model.networks[f"{phase}/{head}"]
        members = len(network.weights[0])
        for s in range(members):
            weights = [np.asarray(w[s], float) for w in network.weights]
            biases = [np.asarray(b[s, 0], float) for b in network.biases]
            biases[0] = biases[0] - scaling.input_mean / scaling.input_scale @ weights[0]
            weights[0] = selection(model.names) / scaling.input_scale @ weights[0]
            weights[-1], biases[-1] = weights[-1] @ outputs / members, biases[-1] @ outputs / members
            blocks.append((weights, biases))
    if len(blocks[0][0]) == 2:
        blocks = [join_side_by_side(blocks)]
    return tuple(
        Part(
            "perceptron",
            {f"weight_{i}": w.astype(np.float32) for i, w in enumerate(weights)}
            | {f"bias_{i}": b.astype(np.float32) for i, b in enumerate(biases)},
        )
        for weights, biases in blocks
    )


def output_heads(scaling: Scaling, phase: str) -> list[tuple[str, np.ndarray]]:
    """h (3) and, in contact, G (12), each with the matrix from its raw outputs to the fifteen numbers."""
    h = np.zeros((3, OUTPUTS))
    h[np.arange(3), np.arange(3)] = scaling.scale
    if phase == "flight":
        return [("h", h)]
    g = np.zeros((3, 4, OUTPUTS))
    for i in range(3):
        for j in range(4):
            slope = scaling.scale[i] / scaling.force_scale[j]
            g[i, j, 3 + 4 * i + j], g[i, j, i] = slope, -slope * scaling.force_mean[j]
    return [("h", h), ("G", g.reshape(12, OUTPUTS))]


Layers = tuple[list[np.ndarray], list[np.ndarray]]


def join_side_by_side(blocks: Sequence[Layers]) -> Layers:
    """Networks of one hidden layer as one wide one, whose output is their sum."""
    first, last = (np.concatenate([weights[i] for weights, _ in blocks], axis=1 - i) for i in (0, 1))
    bias = np.concatenate([biases[0] for _, biases in blocks])
    return [first, last], [bias, np.sum([biases[1] for _, biases in blocks], axis=0)]


def random_mlp(
    sizes: Sequence[int], members: int, output_gain: float, bias_spread: float, random: np.random.Generator
) -> Mlp:
    """Weights of unit gain a layer; first biases spread, so that the units bend at different inputs."""
    last = len(sizes) - 2
    weights, biases = [], []
    for layer, (inputs, outputs) in enumerate(pairwise(sizes)):
        gain = output_gain if layer == last else 1.0
        weights.append((gain / np.sqrt(inputs) * random.standard_normal((members, inputs, outputs))).astype(np.float32))
        spread = bias_spread if layer == 0 and layer != last else 0.0
        biases.append((spread * random.standard_normal((members, 1, outputs))).astype(np.float32))
    return Mlp(tuple(weights), tuple(biases))


def orthogonal_mlp(sizes: Sequence[int], gain: float, random: np.random.Generator) -> Mlp:
    """Small orthogonal weights, no biases: the published start."""
    weights = []
    for inputs, outputs in pairwise(sizes):
        tall = random.standard_normal((max(inputs, outputs), min(inputs, outputs)))
        basis, triangle = np.linalg.qr(tall)
        basis = basis * np.sign(np.diag(triangle))
        weights.append((gain * (basis if inputs >= outputs else basis.T))[None].astype(np.float32))
    return Mlp(tuple(weights), tuple(np.zeros((1, 1, outputs), np.float32) for outputs in sizes[1:]))
