"""A corrected robot on disk: the nominal model and the effects that a diagnosis identified."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from leapgap import effects
from leapgap.atomic_io import read_json, write_json
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.model import Robot

MODEL, EFFECTS = "robot.xml", "effects.json"


def write_corrected(folder: Path, robot: Robot, correction: tuple[Effect, ...]) -> None:
    """Write the nominal model beside the effects to add to it."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(robot.path, folder / MODEL)
    write_json(folder / EFFECTS, {"effects": effects.to_config(correction)})


def read_corrected(folder: Path | str, own: Sequence[type[Effect]] = ()) -> tuple[Robot, tuple[Effect, ...]]:
    """Model and effects of a folder ``corrected``; ``own`` are the user's classes that may be among the effects."""
    folder = Path(folder)
    entries = read_json(folder / EFFECTS).get("effects")
    if not isinstance(entries, list):
        raise InputError(folder / EFFECTS, "no list of effects", "the key effects", "write it as a diagnosis does")
    return Robot.load(folder / MODEL), effects.from_config(entries, effects.registry(own))
