"""What a wrong model explains of the torques that all logs lack: masses, inertias, friction, offsets and delays.

Torques are linear in small departures of the model. Departures are fitted robustly to all logs together, drawn towards
the model, so that a push of half a second hardly moves them. Gains of the motors are not fitted: with them, every mass
and every torque could shrink to nothing together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from leapgap.diagnosis.evidence.base import NORMAL_MEDIAN

CONSTRAINTS = ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY")
"""Parts of a model without which its inverse dynamics is smooth in the motion."""
LIGHT_KG = 1e-6  # A lighter body has no mass that could be wrong
STILL = 0.1  # A joint slower than this, rad/s or m/s, may stick: friction holds it with any torque up to its own
INDEPENDENT = 0.1  # Share of the instants that count as independent beside what is believed of the model
HUBER, BISQUARE = 1.5, 4.7
"""Limits of the robust weights, in standard deviations: Huber's in the first steps, then those of Tukey's bisquare."""
HUBER_STEPS, STEPS = 8, 20
MOST_VALUES = 8000  # About the largest number of torques that departures are fitted to
MASS, CENTRE_M, INERTIA = 0.3, 0.04, 0.6
"""Believed departures of a body's mass and inertia, as shares, and of its centre of mass, standard deviations."""
OFFSET, VISCOUS, DRY, DRAG, ARMATURE, LATE_S = 0.5, 0.5, 0.5, 0.1, 0.1, 0.015
"""Those of a joint: a constant torque, N·m; friction by speed, N·m·s/rad; dry friction, N·m; drag by the square of the
speed; inertia, kg·m²; and the delay of its torque."""
BODY_NUMBERS, JOINT_KINDS, DRY_KIND = 7, 6, 2
"""Number of departures of a body and of a joint, and which of the latter is dry friction."""


@dataclass(frozen=True)
class Instants:
    """A smoothed motion of one log at evenly spaced instants."""

    time: np.ndarray  # s, (instants,)
    qpos: np.ndarray  # (instants, nq)
    qvel: np.ndarray  # (instants, nv)
    acceleration: np.ndarray  # (instants, nv)
    torque: np.ndarray  # Of the motors, as commanded, N·m, (instants, nv)
    torque_rate: np.ndarray  # N·m/s, (instants, nv)

    def __len__(self) -> int:
        return len(self.time)


def without_constraints(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model that nothing stops: without contacts, limits, dry friction and equalities."""
    free = model.__copy__()
    for name in CONSTRAINTS:
        free.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
    return free


def inverse_dynamics(model: mujoco.MjModel, motion: Instants) -> np.ndarray:
    """Generalised forces that a motion needs, N or N·m, (instants, nv)."""
    data, found = mujoco.MjData(model), np.empty_like(motion.qvel)
    for k in range(len(motion)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.qpos[k], motion.qvel[k], motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        found[k] = data.qfrc_inverse
    return found


@dataclass(frozen=True)
class ModelErrors:
    """Torques that a model lacks in some logs, and what its departures change in them."""

    motions: tuple[Instants, ...]
    needed: tuple[np.ndarray, ...]  # Torques that each motion needs by the model, N·m, (instants, nv)
    change: np.ndarray  # By a departure of one believed standard deviation, in all logs, (instants, nv, departures)
    sticks: np.ndarray  # Index of each joint's departure of dry friction, (nv,)

    @staticmethod
    def of(model: mujoco.MjModel, motions: Sequence[Instants]) -> "ModelErrors":
        """Torques and departures of some motions."""
        needed = tuple(inverse_dynamics(model, motion) for motion in motions)
        change = np.concatenate([changes_of(model, *one) for one in zip(motions, needed, strict=True)])
        first = change.shape[2] - JOINT_KINDS * model.nv + DRY_KIND * model.nv
        return ModelErrors(tuple(motions), needed, change, first + np.arange(model.nv))

    def unexplained(self, quiet: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
        """Torques of each log, (instants, nv), that no departure of the model explains, and dry friction, (nv,).

        Departures are fitted to the ``quiet`` instants, bool, (instants,) of each log. Where a joint stands still, what
        friction may hold is explained too.
        """
        lacking = np.concatenate([own - motion.torque for own, motion in zip(self.needed, self.motions, strict=True)])
        spread = np.maximum(np.median(np.abs(lacking), axis=0), 1e-9)
        fitted = np.flatnonzero(np.concatenate(list(quiet)))
        fitted = fitted[:: max(1, len(fitted) * lacking.shape[1] // MOST_VALUES)]
        flat = (self.change[fitted] / spread[:, None]).reshape(-1, self.change.shape[2])
        departures = fit(flat, (lacking[fitted] / spread).ravel())
        left = lacking - self.change @ departures
        friction = np.abs(DRY * departures[self.sticks])
        moving = np.abs(np.tanh(np.concatenate([motion.qvel for motion in self.motions]) / STILL))
        left = np.sign(left) * np.maximum(np.abs(left) - friction * (1 - moving), 0.0)
        return np.split(left, np.cumsum([len(motion) for motion in self.motions])[:-1]), friction


def fit(change: np.ndarray, lacking: np.ndarray) -> np.ndarray:
    """Departures in believed standard deviations that explain most values, (departures,), by robust weights.

    ``change`` (values, departures) and ``lacking`` (values,) are in the same unit.
    """
    weights, prior = np.ones(len(lacking)), np.eye(change.shape[1])
    spread = spread_of(lacking)
    found = np.zeros(change.shape[1])
    for step in range(STEPS):
        weighted = change * (weights * INDEPENDENT / spread**2)[:, None]
        found = np.linalg.solve(weighted.T @ change + prior, weighted.T @ lacking)
        left = lacking - change @ found
        spread = spread_of(left)
        size = np.abs(left) / spread
        huber = 1 / np.maximum(size / HUBER, 1.0)
        weights = huber if step < HUBER_STEPS else np.where(size < BISQUARE, (1 - (size / BISQUARE) ** 2) ** 2, 0.0)
    return found


def spread_of(values: np.ndarray) -> float:
    """Standard deviation of most values, by their median size."""
    return max(float(np.median(np.abs(values))) / NORMAL_MEDIAN, 1e-6)


def changes_of(model: mujoco.MjModel, motion: Instants, needed: np.ndarray) -> np.ndarray:
    """What all departures change in the torques of a motion, (instants, nv, departures); those of bodies come first.

    ``needed`` are the torques by the model itself.
    """
    bodies = [inverse_dynamics(other, motion) - needed for other in changed_bodies(model)]
    kinds = (
        OFFSET * np.ones_like(motion.qvel),
        VISCOUS * motion.qvel,
        DRY * np.tanh(motion.qvel / STILL),
        DRAG * motion.qvel * np.abs(motion.qvel),
        ARMATURE * motion.acceleration,
        LATE_S * motion.torque_rate,
    )
    joints = [np.eye(model.nv)[j] * kind[:, j : j + 1] for kind in kinds for j in range(model.nv)]
    return np.stack([*bodies, *joints], axis=2)


def changed_bodies(model: mujoco.MjModel) -> Iterator[mujoco.MjModel]:
    """The model with one number of one body after another changed by a believed standard deviation, in one copy."""
    other, data = model.__copy__(), mujoco.MjData(model)
    for body in heavy_bodies(model):
        changes: list[tuple[str, Any, float, float]] = [("body_mass", body, 1 + MASS, 0.0)]
        for axis in range(3):
            at = body, axis
            changes += [("body_ipos", at, 1.0, CENTRE_M), ("body_inertia", at, 1 + INERTIA, 0.0)]
        for name, at, factor, added in changes:
            values, before = getattr(other, name), getattr(model, name)[at]
            values[at] = factor * before + added
            mujoco.mj_setConst(other, data)
            yield other
            values[at] = before


def heavy_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies with a mass that hang on a joint."""
    return [b for b in range(1, model.nbody) if model.body_mass[b] >= LIGHT_KG and model.body_weldid[b] != 0]
