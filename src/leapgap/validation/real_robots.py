"""Logs of real robots with answers that others measured: diagnosed, and held against those answers."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from leapgap.diagnosis.report import Cause, round_floats
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log
from leapgap.reports.diagnosis import Report, diagnose_logs
from leapgap.robot.model import Robot
from leapgap.settings import from_mapping, values_of

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
    expected: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    """As ``Expected``; empty where naming nothing is right."""
    fix_base: bool | None = None


def is_here(case: RealCase, raw: Path) -> bool:
    """Whether the files of a case are there."""
    return (raw / case.source).exists() and (raw / case.robot).is_file()


def read_case(case: RealCase, raw: Path, options: Path) -> tuple[Robot, list[Log]]:
    """The robot of a case and its logs, from the raw files; ``options`` is the file of its import."""
    values = values_of(options)
    layout = log_format(values["format"])
    chosen: Any = from_mapping(layout.Options, values.get(values["format"]) or {}, str(options))
    robot = Robot.load(raw / case.robot, fix_base=case.fix_base)
    found = layout.find(raw / case.source).items()
    return robot, [log for name, path in found for log in layout.read_all(path, name, robot, chosen)]


def outcome_of(case: RealCase, report: Report, seconds: float) -> dict[str, Any]:
    """One row of the table: the answer beside the published one, and whether it is right by the case's rule."""
    named = named_causes(report)
    wrong = [cause for cause in named if not is_expected(cause, case.expected)]
    closure = report.content.closure_of_answer
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
            "gap": report.content.gap_nominal,
            "horizon_s": report.content.headline.horizon_s,
            "right": right,
            "false_name": bool(wrong),
            "logs": len(report.logs),
            "seconds": round(seconds, 1),
        }
    )


def named_causes(report: Report) -> list[Cause]:
    """The causes of the answer: they stand first among all that were judged."""
    return list(report.causes[: len(report.answer)])


def is_expected(cause: Cause, expected: Expected) -> bool:
    """Whether a cause is listed, with each of its values in the range."""
    ranges = expected.get(cause.effect)
    return ranges is not None and all(
        name in ranges and ranges[name][0] <= one.value <= ranges[name][1] for name, one in cause.parameters.items()
    )


def run_case(case: RealCase, raw: Path, options: Path, **diagnosing: Any) -> tuple[Report, dict[str, Any]]:
    """Read, diagnose and judge one case; ``diagnosing`` are further arguments of ``diagnose_logs``."""
    begin = time.perf_counter()
    robot, logs = read_case(case, raw, options)
    report = diagnose_logs(logs, robot, **diagnosing)
    return report, outcome_of(case, report, time.perf_counter() - begin)
