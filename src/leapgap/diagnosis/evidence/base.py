"""What evidence is: numbers of the robot that follow from the logs by kinematics alone, each with its spread."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

SURE_SPREADS = 3.0  # Evidence this many standard deviations from nominal says that the model is wrong there
LEAST_LOGS = 3  # From so many logs on their scatter says how sure their median is
NORMAL_MEDIAN = 0.6745  # Median absolute value of a standard normal number
MEDIAN_LOSS = 1.2533  # Standard deviation of a median over that of a mean, for normal numbers


@dataclass(frozen=True)
class Evidence:
    """One number of the robot, or of the world, as the logs show it."""

    source: str  # Name of the source
    quantity: str  # ``<effect>.<parameter>`` where an effect sets it, else a name, such as ``gravity``
    value: float  # Of the effect's parameter: as it would be set, not its departure
    spread: float  # Standard deviation, by the scatter over logs
    unit: str
    per_log: dict[str, float]
    says: str
    held: bool = True  # Whether fits hold the value; else they start from it and are drawn towards it, by its spread


def sure(departs: np.ndarray | float, spread: np.ndarray | float) -> np.ndarray:
    """Which departures from the model are surely none of chance, bool, in the shape of the departures."""
    return np.asarray(np.abs(departs) > SURE_SPREADS * spread)


class Source(ABC):
    """One source of evidence. A subclass in a file of this package is all that a further one takes."""

    name: ClassVar[str]
    place: ClassVar[int] = 0  # Sources of higher places come later, and know what those before them told

    @abstractmethod
    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """What the logs say, all their rows; empty where columns are missing or the logs are too few to agree.

        ``before`` is what sources of lower places told.
        """


def told_model(robot: Robot, evidence: Sequence[Evidence]) -> mujoco.MjModel:
    """A copy of the robot's model with the numbers that evidence tells of its effects."""
    model, of_effects = robot.model.__copy__(), dict[str, dict[str, float]]()
    for one in evidence:
        effect, _, parameter = one.quantity.partition(".")
        if parameter:
            of_effects.setdefault(effect, {})[parameter] = one.value
    for name, numbers in of_effects.items():
        effects.known()[name](location="all", **numbers).change_model(model, robot)
    return model


def agree(values: dict[str, float]) -> tuple[float, float]:
    """Median of the logs' values, and its standard deviation by their scatter; logs far off count little."""
    of_logs = np.array(list(values.values()))
    middle = float(np.median(of_logs))
    scatter = float(np.median(np.abs(of_logs - middle))) / NORMAL_MEDIAN
    return middle, MEDIAN_LOSS * scatter / np.sqrt(len(of_logs))


def slopes(
    kind: type[Effect], robot: Robot, places: Callable[[mujoco.MjModel], np.ndarray]
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """How places depend on an effect's parameters: their names, places of the nominal robot, and derivatives.

    ``places`` computes an array of any shape from a model; the derivatives stand along a further last axis.
    """
    parameters = kind.parameters(robot, "all")
    nominal = places(robot.model)
    found = []
    for p in parameters:
        model = robot.model.__copy__()
        by = p.moderate - p.nominal
        kind(location="all", **{p.name: p.nominal + by}).change_model(model, robot)
        found.append((places(model) - nominal) / by)
    return [p.name for p in parameters], nominal, np.stack(found, axis=-1)
