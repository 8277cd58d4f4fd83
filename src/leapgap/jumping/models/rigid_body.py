"""The planar single rigid body: nominal prediction model of the MPC, and the model that learned residuals correct."""

from dataclasses import dataclass

import numpy as np

from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FORCES

GRAVITY = 9.81
"""m/s²."""

X, Z, PITCH, VX, VZ, PITCH_RATE = range(6)
"""Layout of the state: position of the base in the world, m, pitch, rad, nose-down, and their rates."""
POSITION, VELOCITY = slice(0, 3), slice(3, 6)
STATE = ("x", "z", "pitch", "vx", "vz", "pitch_rate")


@dataclass(frozen=True)
class RigidBody:
    """A rigid body in the x–z plane, pushed at two points (the pairs of feet).

    An infinite inertia drops the moment of the forces.
    """

    mass_kg: float
    """Mass of the whole robot."""
    pitch_inertia_kgm2: float
    """Composite inertia of trunk and legs about the centre of mass, about y, in one pose of the legs."""

    def __post_init__(self) -> None:
        """Refuse a body without mass or inertia; infinite ones are bodies that no force moves or turns."""
        if not (self.mass_kg > 0 and self.pitch_inertia_kgm2 > 0):
            raise ValueError(f"mass_kg {self.mass_kg} and pitch_inertia_kgm2 {self.pitch_inertia_kgm2}: above 0")

    def force_rows(self, foot: np.ndarray) -> np.ndarray:
        """Accelerations (vx, vz, pitch rate) by unit pair forces, shape (…, 3, 4); the velocity rows of B.

        v̇ = Σ F / m and ω̇ = Σ (r_z F_x − r_x F_z) / J over the pairs, with pitch nose-down (paper, nominal step).
        ``foot`` (…, 4) is foot − base, front x z, rear x z, m, world axes.
        """
        foot = np.asarray(foot, dtype=float)
        rows = np.zeros((*foot.shape[:-1], 3, FORCES))
        rows[..., 0, FORCE_X] = 1 / self.mass_kg
        rows[..., 1, FORCE_Z] = 1 / self.mass_kg
        rows[..., 2, FORCE_X] = foot[..., FORCE_Z] / self.pitch_inertia_kgm2
        rows[..., 2, FORCE_Z] = -foot[..., FORCE_X] / self.pitch_inertia_kgm2
        return rows

    def acceleration(self, foot: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(v̇x, v̇z, ω̇), shape (…, 3), under ground forces on the robot, front x z, rear x z, N, (…, 4)."""
        acceleration = np.einsum("...ij,...j->...i", self.force_rows(foot), force)
        acceleration[..., 1] -= GRAVITY
        return acceleration

    def step(self, state: np.ndarray, foot: np.ndarray, force: np.ndarray, step_s: np.ndarray | float) -> np.ndarray:
        """x⁺ = (I + A Δt) x + B(r) Δt u (paper, nominal step): states (…, 6) one step of ``step_s`` (…) later."""
        return advance(state, self.acceleration(foot, force), step_s)


def advance(
    state: np.ndarray, acceleration: np.ndarray, step_s: np.ndarray | float, curvature: float = 0.0
) -> np.ndarray:
    """q⁺ = q + ζ Δt + c ζ̇ Δt², ζ⁺ = ζ + ζ̇ Δt, for states (…, 6) and accelerations (…, 3).

    ``curvature`` c: 0 is explicit Euler, as published; ½ is exact for a constant acceleration.
    """
    dt = np.asarray(step_s, dtype=float)[..., None]
    state, gained = np.asarray(state, dtype=float), dt * acceleration
    return np.concatenate(
        [state[..., POSITION] + dt * (state[..., VELOCITY] + curvature * gained), state[..., VELOCITY] + gained],
        axis=-1,
    )


PUBLISHED = RigidBody(mass_kg=12.0, pitch_inertia_kgm2=0.17)
"""Rigid body of the published training code, kept as a baseline."""
