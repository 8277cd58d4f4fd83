"""Trained models as the MPC evaluates them: with NumPy only, a few matrix products an update.

``learning.export`` writes them with every scaling folded in. In each phase the fifteen numbers of an ``AffineModel``
(bias, then by_force row by row) are

    constant + feet · foot + Σ parts(known),        known = ``prediction.rows``, (n, 17)

where a part is a perceptron (an ensemble of one hidden layer is one wide one) or a kernel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.jumping.control.compiler import compiled
from leapgap.jumping.learning.model_files import arrays_below, read_model
from leapgap.jumping.learning.windows import Purpose
from leapgap.jumping.models.rigid_body import (
    KNOWN,
    KNOWN_FOOT,
    AffineModel,
    PredictionModel,
    RigidBodyModel,
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


FirstStep = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""From state (6,), foot − base (4,) and time, s, to bias, then by_force row by row, (15,)."""
IN_CONTACT = np.array([True])
ONE = np.ones(1)


def first_step(model: PredictionModel) -> FirstStep:
    """The model in contact; compiled where it is a rigid body or a sum of perceptrons, else the model itself."""
    if isinstance(model, RigidBodyModel):
        rest, gain = (model.body.force_rows(foot).ravel() for foot in (np.zeros(4), np.eye(4)))
        by_foot = gain.reshape(4, -1) - rest
        bias = model.affine(Situation(ONE, np.zeros((1, 4)), ONE, ONE), IN_CONTACT).bias[0]
        return CompiledSum.of(np.concatenate([bias, rest]), np.pad(by_foot, [(0, 0), (3, 0)]), ())
    return learned_first_step(model) if isinstance(model, ExportedModel) else Uncompiled(model)


@lru_cache(maxsize=2)
def learned_first_step(model: ExportedModel) -> FirstStep:
    """The same of a trained model. The controllers of successive jumps share it: copies of its weights would not be in
    the processor's cache at the first update of each jump, which then took three times as long."""
    parts = tuple(part for part in model.contact.parts if isinstance(part, Perceptron))
    if len(parts) < len(model.contact.parts):
        return Uncompiled(model)
    return CompiledSum.of(model.contact.constant, model.contact.feet, parts)


@dataclass(frozen=True)
class Uncompiled:
    """Any other model, asked as it is."""

    model: PredictionModel

    def __call__(self, state: np.ndarray, foot: np.ndarray, time_s: float) -> np.ndarray:
        """Bias, then what each force adds, of the first step from a state and foot positions at a time, in a row."""
        said = self.model.affine(Situation(state[None], foot[None], np.array([time_s]), state[None]), IN_CONTACT)
        return np.concatenate([said.bias[0], said.by_force[0].ravel()])


WIDE = 1 << 16  # A layer of so many weights is read from 16-bit integers: reading is what its time is spent on
FULL_SCALE = 32767.0


@dataclass(frozen=True)
class CompiledSum:
    """constant + feet · foot + Σ perceptrons, with all layers one after another."""

    constant: np.ndarray
    feet: np.ndarray
    sizes: np.ndarray  # Inputs and outputs of each layer, whether its perceptron's last, whether wide, int, (layers, 4)
    numbers: np.ndarray  # Weights (in, out) and bias of each layer, float32; of a wide one scales of its outputs
    wide: np.ndarray  # Weights of wide layers, (in, out), in units of the scale of their output, int16

    @staticmethod
    def of(constant: np.ndarray, feet: np.ndarray, parts: tuple[Perceptron, ...]) -> "CompiledSum":
        """From the parts of a ``Phase``."""
        sizes, numbers, wide = [], [np.zeros(0, np.float32)], [np.zeros(0, np.int16)]
        for part in parts:
            for i, (weight, bias) in enumerate(part.layers):
                sizes.append((*weight.shape, i == len(part.layers) - 1, weight.size >= WIDE))
                if weight.size >= WIDE:
                    scale = np.maximum(np.abs(weight).max(axis=0), np.finfo(np.float32).tiny) / np.float32(FULL_SCALE)
                    wide.append(np.rint(weight / scale).astype(np.int16).ravel())
                    weight = scale
                numbers += [weight.ravel(), bias]
        table = np.array(sizes, np.int64).reshape(-1, 4)
        constant, feet = np.ascontiguousarray(constant, float), np.ascontiguousarray(feet, float)
        return CompiledSum(constant, feet, table, np.concatenate(numbers), np.concatenate(wide))

    def __call__(self, state: np.ndarray, foot: np.ndarray, time_s: float) -> np.ndarray:
        """The same numbers, by one call of compiled code."""
        found: np.ndarray
        found = add_up(state, foot, time_s, self.constant, self.feet, self.sizes, self.numbers, self.wide)
        return found


SMALL = np.float32(4.5)  # tanh(2 · 4.5) is 1 in single precision
HALF, TWO, ONE_32 = np.float32(0.5), np.float32(2.0), np.float32(1.0)
UP = tuple(np.float32(c) for c in (135135.0, 17325.0, 378.0))
DOWN = tuple(np.float32(c) for c in (135135.0, 62370.0, 3150.0, 28.0))


@compiled
def squash(values):  # type: ignore[no-untyped-def]
    """tanh of single-precision numbers, in place: Lambert's continued fraction at a quarter, doubled twice.

    Loops over it run on many numbers at once, which the library's tanh does not. The error is below 3e-7.
    """
    for i in range(len(values)):
        quarter = min(max(values[i] * HALF, -SMALL), SMALL) * HALF
        s = quarter * quarter
        t = quarter * (UP[0] + s * (UP[1] + s * (UP[2] + s)))
        t /= DOWN[0] + s * (DOWN[1] + s * (DOWN[2] + s * DOWN[3]))
        t = TWO * t / (ONE_32 + t * t)
        values[i] = TWO * t / (ONE_32 + t * t)


@compiled
def wide_product(hidden, weights):  # type: ignore[no-untyped-def]
    """hidden · weights for integer weights (in, out); four rows at a time, so that sums are read and written less."""
    total, inputs = np.zeros(weights.shape[1], np.float32), len(hidden)
    for i in range(0, inputs - 3, 4):
        a, b, c, d = hidden[i], hidden[i + 1], hidden[i + 2], hidden[i + 3]
        for j in range(len(total)):
            first = a * np.float32(weights[i, j]) + b * np.float32(weights[i + 1, j])
            total[j] += first + c * np.float32(weights[i + 2, j]) + d * np.float32(weights[i + 3, j])
    for i in range(inputs - inputs % 4, inputs):
        for j in range(len(total)):
            total[j] += hidden[i] * np.float32(weights[i, j])
    return total


@compiled
def add_up(state, foot, time_s, constant, feet, sizes, numbers, wide):  # type: ignore[no-untyped-def]
    """A ``CompiledSum`` at one moment; the state is also the one at which the prediction begins."""
    known = np.empty(17, np.float32)
    for i in range(6):
        known[i], known[6 + i] = state[i], state[i]
    known[0], known[6], known[16] = 0.0, 0.0, time_s
    total = constant.copy()
    for i in range(4):
        known[12 + i] = foot[i]
        for j in range(15):
            total[j] += foot[i] * feet[i, j]
    hidden, at, at_wide = known, 0, 0
    for layer in range(len(sizes)):
        inputs, outputs, last, is_wide = sizes[layer]
        if is_wide:
            weights = wide[at_wide : at_wide + inputs * outputs].reshape(inputs, outputs)
            hidden = wide_product(hidden, weights) * numbers[at : at + outputs]
            at_wide += inputs * outputs
            at += outputs
        else:
            hidden = hidden @ numbers[at : at + inputs * outputs].reshape(inputs, outputs)
            at += inputs * outputs
        hidden = hidden + numbers[at : at + outputs]
        at += outputs
        if last:
            total += hidden
            hidden = known
        else:
            squash(hidden)
    return total


assert OUTPUTS == 15
