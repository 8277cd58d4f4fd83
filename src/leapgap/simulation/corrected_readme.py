"""A corrected robot in words: what its folder holds, and where each effect is."""

from collections.abc import Mapping, Sequence
from typing import Any

MODEL, NOMINAL, EFFECTS = "robot.xml", "nominal.xml", "effects.json"
PARAMETERS, README = "parameters.json", "README.md"
HOLDS = {
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
    files = {name: says for name, says in HOLDS.items() if name not in missing}
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
