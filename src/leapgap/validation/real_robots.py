"""Logs of real robots with answers that others measured: diagnosed, and held against those answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.report import Cause, ReportContent, round_floats
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log
from leapgap.logs.reading import read_foreign
from leapgap.logs.segments import runs_of
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import MODEL, write_corrected

Expected = Mapping[str, Mapping[str, Sequence[float]]]
"""Effect → parameter → lowest and highest value that counts as right."""
PUSHED = 0.01
"""A published torque above this, N·m, is a push."""
LATE_S = 0.05
"""A push is found by a force from outside at its joint whose centre is within this time of its own."""
LEAST_FOUND = 0.8
"""Least share of the impulse of all published pushes that has to be told of those that are found."""


@dataclass(frozen=True)
class RealCase:
    """Logs of one real robot, its model, and what others found."""

    import_logs: str
    """Name of the file of options that says how its logs are read."""
    source: str
    """Folder of its logs, below the folder of all raw data."""
    robot: str
    """Its model file, below the same folder."""
    published: str
    """What others measured, in words."""
    expected: dict[str, dict[str, list[float]]] | None
    """As ``Expected``; empty where naming nothing is right; None where nobody published an answer, so that the case is
    shown beside others and is neither right nor false."""
    fix_base: bool
    """Whether the robot hangs: its floating base is held."""
    after: str | None
    """Name of an earlier case, whose corrected robot takes the place of the model file: what has changed since? None:
    the model file."""
    changes: list[dict[str, Any]] = field(default_factory=list)
    """Effects that make another published description of the robot out of the model file; empty: the file as it is."""


@dataclass(frozen=True)
class PublishedPush:
    """A push whose time and size its makers published."""

    log: str
    joint: str
    time_s: float
    """Its centre, by the time of the log."""
    impulse: float
    """N·m·s, signed."""

    def is_told_by(self, force: OutsideForce) -> bool:
        """Whether a force from outside is this push."""
        here = (force.log, force.at) == (self.log, self.joint)
        return here and abs(force.time_s - self.time_s) <= LATE_S and force.impulse * self.impulse > 0


def is_here(case: RealCase, raw: Path) -> bool:
    """Whether the files of a case are there."""
    return (raw / case.source).exists() and (raw / case.robot).is_file()


def read_case(
    case: RealCase, raw: Path, layout: LogFormat, options: Any, models: Path, corrected: Path | None = None
) -> tuple[Robot, list[Log]]:
    """The robot of a case and its logs, from the raw files, by the format and options of its import.

    ``corrected`` is the model file of the robot as an earlier case corrected it, where the case asks for that. A model
    that the case changes is written to the folder ``models``.
    """
    robot = Robot.load(corrected or raw / case.robot, fix_base=case.fix_base or None)
    if case.changes:
        write_corrected(models, robot, effects.from_config(case.changes))
        robot = Robot.load(models / MODEL)
    return robot, list(read_foreign(layout, raw / case.source, robot, options).logs)


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
    named = named_causes(report)
    wrong = [] if case.expected is None else [one for one in named if not is_expected(one, case.expected)]
    closure = report.closure_of_answer
    right = bool(named) and not wrong if case.expected else not named
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


def named_causes(report: ReportContent) -> list[Cause]:
    """The causes of the answer that have no rival: they stand first among all that were judged.

    A cause that cannot be told apart from another is no name.
    """
    return [cause for cause, names in zip(report.causes, report.answer, strict=False) if len(names) == 1]


def is_expected(cause: Cause, expected: Expected) -> bool:
    """Whether a cause is listed, with each of its values in the range."""
    ranges = expected.get(effects.first_name(cause.effect))
    return ranges is not None and all(
        name in ranges and ranges[name][0] <= one.value <= ranges[name][1] for name, one in cause.parameters.items()
    )
