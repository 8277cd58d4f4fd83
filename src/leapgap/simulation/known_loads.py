"""Known loads: masses that a log states beside its robot, as an experiment that tells causes apart may ask for.

Metadata ``load`` of a log: joint → kg at the centre of mass that the model has for the link that the joint moves. Every
replay of the log has them. What is wrong with a link does not scale or move a load.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from leapgap.effects.base import recompute_constants
from leapgap.effects.links import add_mass, links_at, square_to
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
    away = at - model.body_ipos[body]
    add_mass(model, body, mass, mass * away, mass * square_to(away))


def with_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> mujoco.MjModel:
    """A model with the loads of a log; the model itself where it states none."""
    if LOAD not in log.info.extra:
        return model
    own = model.__copy__()
    put_loads(own, log, robot)
    return own
