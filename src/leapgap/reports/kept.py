"""A diagnosis of the pipeline: its settings, and its report with a page, or kept as data from which one is made later.

What is kept is a pickle, for the pipeline that wrote it and for nobody else: a pickle of a stranger can do anything
when it is read.
"""

import pickle
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.reports.diagnosis import BEST, CORRECTED, PAGE, REPORT, PageSettings, Report
from leapgap.runtime.atomic_io import whole_file, write_metrics, write_text
from leapgap.runtime.output_folder import whole_folder

KEPT = "report.pickle"
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


def write_diagnosis(
    report: Report | None, chosen: DiagnoseSettings, page: PageSettings, out: Path, replays: Path | None, by: str
) -> dict[str, float] | None:
    """Write a report with its page, or its data alone where no page is asked for; a note where there were no logs.

    The figures that a sweep tabulates are returned. ``by``: the command that writes.
    """
    if report is None:
        print(f"no logs in {chosen.logs}: nothing to diagnose")
    if chosen.pages:
        from leapgap.reports.pages import write_pages  # imports Rerun, which a refusal does without

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
