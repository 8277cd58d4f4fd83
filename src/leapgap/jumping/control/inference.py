"""Trained models as the MPC evaluates them: with NumPy only, a few matrix products an update.

``learning.export`` writes them with every scaling folded in. In each phase the fifteen numbers of an ``AffineModel``
(bias, then by_force row by row) are

    constant + feet · foot + Σ parts(known),        known = ``prediction.rows``, (n, 17)

where a part is a perceptron (an ensemble of one hidden layer is one wide one) or a kernel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.jumping.learning.model_files import arrays_below, read_model
from leapgap.jumping.learning.windows import Purpose
from leapgap.jumping.models.rigid_body import (
    KNOWN,
    KNOWN_FOOT,
    AffineModel,
    PredictionModel,
    Situation,
    rows,
)

FORMAT_VERSION = 2
OUTPUTS, FEET, STATES = 15, 4, 6  # bias (3) and by_force (3 × 4); front and rear foot, x and z; numbers of a state
PHASES = ("contact", "flight")


@dataclass(frozen=True)
class Perceptron:
    """tanh between layers; single precision, as it was trained."""

    layers: tuple[tuple[np.ndarray, np.ndarray], ...]  # Weight (in, out) and bias (out,) of each

    @staticmethod
    def of(arrays: Mapping[str, np.ndarray]) -> "Perceptron":
        """The network whose layers are stored as ``weight_0``, ``bias_0``, ``weight_1`` and so on."""
        count = sum(name.startswith("weight_") for name in arrays)
        kinds = ("weight", "bias")
        layers = [[np.ascontiguousarray(arrays[f"{kind}_{i}"], np.float32) for kind in kinds] for i in range(count)]
        return Perceptron(tuple((weight, bias) for weight, bias in layers))

    def __call__(self, known: np.ndarray) -> np.ndarray:
        """Outputs (n, 15) of the known inputs (n, 17)."""
        hidden = known.astype(np.float32)
        for weight, bias in self.layers[:-1]:
            hidden = hidden @ weight
            hidden += bias
            np.tanh(hidden, out=hidden)
        weight, bias = self.layers[-1]
        return hidden @ weight + bias


def kernel(arrays: Mapping[str, np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """Σ exp(−‖s − centre‖²/2) coefficients, with s = known · ``select`` − ``shift``."""
    select, shift, centres, coefficients = (
        np.ascontiguousarray(arrays[name]) for name in ("select", "shift", "centres", "coefficients")
    )
    squared_centres = (centres**2).sum(axis=1)

    def outputs(known: np.ndarray) -> np.ndarray:
        at = known @ select - shift
        squared = (at**2).sum(axis=1)[:, None] + squared_centres - 2 * at @ centres.T
        return np.exp(-np.maximum(squared, 0) / 2) @ coefficients

    return outputs


PARTS: dict[str, Callable[[Mapping[str, np.ndarray]], Callable[[np.ndarray], np.ndarray]]]
PARTS = {"perceptron": Perceptron.of, "kernel": kernel}


@dataclass(frozen=True)
class Phase:
    """Prediction of one phase: contact, or flight."""

    constant: np.ndarray  # (15,)
    feet: np.ndarray  # (4, 15), of foot − base, front x z, rear x z: the moments of the nominal body
    parts: tuple[Callable[[np.ndarray], np.ndarray], ...]  # Functions from known inputs (n, 17) to summands (n, 15)

    def __call__(self, known: np.ndarray) -> np.ndarray:
        """Outputs (n, 15) of the known inputs (n, 17)."""
        found = self.constant + known[:, KNOWN_FOOT] @ self.feet
        for part in self.parts:
            found += part(known)
        return found


@dataclass(frozen=True, eq=False)
class ExportedModel(PredictionModel):
    """A trained model, for one time grid, schedule and robot; two of them are equal where they are one object."""

    name: str
    purpose: Purpose
    contact: Phase
    flight: Phase
    curvature: float = 0.0
    deviation: np.ndarray | None = None
    """Standard deviations of predicted states, by the step of the jump at which the prediction starts and by the step
    predicted, (starts, K, 6), m, rad, m/s, rad/s; calibrated on training jumps left out in turn. ``None``: unknown."""

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """See ``PredictionModel``; one batch for each phase."""
        known, contact = rows(situation), np.asarray(contact, bool)
        found = np.empty((len(known), OUTPUTS))
        for phase, mask in ((self.contact, contact), (self.flight, ~contact)):
            if mask.all():
                found = phase(known)
            elif mask.any():
                found[mask] = phase(known[mask])
        return AffineModel(found[:, :3], found[:, 3:].reshape(-1, 3, 4))


def load(folder: Path, name: str, needed: Purpose) -> ExportedModel:
    """Read ``<name>.json`` and ``<name>.npz``; a model for another grid, schedule or robot is an ``InputError``."""

    def build(about: Mapping[str, Any], arrays: dict[str, np.ndarray]) -> ExportedModel:
        contact, flight = (read_phase(arrays_below(arrays, phase), about["parts"][phase]) for phase in PHASES)
        purpose, deviation = Purpose.from_json(about), arrays.get("deviation")
        if deviation is not None and (deviation.ndim != 3 or deviation.shape[1:] != (purpose.grid.steps, STATES)):
            raise ValueError(f"deviation of shape {deviation.shape}, not (starts, {purpose.grid.steps}, {STATES})")
        return ExportedModel(name, purpose, contact, flight, float(about["curvature"]), deviation)

    model = read_model(folder, name, FORMAT_VERSION, build)
    model.purpose.require(needed, folder / f"{name}.json")
    return model


def read_phase(arrays: Mapping[str, np.ndarray], kinds: list[str]) -> Phase:
    """A phase from its arrays: constant, feet, and the parts ``0/…``, ``1/…``, whose kinds are given in order."""
    for key, shape in (("constant", (OUTPUTS,)), ("feet", (FEET, OUTPUTS))):
        if arrays[key].shape != shape:
            raise ValueError(f"{key} of shape {arrays[key].shape}, not {shape}")
    parts = tuple(PARTS[kind](arrays_below(arrays, str(i))) for i, kind in enumerate(kinds))
    for number, part in enumerate(parts):  # what does not fit fails here, or gives something else than (n, 15)
        if (found := part(np.zeros((2, KNOWN))).shape) != (2, OUTPUTS):
            raise ValueError(f"outputs of part {number} of shape {found}, not (2, {OUTPUTS})")
    return Phase(arrays["constant"], arrays["feet"], parts)
