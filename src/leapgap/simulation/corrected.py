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
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.mjcf import write_mjcf
from leapgap.robot.model import Robot
from leapgap.robot.topology import PartNames
from leapgap.runtime.atomic_io import read_json, write_json, write_text
from leapgap.runtime.typed_values import from_mapping
from leapgap.simulation.corrected_model import corrected_spec, parameters

MODEL, NOMINAL, EFFECTS = "robot.xml", "nominal.xml", "effects.json"
PARAMETERS, README = "parameters.json", "README.md"
CORRECTED_HOLDS = {
    MODEL: "the corrected robot as a plain MJCF, for any MuJoCo",
    NOMINAL: "the nominal model",
    EFFECTS: "all effects to add to it, for leapgap",
    PARAMETERS: "every number, nominal and corrected",
    README: "where each effect is, with its numbers",
}
"""What each file holds."""


def readme(folder: str, found: Mapping[str, Any], missing: Mapping[str, str]) -> str:
    """What a folder of this name holds, how to use it, and what no model file can hold, with the numbers.

    ``missing``: model files that MuJoCo could not save, with the reason.
    """
    held = [effect for effect in found["effects"] if effect["in_model"] and MODEL not in missing]
    outside = [effect for effect in found["effects"] if effect not in held]
    files = {name: says for name, says in CORRECTED_HOLDS.items() if name not in missing}
    lines = [
        f"# {found['robot'] or 'The robot'}, corrected",
        "",
        *(f"- `{name}`: {says}." for name, says in files.items()),
        *(line for name, why in missing.items() for line in ("", f"**No `{name}`**: {why}.")),
        "",
        *uses(folder, missing),
        "## In `robot.xml`",
        "",
        *(entry_in_words(effect) for effect in held),
        *(
            []
            if held
            else ["Nothing: there is no such file." if MODEL in missing else "Nothing: the model is nominal."]
        ),
        "",
        "## Not in `robot.xml`",
        "",
        *([] if outside else ["Nothing is missing from it."]),
        *(f"{entry_in_words(effect)} {where_else(effect, missing)}" for effect in outside),
        *motor_words(found),
    ]
    return "\n".join(lines).rstrip() + "\n"


def uses(folder: str, missing: Mapping[str, str]) -> list[str]:
    """How to simulate with the folder, by the files that it has."""
    lines = []
    if MODEL not in missing:
        lines += ["With MuJoCo, in this folder:", ""]
        lines += ["```python", "import mujoco", "", f'model = mujoco.MjModel.from_xml_path("{MODEL}")', "```", ""]
    if NOMINAL not in missing:
        lines += ["With leapgap and all effects, in the folder that holds this one; `LOGS` is your folder of logs:", ""]
        lines += ["```bash", f"leapgap replay LOGS {folder} --out replays", "```", ""]
    return lines


def where_else(effect: Mapping[str, Any], missing: Mapping[str, str]) -> str:
    """Where an effect is that the model lacks, and why."""
    if MODEL in missing:
        return f"It is in `{EFFECTS}` alone."
    part = f"Only a part is in `{MODEL}`" if effect["in_model_in_part"] else f"It is in `{EFFECTS}` alone"
    return f"{part}, since {effect['lacks']}: simulate it together with the model."


def placed_in_words(found: Mapping[str, Any], missing: Sequence[str] = ()) -> list[str]:
    """A line for each effect: ``joint_damping at elbow: in robot.xml``."""
    lines = []
    for effect in found["effects"]:
        where = f"in {MODEL}" if effect["in_model"] else f"in {EFFECTS} only"
        where = f"in {MODEL} in part, all of it in {EFFECTS}" if effect["in_model_in_part"] else where
        why = effect["lacks"]
        if MODEL in missing:
            where, why = f"in {EFFECTS} only", ""
        if NOMINAL in missing and MODEL in missing:
            where = "in no model"
        lines.append(f"{effect['name']}{at_place(effect)}: {where}{f' ({why})' if why else ''}")
    return lines


def at_place(effect: Mapping[str, Any]) -> str:
    """`` at elbow``; empty for an effect at all places."""
    return "" if effect["location"] == "all" else f" at {effect['location']}"


def entry_in_words(effect: Mapping[str, Any]) -> str:
    """``- `joint_damping` at RR_calf: damping 0.4 N·m·s/rad (nominal 0). Viscous friction of the gears.``"""
    numbers = ", ".join(
        f"{name} {one['value']:.6g} {one['unit']} (nominal {one['nominal']:.6g})"
        for name, one in effect["parameters"].items()
    )
    what = effect["what"]
    return f"- `{effect['name']}`{at_place(effect)}: {numbers}. {what[:1].upper()}{what[1:]}."


def motor_words(found: Mapping[str, Any]) -> list[str]:
    """A paragraph on motors that are DC motors in the model, where there are any."""
    warm = [joint for joint, of in found["joints"].items() if of["motor_heating_per_n2m2s"]["corrected"]]
    electric = [
        joint
        for joint, of in found["joints"].items()
        if of["motor_lag_s"]["corrected"] or of["motor_voltage_v"]["corrected"] is not None or joint in warm
    ]
    if not electric:
        return []
    return [
        "",
        f"The actuators of {', '.join(electric)} are MuJoCo's DC motors (`dcmotor`, MuJoCo 4.0 or later). Other",
        "simulators have no such voltage and lag, nor has leapgap where `robot.xml` itself is its robot.",
        *(["Their temperature is the rise of their resistance, as a share of it, and begins at 0."] if warm else []),
    ]


@dataclass(frozen=True)
class WrittenRobot:
    """What was written of a corrected robot."""

    found: Mapping[str, Any]  # as in ``parameters.json``
    missing: Mapping[str, str]  # model files that MuJoCo could not save, with the reason

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
    # How the robot was loaded beyond its model file, as JSON
    stated: dict[str, Any] = {}
    if robot.stated_motors is not None:
        stated["motors"] = asdict(robot.stated_motors)
    if robot.names is not None:
        stated["names"] = asdict(robot.names)
    write_json(folder / EFFECTS, {"effects": effects.to_config(correction), **stated})
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
