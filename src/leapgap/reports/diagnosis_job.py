"""One diagnosis as a job of the pipeline: its settings, and its report with a page or as data for one."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from leapgap.diagnosis.settings import Settings
from leapgap.reports.diagnosis import PAGE, PageSettings, Report
from leapgap.reports.kept import keep, write_note
from leapgap.runtime.atomic_io import write_metrics
from leapgap.runtime.output_folder import whole_folder

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
