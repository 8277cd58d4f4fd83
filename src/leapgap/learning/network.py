"""Residual networks read without torch: h1, G1 in contact and h2 in flight, in NumPy, ensembles in one batch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from leapgap.learning.model import Nominal, ResidualModel
from leapgap.recording.windows import RolloutInputs
from leapgap.robot.prediction import Affine, Situation, columns

NETWORKS = ("contact/h", "contact/G", "flight/h")
"""h1, G1 and h2 of the paper."""


@dataclass(frozen=True)
class Mlp:
    """A multilayer perceptron with tanh between its layers; S of them, side by side."""

    weights: tuple[np.ndarray, ...]
    """Each (S, in, out)."""
    biases: tuple[np.ndarray, ...]
    """Each (S, 1, out)."""

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """(n, f) → (S, n, outputs)."""
        hidden = np.broadcast_to(inputs, (len(self.weights[0]), *inputs.shape))
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = np.tanh(hidden @ weight + bias)
        return hidden @ self.weights[-1] + self.biases[-1]


@dataclass(frozen=True)
class Scaling:
    """Units of a phase's networks: what their inputs are divided by, their outputs multiplied with."""

    input_mean: np.ndarray
    """(f,)."""
    input_scale: np.ndarray
    """(f,)."""
    force_mean: np.ndarray
    """(4,), N: the force at which h alone acts."""
    force_scale: np.ndarray
    """(4,), N: G's outputs are per this much force."""
    mean: np.ndarray
    """Added to h, (3,), m/s² and rad/s²."""
    scale: np.ndarray
    """Of h and G, (3,), m/s² and rad/s²."""


@dataclass(frozen=True)
class NetworkModel(ResidualModel):
    """An ensemble of residual networks; its prediction rolls out the members' mean acceleration."""

    kind: ClassVar[str] = "network"
    nominal: Nominal
    names: tuple[str, ...]
    contact: Scaling
    flight: Scaling
    networks: dict[str, Mlp]
    """By the names of ``NETWORKS``."""

    def residual(self, situation: Situation, contact: np.ndarray) -> Affine:
        """h and G, mean of the members."""
        bias, by_force = np.zeros((len(contact), 3)), np.zeros((len(contact), 3, 4))
        for pushing, mask in ((True, contact), (False, ~contact)):
            if mask.any():
                found = self.members(situation.at(mask), pushing)
                bias[mask], by_force[mask] = found.bias.mean(axis=0), found.by_force.mean(axis=0)
        return Affine(bias, by_force)

    def members(self, situation: Situation, pushing: bool) -> Affine:
        """h (S, n, 3) and G (S, n, 3, 4) of each of the S members, at moments of one phase."""
        scaling = self.contact if pushing else self.flight
        inputs = (np.stack(columns(self.names, situation), axis=-1) - scaling.input_mean) / scaling.input_scale
        bias = self.networks["contact/h" if pushing else "flight/h"](inputs) * scaling.scale + scaling.mean
        if not pushing:
            return Affine(bias, np.zeros((*bias.shape, 4)))
        raw = self.networks["contact/G"](inputs)
        by_force = raw.reshape(*raw.shape[:-1], 3, 4) * scaling.scale[:, None] / scaling.force_scale
        return Affine(bias - by_force @ scaling.force_mean, by_force)

    def arrays(self) -> dict[str, np.ndarray]:
        """Scalings and weights, as ``contact/input_mean`` and ``contact/G/weight_0``."""
        found = {
            f"{phase}/{name}": value
            for phase, part in (("contact", self.contact), ("flight", self.flight))
            for name, value in vars(part).items()
        }
        for name, network in self.networks.items():
            found |= {f"{name}/weight_{i}": weight for i, weight in enumerate(network.weights)}
            found |= {f"{name}/bias_{i}": bias for i, bias in enumerate(network.biases)}
        return found

    def settings(self) -> dict[str, Any]:
        """Nominal body, inputs, and the form of the networks for other readers."""
        return {"nominal": self.nominal.to_json(), "inputs": list(self.names), "activation": "tanh"}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "NetworkModel":
        """Read back."""
        contact, flight = (
            Scaling(**{name: arrays[f"{phase}/{name}"] for name in Scaling.__dataclass_fields__})
            for phase in ("contact", "flight")
        )
        networks = {}
        for name in NETWORKS:
            layers = range(sum(key.startswith(f"{name}/weight_") for key in arrays))
            networks[name] = Mlp(
                tuple(arrays[f"{name}/weight_{i}"] for i in layers), tuple(arrays[f"{name}/bias_{i}"] for i in layers)
            )
        return cls(Nominal.from_json(settings["nominal"]), tuple(settings["inputs"]), contact, flight, networks)


@dataclass(frozen=True)
class NetworkForecast(NetworkModel):
    """Predicts from the first state and the phase alone; measured feet and forces are not looked at."""

    kind: ClassVar[str] = "network_forecast"

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """Roll out without forces."""
        return super().predict(replace(inputs, force=np.zeros_like(inputs.force), foot=np.zeros_like(inputs.foot)))


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
