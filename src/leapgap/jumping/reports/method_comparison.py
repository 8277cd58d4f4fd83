"""Recordings that compare methods at one task: the first solid, the others as ghosts, with their fallbacks."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from leapgap.atomic_io import read_json
from leapgap.logs.log import read_log
from leapgap.reports.log_recording import record_jump
from leapgap.robot.model import Robot


def comparison_logs(runs: Path, methods: Sequence[str]) -> dict[str, list[Path]]:
    """Logs of these methods' first runs by task, as stage ``land`` keeps them, in the order of the methods."""
    found: dict[str, list[Path]] = {}
    for method in methods:
        for path in sorted((runs / method).glob("*_0.parquet")):
            found.setdefault(path.stem.removesuffix("_0"), []).append(path)
    return dict(sorted(found.items()))


def record_comparison(path: Path, task: str, logs: Sequence[Path], robot: Robot) -> None:
    """Write the methods' runs of a task as one recording; the figures of each log are in a JSON file beside it."""
    runs = {log.parent.name: (read_log(log), read_json(log.with_suffix(".json"))) for log in logs}
    (first, (main, _)), *others = runs.items()
    record_jump(
        path,
        main,
        robot,
        {name: log for name, (log, _) in others},
        title=f"landing {task}",
        label=first,
        says="  \n".join(describe_run(name, kept) for name, (_, kept) in runs.items()),
        substitutes={name: kept["substituted"] for name, (_, kept) in runs.items() if kept["substituted"]},
    )


def describe_run(method: str, kept: Mapping[str, Any]) -> str:
    """One line on a method's run: its landing errors and its fallbacks."""
    landings = ", ".join(
        f"{one['error_cm']:+.1f} cm{'' if one['success'] else ' (failed)'}" for one in kept["landings"]
    )
    fallbacks = ", ".join(f"{count} × {reason}" for reason, count in kept["fallbacks"].items())
    return f"**{method}**: {landings or 'no jump'} (positive is short); substitutes: {fallbacks or 'none'}"
