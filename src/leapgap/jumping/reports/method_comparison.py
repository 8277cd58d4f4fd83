"""Recordings that compare methods at one task: the first solid, the others as ghosts, with their fallbacks."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from leapgap.jumping.models.rigid_body_model import RigidBodyModel, planner_body
from leapgap.jumping.reports.mpc_horizon import MpcHorizons, in_words, mpc_horizons, planned_for
from leapgap.jumping.task import begin_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log, read_log
from leapgap.logs.metadata import ROUNDING_S
from leapgap.reports.log_recording import Further, plot, record_jump
from leapgap.reports.shown_robot import Recorder, ShownRobot
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json

PREDICTING = "nominal_variable"
"""Method whose predictions are shown."""
ENDS = (("x", "m"), ("z", "m"), ("pitch", "rad"))


def comparison_logs(runs: Path, methods: Sequence[str]) -> dict[str, list[Path]]:
    """Logs of these methods' first runs by task, as stage ``land`` keeps them, in the order of the methods."""
    found: dict[str, list[Path]] = {}
    for method in methods:
        for path in sorted((runs / method).glob("*_0.parquet")):
            found.setdefault(path.stem.removesuffix("_0"), []).append(path)
    return dict(sorted(found.items()))


def record_comparison(
    path: Path, task: str, logs: Sequence[Path], robot: Robot, references: Path | None = None
) -> None:
    """Write the methods' runs of a task as one recording; the figures of each log are in a JSON file beside it.

    All runs are shown from where their first jump begins, since some methods stand before it. With a folder of
    ``references``, what the nominal MPC predicts at each update is shown beside its run.
    """
    runs = {log.parent.name: from_its_jump(read_log(log), read_json(log.with_suffix(".json"))) for log in logs}
    (first, (main, _)), *others = runs.items()
    horizons = {
        name: found
        for name, (log, _) in runs.items()
        if name == PREDICTING and references and (found := horizons_of(log, references, robot)) is not None
    }
    record_jump(
        path,
        main,
        robot,
        {name: log for name, (log, _) in others},
        title=f"landing {task}",
        label=first,
        says="  \n".join(
            [*(describe_run(name, kept) for name, (_, kept) in runs.items()), *map(in_words, horizons.values())]
        ),
        further=[horizon_tab(name, one) for name, one in horizons.items()],
        substitutes={name: kept["substituted"] for name, (_, kept) in runs.items() if kept["substituted"]},
    )


def from_its_jump(log: Log, kept: Mapping[str, Any]) -> tuple[Log, Mapping[str, Any]]:
    """A run and its figures from where its first jump begins, by the time since then."""
    begin_s = begin_of(log)
    if begin_s == 0:
        return log, kept
    row = int(np.searchsorted(log.time, begin_s - ROUNDING_S))
    substituted = [[time_s - begin_s, reason] for time_s, reason in kept["substituted"]]
    return rows_between(log, row, len(log), log.name), {**kept, "substituted": substituted}


def horizons_of(log: Log, references: Path, robot: Robot) -> MpcHorizons | None:
    """Predictions of the nominal MPC in a run; None where its reference is not in the folder."""
    planned = planned_for(log, references)
    if planned is None:
        return None
    body = planner_body(robot, planned.per_joint("cmd_pos", robot.joints)[0], None)
    return mpc_horizons(log, planned, robot, RigidBodyModel(body))


def horizon_tab(method: str, horizons: MpcHorizons) -> Further:
    """A tab with where each update expects to land, and the predicted ways in the scene."""
    views = [plot(f"mpc/{name}", f"{name} at the end of the horizon [{unit}]", True) for name, unit in ENDS]
    tab = rrb.Grid(*views, grid_columns=1, name=f"Horizon of {method}")

    def log(to: Recorder, actors: Sequence[ShownRobot]) -> None:
        (key,) = [actor.key for actor in actors if actor.label == method]
        horizons.log(to, key)

    return Further(tab, log)


def describe_run(method: str, kept: Mapping[str, Any]) -> str:
    """One line on a method's run: its landing errors and its fallbacks."""
    landings = ", ".join(
        f"{one['error_cm']:+.1f} cm{'' if one['success'] else ' (failed)'}" for one in kept["landings"]
    )
    fallbacks = ", ".join(f"{count} × {reason}" for reason, count in kept["fallbacks"].items())
    return f"**{method}**: {landings or 'no jump'} (positive is short); substitutes: {fallbacks or 'none'}"
