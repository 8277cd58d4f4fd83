"""The flat form of a residual model, in which it is exported: sums of perceptrons and kernels, by phase.

The fifteen numbers of an ``Affine`` are constant + feet · foot + Σ parts(known) in each phase. Scalings, the mean of
an ensemble and the nominal body are folded into the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    """constant + feet · foot + Σ parts(known), a function of n moments with values (n, 15)."""

    constant: np.ndarray
    """Shape (15,)."""
    feet: np.ndarray
    """Shape (4, 15)."""
    parts: tuple[Part, ...]


def average_flat_models(members: Sequence[dict[str, FlatPhase]]) -> dict[str, FlatPhase]:
    """The flat form of the mean of several models."""
    share = 1 / len(members)
    return {
        phase: FlatPhase(
            np.mean([member[phase].constant for member in members], axis=0),
            np.mean([member[phase].feet for member in members], axis=0),
            tuple(scale_part(part, share) for m in members for part in m[phase].parts),
        )
        for phase in PHASES
    }


def scale_part(part: Part, share: float) -> Part:
    """The part whose outputs are ``share`` times those of ``part``."""
    last = len(part.arrays) // 2 - 1
    outputs = ("coefficients",) if part.kind == "kernel" else (f"weight_{last}", f"bias_{last}")
    return Part(part.kind, {name: a * share if name in outputs else a for name, a in part.arrays.items()})
