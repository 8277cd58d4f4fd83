"""A column map in the making: what is sure, what is guessed and what is missing, and the table as read so far."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.robot.model import Robot

SURE, GUESSED, MISSING, UNUSED = "sure", "guessed", "missing", "unused"


@dataclass
class Proposal:
    """A map in the making; it becomes options of an import when a person passes it."""

    options: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)
    """``sure``, ``guessed``, ``missing`` or ``unused``, and a sentence."""

    def say(self, kind: str, sentence: str) -> None:
        """Note how sure a part of the map is, or what it leaves out, in a sentence."""
        self.notes.append((kind, sentence))

    def put(self, part: str, ours: str, value: Any) -> None:
        """Add an entry to a part of the options."""
        self.options.setdefault(part, {})[ours] = value

    def notes_of(self, kind: str) -> list[str]:
        """The sentences of one kind."""
        return [sentence for one, sentence in self.notes if one == kind]


@dataclass
class Evidence:
    """The table as read so far: values in our order of joints, in the units that were found."""

    table: Table
    robot: Robot
    time: np.ndarray | None = None
    values: dict[str, np.ndarray] = field(default_factory=dict)
    """Quantity → (rows, joints), SI, as far as known."""
    their_joints: list[str] | None = None
    """What the first family calls our joints, in our order: what ``*`` stands for in their names."""
    unplaced: set[str] = field(default_factory=set)
    """Quantities with columns of which nobody can say which joint each is of."""
    position_unit: str = "rad"
    certainty: str = GUESSED
    """How sure that unit is: what follows from it is no surer."""
    torque_alone: bool = False
    """Whether the torques that were sent explain the measured ones, so that no joint PD acts beside them."""
