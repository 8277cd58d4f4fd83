"""Recordings that compare methods at one task: the first solid, the others as ghosts, with their fallbacks."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.jumping.task import begin_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log, read_log
from leapgap.logs.metadata import ROUNDING_S
from leapgap.reports.log_recording import record_jump
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json


def comparison_logs(runs: Path, methods: Sequence[str]) -> dict[str, list[Path]]:
    """Logs of these methods' first runs by task, as stage ``land`` keeps them, in the order of the methods."""
    found: dict[str, list[Path]] = {}
    for method in methods:
        for path in sorted((runs / method).glob("*_0.parquet")):
            found.setdefault(path.stem.removesuffix("_0"), []).append(path)
    return dict(sorted(found.items()))


def record_comparison(path: Path, task: str, logs: Sequence[Path], robot: Robot) -> None:
    """Write the methods' runs of a task as one recording; the figures of each log are in a JSON file beside it.

    All runs are shown from where their first jump begins, since some methods stand before it.
    """
    runs: dict[str, tuple[Log, Mapping[str, Any]]] = {}
    for one in logs:
        log, kept = read_log(one), read_json(one.with_suffix(".json"))
        if begin_s := begin_of(log):
            row = int(np.searchsorted(log.time, begin_s - ROUNDING_S))
            substituted = [[time_s - begin_s, reason] for time_s, reason in kept["substituted"]]
            log, kept = rows_between(log, row, len(log), log.name), {**kept, "substituted": substituted}
        runs[one.parent.name] = log, kept
    says = []
    for method, (_, kept) in runs.items():
        landed = [f"{one['error_cm']:+.1f} cm{'' if one['success'] else ' (failed)'}" for one in kept["landings"]]
        fallbacks = ", ".join(f"{count} × {reason}" for reason, count in kept["fallbacks"].items())
        where = f"{', '.join(landed) or 'no jump'} (positive is short)"
        says.append(f"**{method}**: {where}; substitutes: {fallbacks or 'none'}")
    (first, (main, _)), *others = runs.items()
    record_jump(
        path,
        main,
        robot,
        {name: log for name, (log, _) in others},
        title=f"landing {task}",
        label=first,
        says="  \n".join(says),
        substitutes={name: kept["substituted"] for name, (_, kept) in runs.items() if kept["substituted"]},
    )
