"""Known loads: masses that a log states beside its robot, as an experiment that tells causes apart may ask for.

Metadata ``load`` of a log: joint → kg at the centre of mass that the model has for the link that the joint moves. Every
replay of the log has them. What is wrong with a link does not scale or move a load.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from leapgap.effects.base import recompute_constants
from leapgap.effects.links import links_at
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

LOAD = "load"
"""Key of a log's metadata."""


def put_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> None:
    """Put the loads of a log into a model that the caller owns and that has all effects already."""
    stated: Mapping[str, float] = log.info.extra.get(LOAD, {})
    for joint, mass in stated.items():
        for link in links_at(robot, joint):
            add_point_mass(model, int(link), float(mass), robot.model.body_ipos[link])
    if stated:
        recompute_constants(model)


def add_point_mass(model: mujoco.MjModel, body: int, mass: float, at: np.ndarray) -> None:
    """Add a point mass, kg, at a place in the axes of a body, m, (3,)."""
    own = float(model.body_mass[body])
    away = at - model.body_ipos[body]
    model.body_mass[body] = own + mass
    if mass == 0 or not away.any():
        return
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turn, reduced = axes.reshape(3, 3), own * mass / (own + mass)
    further = reduced * (away @ away * np.eye(3) - np.outer(away, away))
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T + further
    values, vectors = np.linalg.eigh(inertia)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    model.body_inertia[body] = values
    mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(vectors).ravel())
    model.body_ipos[body] += away * mass / (own + mass)
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)


def with_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> mujoco.MjModel:
    """A model with the loads of a log; the model itself where it states none."""
    if LOAD not in log.info.extra:
        return model
    own = model.__copy__()
    put_loads(own, log, robot)
    return own
