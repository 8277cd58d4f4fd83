"""What a person looks at of a diagnosis, written whole or not at all: page, recording, and replays of all logs."""

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import plotly.offline

from leapgap.reports.diagnosis import PAGE, RECORDING, PageSettings, Report
from leapgap.reports.diagnosis_recording import record_report, write_replays
from leapgap.reports.kept import KEPT, copy_data, kept, write_note
from leapgap.runtime.atomic_io import write_text
from leapgap.runtime.output_folder import whole_folder

REPLAYS = "replays"
"""Folder of the replays inside that of the report, where they have none of their own."""

SCRIPT = "plotly.js"
"""Script that all reports of a folder share, so that thousands of pages stay small."""


def write_script(folder: Path) -> None:
    """Write the script that the pages in the folders below share."""
    write_text(folder / SCRIPT, plotly.offline.get_plotlyjs())


def write_with_shared_script(report: Report, folder: Path) -> None:
    """Write the page of a report into a folder that has its data, with the script from the folder above."""
    report.write_page(folder)
    page, inline = folder / PAGE, f"<script>{plotly.offline.get_plotlyjs()}</script>"
    write_text(page, page.read_text(encoding="utf-8").replace(inline, f'<script src="../{SCRIPT}"></script>'))


def write_kept_pages(names: Iterable[str], source: Path, out: Path) -> None:
    """Write the data and the page of each report that is kept in a folder of ``source``; others have theirs there."""
    names = [name for name in names if (source / name / KEPT).is_file()]
    if names:
        write_script(out)
    for name in names:
        (out / name).mkdir()
        copy_data(source / name, out / name)
        if report := kept(source / name):
            write_with_shared_script(report, out / name)


def write_pages(
    report: Report | None,
    out: Path,
    by: str,
    page: PageSettings,
    replays: Path | None = None,
    data: Path | None = None,
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
        write_replays(report, beside)
