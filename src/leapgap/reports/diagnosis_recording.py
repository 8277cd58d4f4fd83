"""A report in the Rerun viewer: the median log beside its replays."""

from pathlib import Path

from leapgap.logs.log import write_log
from leapgap.reports.diagnosis import Report
from leapgap.reports.log_recording import DIAGNOSED, GHOSTS, JUDGED, record_jump
from leapgap.runtime.atomic_io import write_json


def record_report(report: Report, path: Path) -> None:
    """Record the median log beside its replays, in one scene."""
    content = report.content
    shown = next(log for log in report.logs if log.name == content.median_log)
    replays = {"nominal": report.nominal, "corrected": report.corrected}
    beside = {name: replays[kind][shown.name] for kind, name in GHOSTS.items()}
    record_jump(path, shown, report.robot, beside, title=f"diagnosis of {shown.name}", says=content.sentence)


def write_replays(report: Report, folder: Path) -> None:
    """Write the replays of all logs as logs, the logs as they were judged, and which log is the median one.

    Logs that are judged by a clock of their own have other times than those that were read, and so have their replays.
    """
    write_json(folder / DIAGNOSED, {"log": report.content.median_log, "sentence": report.sentence})
    for kind, replays in (("nominal", report.nominal), ("corrected", report.corrected)):
        for name, replay in replays.items():
            write_log(replay, folder / kind / f"{name}.parquet")
    for log in report.logs:
        write_log(log, folder / JUDGED / f"{log.name}.parquet")
