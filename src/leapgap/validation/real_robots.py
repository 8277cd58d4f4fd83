"""Logs of real robots with answers that others measured: diagnosed, and held against those answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.diagnosis.report import Cause, ReportContent, round_floats
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log
from leapgap.logs.reading import read_foreign
from leapgap.robot.model import Robot

Expected = Mapping[str, Mapping[str, Sequence[float]]]
"""Effect → parameter → lowest and highest value that counts as right."""


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


def is_here(case: RealCase, raw: Path) -> bool:
    """Whether the files of a case are there."""
    return (raw / case.source).exists() and (raw / case.robot).is_file()


def read_case(case: RealCase, raw: Path, layout: LogFormat, options: Any) -> tuple[Robot, list[Log]]:
    """The robot of a case and its logs, from the raw files, by the format and options of its import."""
    robot = Robot.load(raw / case.robot, fix_base=case.fix_base or None)
    return robot, list(read_foreign(layout, raw / case.source, robot, options).logs)


def outcome_of(case: RealCase, report: ReportContent, seconds: float) -> dict[str, Any]:
    """One row of the table: the answer beside the published one, and whether it is right by the case's rule."""
    named = named_causes(report)
    wrong = [] if case.expected is None else [one for one in named if not is_expected(one, case.expected)]
    closure = report.closure_of_answer
    right = bool(named) and not wrong if case.expected else not named
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
        }
    )


def named_causes(report: ReportContent) -> list[Cause]:
    """The causes of the answer: they stand first among all that were judged."""
    return list(report.causes[: len(report.answer)])


def is_expected(cause: Cause, expected: Expected) -> bool:
    """Whether a cause is listed, with each of its values in the range."""
    ranges = expected.get(cause.effect)
    return ranges is not None and all(
        name in ranges and ranges[name][0] <= one.value <= ranges[name][1] for name, one in cause.parameters.items()
    )
