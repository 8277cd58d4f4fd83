"""What a person looks at of a diagnosis, written whole or not at all: page, recording, and replays of all logs."""

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from leapgap.logs.log import write_log
from leapgap.reports.diagnosis import RECORDING, PageSettings, Report
from leapgap.reports.kept import KEPT, copy_data, kept, write_note
from leapgap.reports.log_recording import DIAGNOSED, GHOSTS, JUDGED, record_jump
from leapgap.runtime.atomic_io import write_json
from leapgap.runtime.output_folder import whole_folder


def record_report(report: Report, path: Path) -> None:
    """Record the median log beside its replays, in one scene."""
    content = report.content
    shown = next(log for log in report.logs if log.name == content.median_log)
    replays = {"nominal": report.nominal, "corrected": report.corrected}
    beside = {name: replays[kind][shown.name] for kind, name in GHOSTS.items()}
    record_jump(path, shown, report.robot, beside, title=f"diagnosis of {shown.name}", says=content.sentence)


REPLAYS = "replays"  # folder of the replays inside that of the report, where they have none of their own


def write_kept_pages(names: Iterable[str], source: Path, out: Path) -> None:
    """Write the data and the page of each report that is kept in a folder of ``source``; others have theirs there."""
    for name in [name for name in names if (source / name / KEPT).is_file()]:
        (out / name).mkdir()
        copy_data(source / name, out / name)
        if report := kept(source / name):
            report.write_page(out / name)


def write_pages(
    report: Report | None, out: Path, by: str, page: PageSettings, replays: Path | None = None, data: Path | None = None
) -> None:
    """Write a report, its page, its recording and its replays; a note where there were no logs, so no report.

    ``by``: the command that writes; ``data``: a folder where the report's data lies already (``kept.keep``).
    """
    with ExitStack() as stack:
        folder = stack.enter_context(whole_folder(out, by))
        beside = stack.enter_context(whole_folder(replays, by)) if replays else folder / REPLAYS
        if report is None:
            write_note(folder)
            write_note(beside)
            return
        if data is None:
            report.write_data(folder)
        else:
            copy_data(data, folder)
        replace(report, record=record_report).write_page(folder, page.viewer)
        if page.recordings:
            record_report(report, folder / RECORDING)
        # Write the replays of all logs as logs, the logs as they were judged, and which log is the median one
        write_json(beside / DIAGNOSED, {"log": report.content.median_log, "sentence": report.sentence})
        for kind, simulated in (("nominal", report.nominal), ("corrected", report.corrected)):
            for name, replay in simulated.items():
                write_log(replay, beside / kind / f"{name}.parquet")
        for log in report.logs:
            write_log(log, beside / JUDGED / f"{log.name}.parquet")
