"""Files beside logs that come from other people: models of robots, maps of columns, corrected robots; and their harms.

What is taken must be what plain readers find in the same bytes: MuJoCo alone, PyYAML's plain loader, JSON.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.hostile.base_logs import ARM, HOPPER
from tests.hostile.file_harms import FILE_HARMS, repeated

URDF = """<robot name="arm"><link name="base"/><link name="upper"><inertial><origin xyz="0 0 -.1"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>
<sphere radius=".05"/></geometry></collision></link><joint name="hip" type="revolute"><parent link="base"/>
<child link="upper"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20" velocity="10"/>
<dynamics damping=".1" friction=".1"/></joint></robot>"""
OPTIONS: dict[str, Any] = {
    "columns": {"joint_pos/*": "q_*", "cmd_tau/*": {"sent_*": 1, "friction_*": -1}},
    "units": {"joint_pos/*": "deg", "time": "ms"},
    "factors": {"joint_pos/*": [1, -1]},
    "constants": {"cmd_kp/*": 40.5},
    "joint_order": ["hip", "knee"],
    "pieces": [{"name": "first", "begin_s": 0.5, "end_s": 1.5}],
    "period_s": 0.01,
    "repeated_times": "drop",
    "least_rows": 5,
}
EFFECTS = {
    "effects": [
        {"name": "joint_damping", "location": "hip", "damping": 0.4},
        {"name": "command_delay", "location": "all", "delay": 0.004},
    ],
    "names": {"limbs": {}, "groups": {}, "feet": []},
}


def yaml_text() -> str:
    """The options as YAML."""
    import yaml

    return yaml.safe_dump(OPTIONS, sort_keys=False)


@dataclass(frozen=True)
class OtherFile:
    """A kind of file: its whole text, how it is read, and whether what was read is what it says."""

    file: str
    text: Callable[[], str]
    values: tuple[str, ...]
    """What is put in the place of a value."""
    read: Callable[[Path], Any]
    is_as_told: Callable[[Path, Any], bool]
    beside: Mapping[str, str]
    """Whole files beside it."""


def load_robot(path: Path) -> Any:
    """A robot of a model file."""
    from leapgap.robot.model import Robot

    return Robot.load(path)


def as_mujoco(path: Path, robot: Any) -> bool:
    """Whether a robot has the masses, ranges and damping that MuJoCo alone reads of its file."""
    import mujoco

    plain = mujoco.MjModel.from_xml_path(str(path))
    names = ("body_mass", "body_pos", "jnt_range", "jnt_axis", "dof_damping", "geom_size")
    return all(np.array_equal(getattr(robot.model, name), getattr(plain, name)) for name in names)


def read_options(path: Path) -> Any:
    """Options of the import of tables."""
    from leapgap.logs.importers import log_format
    from leapgap.settings import from_mapping, values_of

    values = values_of(path)
    from_mapping(log_format("csv").Options, values, str(path))
    return values


def as_plain(path: Path, values: Any) -> bool:
    """Whether values are those that plain readers find."""
    import yaml

    text = path.read_text(encoding="utf-8")
    return same(values, yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text))


def same(found: Any, plain: Any) -> bool:
    """Whether values are the same; ``1e-3`` is a number for us, and a text for PyYAML alone."""
    if isinstance(found, dict) and isinstance(plain, dict):
        return list(found) == list(plain) and all(same(found[key], plain[key]) for key in found)
    if isinstance(found, list) and isinstance(plain, list):
        return len(found) == len(plain) and all(map(same, found, plain))
    return bool(found == (float(plain) if isinstance(found, float) and isinstance(plain, str) else plain))


def read_corrected(path: Path) -> Any:
    """The effects of a folder with a corrected robot."""
    from leapgap import effects
    from leapgap.simulation.corrected import read_corrected as read

    return effects.to_config(read(path.parent)[1])


def as_json(path: Path, entries: Any) -> bool:
    """Whether effects are those that the file names."""
    stated = json.loads(path.read_text(encoding="utf-8"))["effects"]
    return bool(entries == [{"location": "all"} | one for one in stated])


NUMBERS = ("0", "-1", "1e-7", "1e9", "1e400", "nan", "inf", "1 -1", "1 1 1 1 1 1 1 1", "", "a", "&#10;", "&#27;", "-->")
PLAIN = (
    *("null", "[]", "{}", "-1", "1e999", "true", "99999999999999999999", '["a"]'),
    *('"\\u001b[2J"', '"a\\nb"', '"../../x"'),
)
OF_MODELS = (NUMBERS, load_robot, as_mujoco, {})
OTHER_FILES: Mapping[str, OtherFile] = {
    "arm_model": OtherFile("arm.xml", lambda: ARM, *OF_MODELS),
    "hopper_model": OtherFile("hopper.xml", lambda: HOPPER, *OF_MODELS),
    "urdf": OtherFile("arm.urdf", lambda: URDF, *OF_MODELS),
    "yaml_options": OtherFile("options.yaml", yaml_text, PLAIN, read_options, as_plain, {}),
    "json_options": OtherFile("options.json", lambda: json.dumps(OPTIONS), PLAIN, read_options, as_plain, {}),
    "effects": OtherFile(
        "effects.json", lambda: json.dumps(EFFECTS), PLAIN, read_corrected, as_json, {"nominal.xml": ARM}
    ),
}
"""Every kind."""
VALUE = re.compile(r'(?<==")[^"]*(?=")|(?<=: )[^\n,{}\[\]]+(?=[,}\n])')
"""Values of attributes of XML, of keys of JSON and of YAML."""
VALUES = 70
"""Cases of another value for each kind of file."""


def harms(seeds: int) -> list[str]:
    """Names of the harms to one of these files, each as often as it is tried."""
    return [*repeated(seeds), *["value"] * VALUES]


def write_harmed(kind: str, harm: str, folder: Path, rng: np.random.Generator) -> Path:
    """Write a file of a kind and harm it; its path."""
    other = OTHER_FILES[kind]
    folder.mkdir()
    for name, text in other.beside.items():
        (folder / name).write_text(text)
    path, text = folder / other.file, other.text()
    if harm == "value":
        places = list(VALUE.finditer(text))
        place = places[int(rng.integers(len(places)))]
        text = text[: place.start()] + str(rng.choice(other.values)) + text[place.end() :]
    path.write_text(text)
    if harm != "value":
        FILE_HARMS[harm](path, rng)
    return path


def judge_other(kind: str, path: Path) -> tuple[str, str]:
    """Outcome of a harmed file, and the reason in words."""
    from leapgap.errors import CONTROL, InputError

    try:
        found = OTHER_FILES[kind].read(path)
    except InputError as refusal:
        if CONTROL.search(str(refusal).replace("\n", "")):
            return "control", repr(str(refusal))
        return "refused", str(refusal)
    if OTHER_FILES[kind].is_as_told(path, found):
        return "accepted_harmless", "as a plain reader reads it"
    return "accepted_nonsense", "other than a plain reader reads it"
