"""Torques that a motion needs, by MuJoCo's inverse dynamics."""

from dataclasses import dataclass

import mujoco
import numpy as np

CONSTRAINTS = ("CONTACT", "LIMIT", "FRICTIONLOSS", "EQUALITY")
"""Parts of a model without which its inverse dynamics is smooth in the motion."""


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
