"""Known loads: masses that a log states beside its robot, as an experiment that tells causes apart may ask for.

Metadata ``load`` of a log: joint → kg at the centre of mass of the link that the joint moves. Every replay of the log
has them.
"""

from collections.abc import Mapping

import mujoco

from leapgap.effects.base import Effect
from leapgap.effects.link_payload import LinkPayload
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

LOAD = "load"
"""Key of a log's metadata."""


def known_loads(log: Log) -> tuple[Effect, ...]:
    """The loads that a log states."""
    stated: Mapping[str, float] = log.info.extra.get(LOAD, {})
    return tuple(LinkPayload(location=joint, mass_kg=float(mass)) for joint, mass in stated.items())


def put_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> None:
    """Put the loads of a log into a model that the caller owns."""
    for load in known_loads(log):
        load.change_model(model, robot)


def with_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> mujoco.MjModel:
    """A model with the loads of a log; the model itself where it states none."""
    if LOAD not in log.info.extra:
        return model
    own = model.__copy__()
    put_loads(own, log, robot)
    return own
