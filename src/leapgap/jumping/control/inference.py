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

from leapgap.jumping.learning.model import OUTPUTS, PHASES, FlatPhase, Part
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
FEET, STATES = 4, 6  # Front and rear foot, x and z; numbers of a state


def perceptron(arrays: Mapping[str, np.ndarray], known: np.ndarray) -> np.ndarray:
    """tanh between the layers ``weight_0``, ``bias_0``, ``weight_1`` and so on; single precision, as it was trained."""
    hidden, last = known.astype(np.float32), len(arrays) // 2 - 1
    for i in range(last):
        hidden = hidden @ arrays[f"weight_{i}"]
        hidden += arrays[f"bias_{i}"]
        np.tanh(hidden, out=hidden)
    return hidden @ arrays[f"weight_{last}"] + arrays[f"bias_{last}"]


def kernel(arrays: Mapping[str, np.ndarray], known: np.ndarray) -> np.ndarray:
    """Σ exp(−‖s − centre‖²/2) coefficients, with s = known · ``select`` − ``shift``."""
    at, centres = known @ arrays["select"] - arrays["shift"], arrays["centres"]
    squared = (at**2).sum(axis=1)[:, None] + (centres**2).sum(axis=1) - 2 * at @ centres.T
    return np.exp(-np.maximum(squared, 0) / 2) @ arrays["coefficients"]


PARTS: dict[str, Callable[[Mapping[str, np.ndarray], np.ndarray], np.ndarray]]
PARTS = {"perceptron": perceptron, "kernel": kernel}  # From arrays and known inputs (n, 17) to summands (n, 15)


def outputs(phase: FlatPhase, known: np.ndarray) -> np.ndarray:
    """Outputs (n, 15) of the known inputs (n, 17)."""
    found: np.ndarray = phase.constant + known[:, KNOWN_FOOT] @ phase.feet
    for part in phase.parts:
        found += PARTS[part.kind](part.arrays, known)
    return found


@dataclass(frozen=True, eq=False)
class ExportedModel(PredictionModel):
    """A trained model, for one time grid, schedule and robot; two of them are equal where they are one object."""

    name: str
    purpose: Purpose
    contact: FlatPhase
    flight: FlatPhase
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
                found = outputs(phase, known)
            elif mask.any():
                found[mask] = outputs(phase, known[mask])
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


def read_phase(arrays: Mapping[str, np.ndarray], kinds: list[str]) -> FlatPhase:
    """A phase from its arrays: constant, feet, and the parts ``0/…``, ``1/…``, whose kinds are given in order."""
    for key, shape in (("constant", (OUTPUTS,)), ("feet", (FEET, OUTPUTS))):
        if arrays[key].shape != shape:
            raise ValueError(f"{key} of shape {arrays[key].shape}, not {shape}")
    parts = tuple(Part(kind, arrays_below(arrays, str(i))) for i, kind in enumerate(kinds))
    for number, part in enumerate(parts):  # what does not fit fails here, or gives something else than (n, 15)
        if (found := PARTS[part.kind](part.arrays, np.zeros((2, KNOWN))).shape) != (2, OUTPUTS):
            raise ValueError(f"outputs of part {number} of shape {found}, not (2, {OUTPUTS})")
    return FlatPhase(arrays["constant"], arrays["feet"], parts)
