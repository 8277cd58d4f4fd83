"""A diagnosis of the pipeline: its settings, and its report with a page, or kept as data from which one is made later.

What is kept is a pickle, for the pipeline that wrote it and for nobody else: a pickle of a stranger can do anything
when it is read.
"""

import pickle
import shutil
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.log import write_log
from leapgap.reports.diagnosis import BEST, CORRECTED, PAGE, RECORDING, REPORT, PageSettings, Report
from leapgap.runtime.atomic_io import whole_file, write_json, write_metrics, write_text
from leapgap.runtime.output_folder import whole_folder

KEPT = "report.pickle"
REPLAYS = "replays"  # folder of the replays inside that of the report, where they have none of their own
SWEPT = ("gap_corrected", "gap_nominal", "closure_heldout", "noise_floor")
"""Figures for the table of a sweep, the one that is ranked by first."""


@dataclass(frozen=True)
class DiagnoseSettings:
    """Section ``diagnose`` of the configuration."""

    logs: str
    robot: str | None
    robots: list[str]
    out: str | None
    replays: str | None
    metrics: str | None
    threads: int | None
    pages: bool
    recordings: bool
    settings: Settings = field(default_factory=Settings)

    def __post_init__(self) -> None:
        """Refuse a number of threads that means nothing."""
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads {self.threads}: null or a number of 1 or more")


def keep(report: Report, folder: Path) -> None:
    """Write the data of a report into a folder, and what its page is made from."""
    report.write_data(folder)
    with whole_file(folder / KEPT) as beside:
        bare = replace(report.diagnosis, nominal={}, corrected={}, fit=None)
        with beside.open("wb") as file:
            writer = pickle.Pickler(file, protocol=4)
            writer.fast = True  # equal reports give equal bytes, whichever of their parts are one object
            writer.dump(replace(report, diagnosis=bare, record=None))


def kept(folder: Path) -> Report | None:
    """The report that is kept in a folder; None where there were no logs to diagnose."""
    path = folder / KEPT
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a diagnosis that was kept", "run stages.diagnose with pages=false")
    if not path.is_file():
        return None
    found = pickle.loads(path.read_bytes())
    assert isinstance(found, Report)
    return found


def copy_data(folder: Path, out: Path) -> None:
    """Copy the data of a kept report into the folder of its page."""
    shutil.copyfile(folder / REPORT, out / REPORT)
    for name in (CORRECTED, BEST):
        if (folder / name).is_dir():
            shutil.copytree(folder / name, out / name)


def write_note(folder: Path) -> None:
    """Write that there were no logs."""
    write_text(folder / "no_logs.txt", "There were no jump logs to diagnose.\n")


def record_report(report: Report, path: Path) -> None:
    """Record the median log beside its replays, in one scene; Rerun is imported only then."""
    from leapgap.reports.log_recording import GHOSTS, record_jump

    content = report.content
    shown = next(log for log in report.logs if log.name == content.median_log)
    replays = {"nominal": report.nominal, "corrected": report.corrected}
    beside = {name: replays[kind][shown.name] for kind, name in GHOSTS.items()}
    record_jump(path, shown, report.robot, beside, title=f"diagnosis of {shown.name}", says=content.sentence)


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
    from leapgap.reports.log_recording import DIAGNOSED, JUDGED  # imports Rerun, which a refusal does without

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


def write_diagnosis(
    report: Report | None, chosen: DiagnoseSettings, page: PageSettings, out: Path, replays: Path | None, by: str
) -> dict[str, float] | None:
    """Write a report with its page, or its data alone where no page is asked for; a note where there were no logs.

    The figures that a sweep tabulates are returned. ``by``: the command that writes.
    """
    if report is None:
        print(f"no logs in {chosen.logs}: nothing to diagnose")
    if chosen.pages:
        write_pages(report, out, by, replace(page, recordings=chosen.recordings), replays)
    else:
        with whole_folder(out, by) as folder:
            write_note(folder) if report is None else keep(report, folder)
    if report is None:
        return None
    figures = report.content.metrics()
    if chosen.metrics:
        write_metrics(Path(chosen.metrics), figures)
    print(report.sentence)
    if chosen.pages:
        print(f"report: {out / PAGE}")
    return {name: figures[name] for name in SWEPT if isinstance(figures[name], float)}
