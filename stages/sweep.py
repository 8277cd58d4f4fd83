"""A Hydra callback that ends every multirun with one table of the varied settings and the returned figures."""

import csv
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from leapgap.atomic_io import whole_file


class Table(Callback):
    """Collects the jobs of a multirun; writes ``table.csv`` into its folder, smallest first figure first."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Add one row for a job that returned figures."""
        if job_return.status == JobStatus.COMPLETED and isinstance(job_return.return_value, dict):
            overrides = [override.lstrip("+") for override in job_return.overrides or []]  # Hydra's mark of added keys
            varied = dict(override.split("=", 1) for override in overrides)
            self.rows.append(varied | job_return.return_value)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write and print the table."""
        if not self.rows:
            return
        columns = list(dict.fromkeys(name for row in self.rows for name in row))
        figure = next(name for name in columns if isinstance(self.rows[0].get(name), float))
        ranked = sorted(self.rows, key=lambda row: row.get(figure, float("inf")))
        path = Path(config.hydra.sweep.dir) / "table.csv"
        with whole_file(path) as beside, beside.open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(ranked)
        lines = [columns, *([str(row.get(name, "")) for name in columns] for row in ranked)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
        print(
            "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
        )
        print(f"{len(ranked)} runs -> {path}")
