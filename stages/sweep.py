"""A Hydra callback that ends every multirun with one table and one plot of the settings and the figures of its jobs.

Jobs keep their results as files (``stages.common.run_job``), wherever they ran. So a multirun into the folder of an
earlier one (``hydra.sweep.dir=<folder>``) goes on where that ended, and the table has the jobs of both.
"""

import csv
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.reports.page import render_page
from leapgap.runtime.atomic_io import read_json, whole_file, write_text
from leapgap.runtime.output_folder import check_output, claim_folder, folder_lock
from stages.common import FAILED, FIGURES, JOBS, refuse

MOST_FIGURES = 4  # figures that the plot has a panel for, the first ones
HELD = ExitStack()
"""The folder of the multirun, held by this process. Launchers pickle the callback for their workers, which cannot hold
it, so that it is no part of the callback."""


class Table(Callback):
    """Writes ``table.csv`` and ``plot.html`` into the folder of a multirun, smallest first figure first.

    Hydra only warns of errors of a callback, so those of input end the command here.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Take the folder, which must be new or that of an earlier multirun of this stage, and hold it."""
        name, folder = config.hydra.job.name, Path(config.hydra.sweep.dir)
        by = f"a multirun of stages.{name}"
        try:
            check_output(folder, by, kept=True)
            HELD.enter_context(folder_lock(folder))
            claim_folder(folder, by)
        except (InputError, OSError) as error:
            refuse(name, error)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write and print the table, write the plot; exit code 1 where a job failed."""
        try:
            failed = tabulate(Path(config.hydra.sweep.dir))
        except (InputError, OSError) as error:
            refuse(config.hydra.job.name, error)
        finally:
            HELD.close()
        if failed:
            raise SystemExit(1)


def tabulate(folder: Path) -> int:
    """Write and print the table of all jobs of a multirun, write the plot; the number of jobs that failed."""
    rows = rank([row_of(path) for path in sorted((folder / JOBS).glob("*.json"))])
    if not rows:
        return 0
    columns = list(dict.fromkeys(name for row in rows for name in row))
    write_table(folder / "table.csv", columns, rows)
    lines = [columns, *([str(row.get(name, "")) for name in columns] for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    print("\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines))
    print(f"{len(rows)} runs -> {folder / 'table.csv'}")
    if figures := figures_of(rows):
        write_text(folder / "plot.html", plot(rows, figures[:MOST_FIGURES]))
        print(f"plot: {folder / 'plot.html'}")
    failed = sum(FAILED in row for row in rows)
    if failed:
        print(f"{failed} of {len(rows)} runs failed; the same command with hydra.sweep.dir={folder} tries them again")
    return failed


def row_of(path: Path) -> dict[str, Any]:
    """Settings of a job that were varied, its figures, and why it failed, if it did, from the file of its result."""
    job = read_json(path)
    try:
        overrides = [override.lstrip("+") for override in job["overrides"]]  # Hydra's mark of added keys
        varied: dict[str, Any] = dict(override.split("=", 1) for override in overrides)
        return varied | dict(job.get(FIGURES, {})) | ({FAILED: str(job[FAILED])} if FAILED in job else {})
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(path, "other contents", "the result of a job", "remove it: the job is run again") from None


def figures_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of the numbers that jobs returned, in their order."""
    return list(dict.fromkeys(name for row in rows for name, value in row.items() if isinstance(value, float)))


def rank(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows by their first figure, the smallest first; those without one at the end."""
    name = next(iter(figures_of(rows)), "")

    def first(row: Mapping[str, Any]) -> float:
        value = row.get(name)
        return value if isinstance(value, float) else float("inf")

    return sorted(rows, key=first)


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows as CSV."""
    with whole_file(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def plot(rows: Sequence[Mapping[str, Any]], figures: Sequence[str]) -> str:
    """A page with one bar a job for each figure, in the order of the table."""
    settings = [name for name in rows[0] if not isinstance(rows[0][name], float) and name != FAILED]
    varied = [name for name in settings if len({str(row.get(name)) for row in rows}) > 1] or settings
    labels = [", ".join(f"{name.rsplit('.', 1)[-1]}={row.get(name, '')}" for name in varied) for row in rows]
    drawn: dict[str, go.Figure] = {}
    for number, name in enumerate(figures):
        chart = go.Figure(go.Bar(x=[row.get(name) for row in rows], y=labels, orientation="h", marker_color="#2563c9"))
        chart.update_layout(height=90 + 26 * len(rows), margin={"l": 200, "r": 20, "t": 10, "b": 45})
        chart.update_xaxes(title_text=name)
        chart.update_yaxes(autorange="reversed", automargin=True)
        drawn[f"figure{number}"] = chart
    failed = [(label, row[FAILED]) for label, row in zip(labels, rows, strict=True) if FAILED in row]
    return render_page(Path(__file__).with_name("sweep.html"), drawn, names=figures, failed=failed, jobs=len(rows))
