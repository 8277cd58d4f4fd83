"""A corrected robot on disk: a plain MJCF for any simulator, and the nominal model with the effects to add to it.

``robot.xml`` is the corrected robot as far as a model can hold it, and ``README.md`` says of each effect where it is.
``nominal.xml`` with ``effects.json`` is the whole correction, which ``read_corrected`` reads.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.mjcf import write_mjcf
from leapgap.robot.model import Robot
from leapgap.robot.motors import MotorConstants
from leapgap.robot.topology import PartNames
from leapgap.runtime.atomic_io import read_json, write_json, write_text
from leapgap.runtime.typed_values import from_mapping
from leapgap.simulation.corrected_model import corrected_spec
from leapgap.simulation.corrected_readme import EFFECTS, MODEL, NOMINAL, PARAMETERS, README, readme
from leapgap.simulation.corrected_values import parameters


@dataclass(frozen=True)
class WrittenRobot:
    """What was written of a corrected robot."""

    found: Mapping[str, Any]
    """As in ``parameters.json``."""
    missing: Mapping[str, str]
    """Model files that MuJoCo could not save, with the reason."""

    @property
    def replayable(self) -> bool:
        """Whether leapgap takes the folder as a robot."""
        return NOMINAL not in self.missing


def write_corrected(folder: Path, robot: Robot, correction: tuple[Effect, ...]) -> WrittenRobot:
    """Write the corrected model, its numbers, and the nominal model beside the effects to add to it."""
    folder.mkdir(parents=True, exist_ok=True)
    spec, placed = corrected_spec(robot, correction)
    nominal = robot.published_spec() if robot.states_actuators else robot.spec()
    missing = {name: why for name, of in {MODEL: spec, NOMINAL: nominal}.items() if (why := saved(of, folder / name))}
    write_json(folder / EFFECTS, {"effects": effects.to_config(correction), **settings_of(robot)})
    found = parameters(robot, placed)
    write_json(folder / PARAMETERS, found)
    write_text(folder / README, readme(folder.name, found, missing))
    return WrittenRobot(found, missing)


def saved(spec: mujoco.MjSpec, path: Path) -> str:
    """Write a model; where MuJoCo cannot save it, why, and nothing is written."""
    try:
        write_mjcf(spec, path)
    except InputError as error:
        path.unlink(missing_ok=True)
        return str(error)
    return ""


def settings_of(robot: Robot) -> dict[str, Any]:
    """How the robot was loaded beyond its model file, as JSON."""
    stated: dict[str, Any] = {}
    if robot.stated_motors is not None:
        stated["motors"] = asdict(robot.stated_motors)
    if robot.names is not None:
        stated["names"] = asdict(robot.names)
    return stated


def corrected_in(folder: Path) -> Path:
    """The folder ``corrected`` of a report; the folder itself where it is one."""
    return folder if (folder / EFFECTS).is_file() else folder / "corrected"


def read_corrected(folder: Path | str, own: Sequence[type[Effect]] = ()) -> tuple[Robot, tuple[Effect, ...]]:
    """Nominal model and effects of a folder ``corrected``; ``own`` are the user's classes among the effects."""
    folder = Path(folder)
    stated: Mapping[str, Any] = read_json(folder / EFFECTS)
    entries = stated.get("effects")
    if not isinstance(entries, list):
        raise InputError(folder / EFFECTS, "no list of effects", "the key effects", "write it as a diagnosis does")
    where = folder / EFFECTS
    motors = from_mapping(MotorConstants, stated["motors"], f"{where}, motors") if "motors" in stated else None
    names = from_mapping(PartNames, stated["names"], f"{where}, names") if "names" in stated else None
    if not (folder / NOMINAL).is_file():
        do = f"{README} beside it says why; replay the robot's own file with --effect"
        raise InputError(folder, f"no {NOMINAL}", "the nominal robot beside its effects", do)
    robot = Robot.load(folder / NOMINAL, motors, names)
    return robot, effects.from_config(entries, effects.registry(own))
