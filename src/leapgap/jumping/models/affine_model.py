"""Interface of prediction models: their inputs, and accelerations of the base that are affine in the force.

Learning fits such models and the MPC predicts with them; both depend on this interface only.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.pair_force import FRONT_X, FRONT_Z, REAR_X, REAR_Z


@dataclass(frozen=True)
class Situation:
    """Inputs of a model at n moments; NumPy arrays or torch tensors, with any leading shape in place of n."""

    state: Any  # x z pitch and rates, m, rad, s, world, (n, 6)
    foot: Any  # Foot − base, front x z, rear x z, m, world axes, (n, 4)
    time_s: Any  # Time since the start of the jump, (n,)
    start: Any  # State at the beginning of the prediction, (n, 6); positions are inputs relative to it

    def at(self, which: Any) -> "Situation":
        """The moments that a mask or slice of the first axis selects."""
        return Situation(self.state[which], self.foot[which], self.time_s[which], self.start[which])


@dataclass(frozen=True)
class AffineModel:
    """Accelerations affine in the force, and maybe in the state: (v̇x, v̇z, ω̇) = bias + by_force u + by_state x.

    At n moments.
    """

    bias: np.ndarray  # (n, 3), m/s² and rad/s²
    by_force: np.ndarray  # (n, 3, 4), per N of front x z, rear x z
    by_state: np.ndarray | None = None  # (n, 3, 6), per unit of the state; None where not linearised there

    def at(self, which: Any) -> "AffineModel":
        """The moments that a mask or slice selects."""
        return AffineModel(
            self.bias[which], self.by_force[which], None if self.by_state is None else self.by_state[which]
        )

    def acceleration(self, force: np.ndarray) -> np.ndarray:
        """Accelerations, (n, 3), under forces (n, 4), of a model without ``by_state``."""
        return self.bias + np.einsum("nij,nj->ni", self.by_force, force)

    def seen_from(self, state: np.ndarray) -> "AffineModel":
        """The same at known states (n, 6): without ``by_state``."""
        if self.by_state is None:
            return self
        return AffineModel(self.bias + np.einsum("nij,nj->ni", self.by_state, state), self.by_force)


class PredictionModel(ABC):
    """Accelerations of the base in contact and flight: ζ⁺ = ζ + Δt (bias + by_force u) (paper, residual)."""

    curvature: float = 0.0  # Curvature c of a step's positions, as in ``rigid_body.advance``

    @abstractmethod
    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """The model at n moments, in one batch; ``contact`` (bool, (n,)) is true in contact and false in flight."""


FEATURES: dict[str, Callable[[Situation], Any]] = {
    "x_from_start": lambda s: s.state[..., 0] - s.start[..., 0],
    "z_from_start": lambda s: s.state[..., 1] - s.start[..., 1],
    "z": lambda s: s.state[..., 1],
    "pitch": lambda s: s.state[..., 2],
    "vx": lambda s: s.state[..., 3],
    "vz": lambda s: s.state[..., 4],
    "pitch_rate": lambda s: s.state[..., 5],
    "front_foot_x": lambda s: s.foot[..., FRONT_X],
    "front_foot_z": lambda s: s.foot[..., FRONT_Z],
    "rear_foot_x": lambda s: s.foot[..., REAR_X],
    "rear_foot_z": lambda s: s.foot[..., REAR_Z],
    "phase": lambda s: s.time_s,
}
"""Input features by name; a model with ``phase`` is valid for one contact schedule only."""


def columns(names: Sequence[str], situation: Situation) -> list[Any]:
    """The named inputs, each of the leading shape; stack them along a last axis."""
    return [FEATURES[name](situation) for name in names]


KNOWN = 17  # Numbers of a situation as one row: state, start, foot, time; x counts from the start, hence a 0
KNOWN_FOOT = slice(12, 16)  # Columns of foot − base in such a row


def rows(situation: Situation) -> np.ndarray:
    """Situations as rows of ``KNOWN`` numbers, (n, 17)."""
    known = np.concatenate(
        [situation.state, situation.start, situation.foot, np.asarray(situation.time_s)[..., None]], axis=-1
    )
    known[..., 0] -= known[..., 6]
    known[..., 6] = 0.0
    return known


def selection(names: Sequence[str]) -> np.ndarray:
    """The named inputs, all linear, as a matrix: inputs = rows @ selection, shape (17, inputs)."""
    unit = np.eye(KNOWN)
    return np.stack(columns(names, Situation(unit[:, :6], unit[:, KNOWN_FOOT], unit[:, 16], unit[:, 6:12])), axis=-1)


def check_names(names: Sequence[str], where: str) -> None:
    """Raise an ``InputError`` where there is no name, or one that is not in ``FEATURES``."""
    unknown = [name for name in names if name not in FEATURES]
    if unknown or not names:
        found = f"inputs {', '.join(unknown) or 'none'}"
        raise InputError(where, found, f"some of {', '.join(FEATURES)}", "correct them in conf/train")
