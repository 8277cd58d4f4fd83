"""Prediction models, whose accelerations of the base are affine in the force, and the planar rigid body among them.

The rigid body is the nominal model of the MPC, and what learned residuals correct. Learning fits such models and the
MPC predicts with them; both depend on their interface only.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.task import Target
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FORCES, FRONT_X, FRONT_Z, REAR_X, REAR_Z, per_axis
from leapgap.robot.model import Robot


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


GRAVITY = 9.81  # m/s²

X, Z, PITCH, VX, VZ, PITCH_RATE = range(6)  # The state: position of the base, m, pitch, rad, nose-down, and rates
POSITION, VELOCITY = slice(0, 3), slice(3, 6)
STATE = ("x", "z", "pitch", "vx", "vz", "pitch_rate")


@dataclass(frozen=True)
class RigidBody:
    """A rigid body in the x–z plane, pushed at two points (the pairs of feet).

    An infinite inertia drops the moment of the forces.
    """

    mass_kg: float  # Mass of the whole robot
    pitch_inertia_kgm2: float  # Of trunk and legs about the centre of mass, about y, in one pose of the legs

    def __post_init__(self) -> None:
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


PUBLISHED = RigidBody(mass_kg=12.0, pitch_inertia_kgm2=0.17)  # Body of the published training code, as a baseline


ROUNDING_TOLERANCE = 0.005  # Largest relative difference between figures rounded to three digits and those of the model


@dataclass(frozen=True)
class RigidBodyModel(PredictionModel):
    """Accelerations by gravity and the forces of the feet; in flight by gravity alone."""

    body: RigidBody

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """Accelerations at n moments of contact or flight (bool, (n,)), as ``PredictionModel`` defines them."""
        bias = np.tile([0.0, -GRAVITY, 0.0], (len(contact), 1))
        return AffineModel(bias, self.body.force_rows(situation.foot) * np.asarray(contact)[:, None, None])


def rigid_body_of(robot: Robot, joint_pos: np.ndarray, model: mujoco.MjModel | None = None) -> RigidBody:
    """Mass and composite pitch inertia about the centre of mass, with level trunk and joint angles (joints,), rad.

    ``model`` is the robot's own unless another one with the same bodies is given.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    data.qpos[3:7] = [1, 0, 0, 0]
    data.qpos[robot.joint_qpos] = joint_pos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    arm = data.xipos - data.subtree_com[robot.base_body]
    rotation = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", rotation[:, 1] ** 2, model.body_inertia)  # about y of the world, through its own centre
    inertia = own + model.body_mass * (arm[:, 0] ** 2 + arm[:, 2] ** 2)
    return RigidBody(float(model.body_mass.sum()), float(inertia.sum()))


def planner_body(robot: Robot, joint_pos: np.ndarray, rounded: RigidBody | None) -> RigidBody:
    """The rigid body that controllers assume: ``rounded`` where it fits this model, else the model's own.

    A ``rounded`` body that differs by more than rounding belongs to another robot and is ignored. A model file given by
    hand is therefore never controlled with the mass of the robot in the configuration.
    """
    own = rigid_body_of(robot, joint_pos)
    if rounded is None:
        return own
    here = np.array([own.mass_kg, own.pitch_inertia_kgm2])
    stated = np.array([rounded.mass_kg, rounded.pitch_inertia_kgm2])
    return rounded if (np.abs(stated / here - 1) <= ROUNDING_TOLERANCE).all() else own


CURVATURE = 0.5  # c: positions are exact where a step's acceleration is constant


@dataclass(frozen=True)
class PlannedSteps:
    """n steps of one plan."""

    time_s: np.ndarray  # Start of each, since the start of the jump, (n,)
    end_s: np.ndarray  # End of each, (n,)
    foot: np.ndarray  # Planned foot − base, front x z, rear x z, m, at the start of each, (n, 4)
    pushing: np.ndarray  # Whether the front and the rear pair are planned to push at its start, bool, (n, 2)
    target: Target
    stance_rad: float = 0.0  # Planned pitch of the trunk in the crouch at the start, nose-down: that of the ground

    def __len__(self) -> int:
        return len(self.time_s)


class DeviationModel(ABC):
    """Accelerations of the deviation from a plan."""

    body: RigidBody  # Whose B(r) is part of the model

    @abstractmethod
    def residual(self, steps: PlannedSteps) -> AffineModel:
        """h, G and C at n steps, as ``bias``, ``by_force`` and ``by_state``."""

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """All of its numbers, by name."""

    def along(self, steps: PlannedSteps) -> AffineModel:
        """h, B + G and C at n steps; forces of pairs in the air do nothing."""
        found = self.residual(steps)
        by_force = (self.body.force_rows(steps.foot) + found.by_force) * per_axis(steps.pushing)[:, None, :]
        return AffineModel(found.bias, by_force, found.by_state)


@dataclass(frozen=True)
class NominalDeviation(DeviationModel):
    """No residual: the plan is kept, and forces move a rigid body away from it."""

    body: RigidBody

    def residual(self, steps: PlannedSteps) -> AffineModel:
        """Zero h, G and C at n steps."""
        n = len(steps)
        return AffineModel(np.zeros((n, 3)), np.zeros((n, 3, 4)), np.zeros((n, 3, 6)))

    def arrays(self) -> dict[str, np.ndarray]:
        """No arrays: nothing of this model was learned."""
        return {}
