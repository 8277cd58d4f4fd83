"""A column map in the making: what is sure, what is guessed and what is missing, and the table as read so far."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.robot.model import Robot

SURE, GUESSED, MISSING, ABSENT, UNUSED = "sure", "guessed", "missing", "absent", "unused"
"""How a part of a map is known. Sure: evidence rules out every other reading. Missing: a question that has to be
answered before anything is imported. Absent: not in the logs, or left out of the map; an import goes on without it."""
ASKED = "?"
"""Stands for a unit that has to be stated; no import takes it."""


@dataclass
class Proposal:
    """A map in the making; it becomes options of an import when a person passes it."""

    options: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)
    """How a part of the map is known, and a sentence."""

    def say(self, kind: str, sentence: str) -> None:
        """Note how sure a part of the map is, or what it leaves out, in a sentence."""
        self.notes.append((kind, sentence))

    def put(self, part: str, ours: str, value: Any) -> None:
        """Add an entry to a part of the options."""
        self.options.setdefault(part, {})[ours] = value

    def put_units(self, columns: Iterable[str], unit: str, ours: str) -> None:
        """Add the unit of some columns, unless it is ours."""
        for column in columns if unit != ours else ():
            self.put("units", column, unit)

    def drop(self, quantity: str) -> None:
        """Take a quantity out of the map, with what was said of its columns."""
        for part in ("columns", "units", "factors", "offsets"):
            entries = self.options.get(part, {})
            for key in [key for key in entries if key.partition("/")[0] == quantity]:
                del entries[key]
        self.notes = [one for one in self.notes if not one[1].startswith((f"{quantity} is", f"{quantity} comes"))]

    def notes_of(self, kind: str) -> list[str]:
        """The sentences of one kind."""
        return [sentence for one, sentence in self.notes if one == kind]


@dataclass
class Evidence:
    """The table as read so far: values in our order of joints, in the units that were found."""

    table: Table
    robot: Robot
    stated: Mapping[str, Any] = field(default_factory=dict)
    """What the files say of themselves: ``period_s`` of the rows, ``unit`` of the positions."""
    instants: np.ndarray | None = None
    """The clock in its own unit, (rows,), and the units that it may be in, the likeliest first."""
    time_units: Sequence[str] = ()
    time: np.ndarray | None = None
    """The same in s, by the unit that was chosen."""
    time_known: str = GUESSED
    values: dict[str, np.ndarray] = field(default_factory=dict)
    """Quantity → (rows, joints), SI, as far as known."""
    order: Sequence[str] = ()
    """The robot's joints in the order of columns that name none."""
    order_words: str = ""
    their_joints: list[str] | None = None
    """What the first family calls our joints, in our order: what ``*`` stands for in their names."""
    named: set[str] = field(default_factory=set)
    """Quantities whose columns name the robot's joints."""
    unplaced: set[str] = field(default_factory=set)
    """Quantities with columns of which nobody can say which joint each is of."""
    position_unit: str = "rad"
    certainty: str = GUESSED
    """How sure that unit is: what follows from it is no surer."""
    torque_alone: bool = False
    """Whether the torques that were sent explain the measured ones, so that no joint PD acts beside them."""

    def no_surer(self, *others: str) -> str:
        """Sure where the unit of the positions and all others are, else a guess."""
        return SURE if {self.certainty, *others} == {SURE} else GUESSED
