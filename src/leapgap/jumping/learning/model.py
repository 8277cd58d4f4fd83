"""The interface of all models of the base: predict the K states of a window; and the roll-out of affine ones."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.windows import RolloutInputs, Windows
from leapgap.jumping.models.rigid_body import GRAVITY, AffineModel, PredictionModel, RigidBody, Situation, advance

OUTPUTS = 15  # bias (3), by_force (3 × 4)
PHASES = ("contact", "flight")


@dataclass(frozen=True)
class Part:
    """One summand of a phase: a ``perceptron`` or a ``kernel``."""

    kind: str
    arrays: dict[str, np.ndarray]


@dataclass(frozen=True)
class FlatPhase:
    """constant + feet · foot + Σ parts(known), a function of n moments with values (n, 15)."""

    constant: np.ndarray  # Shape (15,)
    feet: np.ndarray  # Shape (4, 15)
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


class Model(ABC):
    """Predicts windows. Stored as arrays (npz) and settings (JSON), never as a pickle."""

    kind: ClassVar[str]
    infinite: ClassVar[tuple[str, ...]] = ()
    """Last names of arrays that may be infinite; all others are finite where a model is stored or loaded."""

    @abstractmethod
    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """States at the K + 1 samples of each window, the first as given, shape (W, K + 1, 6)."""

    def arrays(self) -> dict[str, np.ndarray]:
        """The fitted arrays by name, as they are stored."""
        return {}

    def settings(self) -> dict[str, Any]:
        """What else ``from_parts`` needs, as JSON."""
        return {}

    def flatten(self) -> dict[str, FlatPhase]:
        """Its flat form by phase, for export; ``InputError`` where it does not say how forces move the base."""
        raise InputError("export", self.kind, "a residual model", "export networks, kernels or nominal bodies")

    @classmethod
    @abstractmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "Model":
        """The model of which ``arrays`` and ``settings`` are the parts."""


@dataclass(frozen=True)
class Nominal:
    """Nominal model that a residual is added to: the rigid body, each row of B(r) multiplied by a gain."""

    body: RigidBody
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)  # Gains of the vx, vz and pitch-rate rows
    curvature: float = 0.0  # Curvature of a step's positions, as in ``rigid_body.advance``

    def at(self, foot: np.ndarray) -> AffineModel:
        """Its accelerations, affine in the force, with feet (n, 4)."""
        bias = np.tile([0.0, -GRAVITY, 0.0], (len(foot), 1))
        return AffineModel(bias, self.body.force_rows(foot) * np.asarray(self.gains)[:, None])

    def flatten(self) -> tuple[np.ndarray, np.ndarray]:
        """Its constant (15,) and what it takes of each foot coordinate (4, 15): B(r) is linear in r."""

        def outputs(foot: np.ndarray) -> np.ndarray:
            terms = self.at(foot[None])
            return np.concatenate([terms.bias[0], terms.by_force[0].ravel()])

        constant = outputs(np.zeros(4))
        return constant, np.stack([outputs(unit) - constant for unit in np.eye(4)])

    def to_json(self) -> dict[str, Any]:
        """Its numbers as they are stored in a model's settings."""
        return {
            "inverse_mass_per_kg": 1 / self.body.mass_kg,  # JSON has no infinity
            "inverse_pitch_inertia_per_kgm2": 1 / self.body.pitch_inertia_kgm2,
            "gains": [float(gain) for gain in self.gains],
            "curvature": self.curvature,
        }

    @staticmethod
    def from_json(raw: dict[str, Any]) -> "Nominal":
        """The body of which ``to_json`` gave the numbers."""
        mass, inertia = (
            1 / raw[key] if raw[key] else np.inf for key in ("inverse_mass_per_kg", "inverse_pitch_inertia_per_kgm2")
        )
        return Nominal(RigidBody(mass, inertia), tuple(raw["gains"]), raw["curvature"])


class ResidualModel(Model, PredictionModel):
    """A nominal body and a residual of its velocity rows, affine in the force, so that the MPC stays a QP.

    ζ⁺ = ζ + Δt (nominal + h + G u) with h and G of the state, the feet and maybe the phase; contact and flight
    are separate (paper, residual). Positions follow the velocities with the nominal body's ``curvature``.
    """

    nominal: Nominal

    @property
    def curvature(self) -> float:  # type: ignore[override]
        """The curvature of the nominal body."""
        return self.nominal.curvature

    def residual(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """h and G at n moments of contact or flight (bool, (n,)); what is added to ``nominal``."""
        found = AffineModel(np.zeros((len(contact), 3)), np.zeros((len(contact), 3, 4)))
        for phase, mask in zip(PHASES, (contact, ~contact), strict=True):
            own = self.residual_in(phase, situation.at(mask)) if mask.any() else None
            if own is not None:
                found.bias[mask], found.by_force[mask] = own.bias, own.by_force
        return found

    def residual_in(self, phase: str, situation: Situation) -> AffineModel | None:
        """h and G at moments of one phase; None where there is no residual."""
        return None

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """Nominal and residual together, n moments in one batch: what the roll-out and the MPC use."""
        nominal, residual = self.nominal.at(situation.foot), self.residual(situation, contact)
        return AffineModel(nominal.bias + residual.bias, nominal.by_force + residual.by_force)

    def flatten(self) -> dict[str, FlatPhase]:
        """The flat form of nominal body and residual, by phase."""
        flat = {}
        for phase in PHASES:
            constant, feet = self.nominal.flatten()
            mean, parts = self.flat_residual(phase)
            constant[:3] += mean
            flat[phase] = FlatPhase(constant, feet, parts)
        return flat

    def flat_residual(self, phase: str) -> tuple[np.ndarray, tuple[Part, ...]]:
        """The residual's constant acceleration (3,) and its parts in one phase, for export."""
        raise InputError(
            "export", self.kind, "networks, kernels or nominal bodies", "give its class a method flat_residual"
        )

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """Roll the K steps out from the measured first state."""
        states = [inputs.state]
        for k in range(inputs.force.shape[1]):
            situation = Situation(states[-1], inputs.foot[:, k], inputs.time_s[:, k], inputs.state)
            acceleration = self.affine(situation, inputs.contact[:, k]).acceleration(inputs.force[:, k])
            states.append(advance(states[-1], acceleration, inputs.step_s[:, k], self.curvature))
        return np.stack(states, axis=1)


def squared_errors(predicted: np.ndarray, windows: Windows) -> np.ndarray:
    """Squared error of every window, step 1…K and state component, shape (W, K, 6).

    x counts from the window's start on both sides, and z starts alike, so offsets cancel.
    """
    return (predicted[:, 1:] - windows.state[:, 1:]) ** 2
