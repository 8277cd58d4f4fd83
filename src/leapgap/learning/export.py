"""Trained models for use outside of learning: NumPy arrays for ``control.exported``, and ONNX for anybody else.

Scalings, the ensemble's mean and the nominal body are folded into the weights: the fifteen numbers of an ``Affine``
are constant + feet · foot + Σ parts(known) in each phase (see ``PHASES``, ``flatten``).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.files import whole_file, write_json
from leapgap.learning.baselines import NominalModel
from leapgap.learning.ensemble import Blend
from leapgap.learning.kernel import KernelModel, KernelPart
from leapgap.learning.model import Model, Nominal, ResidualModel
from leapgap.learning.network import NetworkModel, Scaling
from leapgap.learning.store import Stored
from leapgap.recording.windows import write_npz
from leapgap.robot.prediction import KNOWN, selection

FORMAT_VERSION = 2
OUTPUTS = 15
"""bias (3), by_force (3 × 4)."""
PHASES = ("contact", "flight")


@dataclass(frozen=True)
class Part:
    """One summand of a phase: a ``perceptron`` or a ``kernel``."""

    kind: str
    arrays: dict[str, np.ndarray]


@dataclass(frozen=True)
class FlatPhase:
    """constant + feet · foot + Σ parts(known) → (n, 15)."""

    constant: np.ndarray
    feet: np.ndarray
    parts: tuple[Part, ...]


def flatten(model: Model) -> dict[str, FlatPhase]:
    """A residual model by phase."""
    if isinstance(model, Blend):
        return blended([flatten(member) for member in model.members])
    if not isinstance(model, ResidualModel):
        raise InputError("export", model.kind, "a residual model", "export networks, kernels or nominal bodies")
    phases = {}
    for phase in PHASES:
        constant, feet = nominal_terms(model.nominal)
        parts: tuple[Part, ...] = ()
        if isinstance(model, NetworkModel):
            scaling = getattr(model, phase)
            constant[:3] += scaling.mean
            parts = network_parts(model, phase, scaling)
        elif isinstance(model, KernelModel) and (part := getattr(model, phase)) is not None:
            constant[:3] += part.mean
            parts = (kernel_part(model.names, part),)
        elif not isinstance(model, KernelModel | NominalModel):
            raise InputError("export", model.kind, "networks, kernels or nominal bodies", "teach export this kind")
        phases[phase] = FlatPhase(constant, feet, parts)
    return phases


def blended(members: Sequence[dict[str, FlatPhase]]) -> dict[str, FlatPhase]:
    """The mean of several."""
    share = 1 / len(members)
    return {
        phase: FlatPhase(
            np.mean([member[phase].constant for member in members], axis=0),
            np.mean([member[phase].feet for member in members], axis=0),
            tuple(scaled(part, share) for m in members for part in m[phase].parts),
        )
        for phase in PHASES
    }


def scaled(part: Part, share: float) -> Part:
    """A part whose outputs are multiplied."""
    last = len(part.arrays) // 2 - 1
    outputs = ("coefficients",) if part.kind == "kernel" else (f"weight_{last}", f"bias_{last}")
    return Part(part.kind, {name: a * share if name in outputs else a for name, a in part.arrays.items()})


def nominal_terms(nominal: Nominal) -> tuple[np.ndarray, np.ndarray]:
    """The nominal body's constant (15,) and what it takes of each foot coordinate (4, 15): B(r) is linear in r."""

    def outputs(foot: np.ndarray) -> np.ndarray:
        found = nominal.at(foot[None])
        return np.concatenate([found.bias[0], found.by_force[0].ravel()])

    constant = outputs(np.zeros(4))
    return constant, np.stack([outputs(unit) - constant for unit in np.eye(4)])


def network_parts(model: NetworkModel, phase: str, scaling: Scaling) -> tuple[Part, ...]:
    """h and G of every member; those of one hidden layer side by side as one."""
    blocks = []
    for head, outputs in heads(scaling, phase):
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
        blocks = [side_by_side(blocks)]
    return tuple(
        Part(
            "perceptron",
            {f"weight_{i}": w.astype(np.float32) for i, w in enumerate(weights)}
            | {f"bias_{i}": b.astype(np.float32) for i, b in enumerate(biases)},
        )
        for weights, biases in blocks
    )


def heads(scaling: Scaling, phase: str) -> list[tuple[str, np.ndarray]]:
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


def side_by_side(blocks: Sequence[Layers]) -> Layers:
    """Networks of one hidden layer as one wide one, whose output is their sum."""
    first, last = (np.concatenate([weights[i] for weights, _ in blocks], axis=1 - i) for i in (0, 1))
    bias = np.concatenate([biases[0] for _, biases in blocks])
    return [first, last], [bias, np.sum([biases[1] for _, biases in blocks], axis=0)]


def kernel_part(names: tuple[str, ...], part: KernelPart) -> Part:
    """h and G as coefficients of the same similarities."""
    by_force = part.weights[:, :, None] * (part.forces / part.force_scale)[:, None, :]
    bias = part.weights - by_force @ part.force_mean
    return Part(
        "kernel",
        {
            "select": selection(names) / part.input_scale,
            "shift": part.input_mean / part.input_scale,
            "centres": part.inputs,
            "coefficients": np.concatenate([bias, by_force.reshape(len(bias), 12)], axis=1),
        },
    )


def write(stored: Stored, folder: Path, name: str, deviation: np.ndarray | None = None) -> None:
    """Write ``<name>.npz``, ``<name>.onnx`` and, last, ``<name>.json``.

    ``deviation``: of predicted states by start of the prediction and step, (starts, K, 6), where known.
    """
    phases = flatten(stored.model)
    assert isinstance(stored.model, ResidualModel)  # else flatten has refused it
    arrays = {} if deviation is None else {"deviation": deviation}
    for phase, flat in phases.items():
        arrays |= {f"{phase}/constant": flat.constant, f"{phase}/feet": flat.feet}
        for i, part in enumerate(flat.parts):
            arrays |= {f"{phase}/{i}/{key}": array for key, array in part.arrays.items()}
    about = {
        "format_version": FORMAT_VERSION,
        "model": name,
        "key": stored.key,
        "curvature": stored.model.curvature,
        "inputs": list(getattr(stored.model, "names", ())),
        "trained_on": list(stored.trained_on),
        **asdict(stored.purpose),
        "parts": {phase: [part.kind for part in flat.parts] for phase, flat in phases.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / f"{name}.npz") as beside:
        write_npz(beside, arrays)
    from leapgap.learning import onnx_graph  # onnx is imported only where it is written

    with whole_file(folder / f"{name}.onnx") as beside:
        beside.write_bytes(onnx_graph.serialised(phases, about, KNOWN))
    write_json(folder / f"{name}.json", about)
