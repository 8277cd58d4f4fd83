"""Several methods at one task, in one scene: the first solid, the others as ghosts, and where each substituted."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from leapgap.atomic_io import read_json
from leapgap.logs.log import read_log
from leapgap.reports.log_recording import record_jump
from leapgap.robot.model import Robot


def comparison_logs(runs: Path, methods: Sequence[str]) -> dict[str, list[Path]]:
    """By task, the logs that ``stages.land`` kept of these methods' first runs, in the order of the methods."""
    found: dict[str, list[Path]] = {}
    for method in methods:
        for path in sorted((runs / method).glob("*_0.parquet")):
            found.setdefault(path.stem.removesuffix("_0"), []).append(path)
    return dict(sorted(found.items()))


def record_comparison(path: Path, task: str, logs: Sequence[Path], robot: Robot) -> None:
    """Write the methods' runs of a task as one recording; each log has its figures as JSON beside it."""
    runs = {log.parent.name: (read_log(log), read_json(log.with_suffix(".json"))) for log in logs}
    (first, (main, _)), *others = runs.items()
    record_jump(
        path,
        main,
        robot,
        {name: log for name, (log, _) in others},
        title=f"landing {task}",
        label=first,
        says="  \n".join(told(name, kept) for name, (_, kept) in runs.items()),
        substitutes={name: kept["substituted"] for name, (_, kept) in runs.items() if kept["substituted"]},
    )


def told(method: str, kept: Mapping[str, Any]) -> str:
    """What came of a method's run, in a line."""
    landings = ", ".join(
        f"{one['error_cm']:+.1f} cm{'' if one['success'] else ' (failed)'}" for one in kept["landings"]
    )
    fallbacks = ", ".join(f"{count} × {reason}" for reason, count in kept["fallbacks"].items())
    return f"**{method}**: {landings or 'no jump'} (positive is short); substitutes: {fallbacks or 'none'}"
