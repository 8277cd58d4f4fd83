"""Recordings of all results of the pipeline: which folders are shown, and in which form; methods as ghosts of one."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr
import rerun.blueprint as rrb

from leapgap.errors import InputError
from leapgap.jumping.task import begin_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log, read_log
from leapgap.logs.metadata import ROUNDING_S
from leapgap.reports.log_recording import DIAGNOSED, GHOSTS, JUDGED, add_panels, log_notes, overview, plot, record_jump
from leapgap.reports.plots import COMPONENTS, Curve, components, log_phases, log_plot
from leapgap.reports.scene import WORLD, log_scene
from leapgap.reports.shown_robot import GHOSTS as GHOST_COLOURS
from leapgap.reports.shown_robot import Colour, Recorder, ShownRobot, recording, shown_robots
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json

TRUTH = "measured"
COLUMNS = ("model", "window", "step", "time", *(part.key for part in COMPONENTS))
SHOWN_WINDOW_S = 0.65  # Start of the roll-out that is plotted, s: the rear feet push, before the flight
MORE_COLOURS: tuple[Colour, ...] = ((160, 160, 160), (200, 170, 90), (150, 200, 90))


@dataclass(frozen=True)
class ShownPrediction:
    """Prediction of one model from the start of one window on."""

    time: np.ndarray  # Times of the steps, s, (steps,)
    values: Mapping[str, np.ndarray]  # Predicted absolute values by ``Component.key``, (steps,) each

    @property
    def start_s(self) -> float:
        """Time at which the prediction starts, s."""
        return float(self.time[0])


def read_predictions(path: Path) -> dict[str, list[ShownPrediction]]:
    """Roll-outs of every model in the order of their starts; ``InputError`` where columns are missing."""
    if not path.is_file():
        raise InputError(path, "no such file", "predictions (Parquet)", "run the stage evaluate first")
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(
            path, f"no readable Parquet ({error})", "a table of predictions", "run the stage evaluate again"
        ) from None
    missing = [name for name in COLUMNS if name not in table.column_names]
    if missing:
        raise InputError(path, f"no column {', '.join(missing)}", ", ".join(COLUMNS), "run the stage evaluate again")
    model = np.asarray(table["model"].to_pylist())
    window, step = table["window"].to_numpy(), table["step"].to_numpy()
    columns = {name: table[name].to_numpy() for name in COLUMNS[3:]}
    by_model: dict[str, list[ShownPrediction]] = {}
    for name in dict.fromkeys(model.tolist()):
        roll_outs = []
        for number in np.unique(window[model == name]):
            rows = np.flatnonzero((model == name) & (window == number))
            rows = rows[np.argsort(step[rows], kind="stable")]
            values = {part.key: columns[part.key][rows] for part in COMPONENTS}
            roll_outs.append(ShownPrediction(columns["time"][rows], values))
        by_model[name] = sorted(roll_outs, key=lambda roll_out: roll_out.start_s)
    return by_model


def record_prediction(
    path: Path,
    jump: Log,
    robot: Robot,
    predictions: Path,
    title: str | None = None,
    window_start_s: float = SHOWN_WINDOW_S,
    shown: Sequence[str] | None = None,
) -> None:
    """Write a jump and the models' predictions of it as a recording, whole or not at all.

    ``shown`` names the models to show, those of them that the table has; None: all. In 3-D, the way of the base that
    each model predicts from the time cursor on; in the plots, the window that starts nearest to ``window_start_s``.
    """
    by_model = read_predictions(predictions)
    actors = shown_robots(TRUTH, jump, {}, robot)
    models = [name for name in shown or by_model if name != TRUTH and by_model.get(name)]
    colours = dict(zip(models, itertools.cycle((*GHOST_COLOURS, *MORE_COLOURS)), strict=False))
    title = title or f"predictions of {jump.name}"
    views = [plot(f"base/{part.key}", part.label, legend=part is COMPONENTS[0]) for part in COMPONENTS]
    plots = rrb.Grid(*views, grid_columns=2, name="Base, predicted from one window on")
    notes = rrb.TextDocumentView(origin="notes", name="Notes")
    layout = add_panels(rrb.Tabs(overview(actors, plots), notes, active_tab=0))
    aside = jump["base_pos_y"] if "base_pos_y" in jump else np.zeros(len(jump))
    with recording(path, title, layout) as to:
        log_scene(to, actors)
        log_phases(to, actors[0])
        for name in models:
            entity = f"{WORLD}/predicted/{name}"
            to.static(entity, rr.LineStrips3D.from_fields(colors=[colours[name]], radii=[0.006]))
            first_of = {one.start_s: one for one in by_model[name]}
            ways = [
                (one.values["x"], np.interp(one.time, jump.time, aside), one.values["z"]) for one in first_of.values()
            ]
            strips = [np.stack(way, axis=-1).astype(np.float32) for way in ways]
            to.over_time(entity, np.array(list(first_of)), rr.LineStrips3D.columns(strips=strips))
        log_predicted_base(to, actors[0], by_model, colours, window_start_s)
        log_notes(to, actors, title)


def log_predicted_base(
    to: Recorder,
    actor: ShownRobot,
    by_model: Mapping[str, Sequence[ShownPrediction]],
    colours: Mapping[str, Colour],
    window_start_s: float,
) -> None:
    """Log the measured components over the whole jump, and one roll-out of each model."""
    time = actor.jump.time
    for part in COMPONENTS:
        if part in components(actor.jump):
            log_plot(to, f"base/{part.key}/{TRUTH}", time, [Curve(TRUTH, actor.colour, part.of(actor.jump))], width=2.5)
        for model, colour in colours.items():
            shown = min(by_model[model], key=lambda roll_out: abs(roll_out.start_s - window_start_s))
            curve = Curve(model, colour, shown.values[part.key])
            log_plot(to, f"base/{part.key}/{model}", shown.time, [curve])


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


@dataclass(frozen=True)
class View:
    """Section ``view`` of the configuration; folders that are missing or empty are skipped, and those that are None."""

    references: str | None
    simulated: str | None
    damped: str | None
    published: str | None
    replays_damped: str
    replays_published: str
    predictions_simulated: str
    predictions_published: str
    most: int  # Largest number of recordings of each kind; the first by name are taken
    most_predictions: int  # Largest number of jumps with predictions of each kind; the first by name are taken
    most_landings: int  # Largest number of tasks whose landings are recorded
    models: list[str]  # Models whose predictions are shown; empty: all
    landings: str | None  # Folder of the runs of one robot, as stage ``land`` keeps them
    landing_methods: list[str]  # Methods shown in one scene, the first solid, the others as ghosts
    out: str | None = None

    def __post_init__(self) -> None:
        counts = {"most": self.most, "most_predictions": self.most_predictions, "most_landings": self.most_landings}
        if min(counts.values()) < 0:
            raise ValueError(f"{', '.join(f'{name} {count}' for name, count in counts.items())}: 0 or more")


def record_all(view: View, robot: Robot, out: Path) -> Iterator[str]:
    """Write every recording into ``out``; yields one line for each kind: what was written or skipped."""
    for kind, label, folder, replays in (
        ("reference", "reference", view.references, None),
        ("simulated", "simulated", view.simulated, None),
        ("damped", "simulated", view.damped, view.replays_damped),
        ("published", "measured", view.published, view.replays_published),
    ):
        if folder is None:
            continue
        logs = logs_in(Path(folder))
        for path in islice(logs, view.most):
            jump = as_judged(path, replays)
            record_jump(
                out / f"{kind}_{jump.name}.rrd",
                jump,
                robot,
                ghosts_of(jump, replays),
                title=f"{kind} {jump.name}",
                label=label,
            )
        yield describe_recordings(kind, folder, len(logs), view.most)
    for kind, folder, logs_folder in (
        ("damped", view.replays_damped, view.damped),
        ("published", view.replays_published, view.published),
    ):
        if logs_folder is None:
            continue
        path = Path(folder) / DIAGNOSED
        if path.exists():
            shown = read_json(path)
            jump = as_judged(Path(logs_folder) / f"{shown['log']}.parquet", folder)
            record_jump(
                out / f"diagnosis_{kind}.rrd",
                jump,
                robot,
                ghosts_of(jump, folder),
                title=f"diagnosis of {kind} {jump.name}",
                says=shown["sentence"],
            )
        yield describe_recordings(f"diagnosis_{kind}", folder, int(path.exists()), 1)
    for kind, folder, of_jumps in (
        ("simulated", view.predictions_simulated, view.simulated),
        ("published", view.predictions_published, view.published),
    ):
        if of_jumps is None:
            continue
        tables = logs_in(Path(folder))
        for path in islice(tables, view.most_predictions):
            log = Path(of_jumps) / path.name
            if not log.is_file():
                do = "predict jumps of that folder again"
                raise InputError(path, f"no jump log {log}", "a log of the same name", do)
            jump = read_log(log)
            record_prediction(
                out / f"prediction_{kind}_{jump.name}.rrd",
                jump,
                robot,
                path,
                title=f"predictions of {kind} {jump.name}",
                shown=view.models or None,
            )
        yield describe_recordings(f"prediction_{kind}", folder, len(tables), view.most_predictions)
    if view.landings is None:
        return
    found = comparison_logs(Path(view.landings), view.landing_methods)
    for task, logs in islice(found.items(), view.most_landings):
        record_comparison(out / f"landing_{task}.rrd", task, logs, robot)
    yield describe_recordings("landing", view.landings, len(found), view.most_landings)


def logs_in(folder: Path) -> list[Path]:
    """Parquet files of a folder, sorted by name; none where the folder does not exist."""
    return sorted(folder.glob("*.parquet"))


def as_judged(path: Path, replays: str | None) -> Log:
    """The jump of a file, by its own clock where a folder of replays has it so: its ghosts are by that clock."""
    judged = None if replays is None else Path(replays) / JUDGED / path.name
    return read_log(judged if judged is not None and judged.is_file() else path)


def ghosts_of(jump: Log, replays: str | None) -> dict[str, Log]:
    """The simulated versions of a jump that a folder of replays has."""
    if replays is None:
        return {}
    found = {name: Path(replays) / kind / f"{jump.name}.parquet" for kind, name in GHOSTS.items()}
    return {name: read_log(path) for name, path in found.items() if path.is_file()}


def describe_recordings(kind: str, folder: str, there: int, most: int) -> str:
    """One line on a kind of recording: how many were written, skipped or left out."""
    if not there:
        return f"{kind}: nothing in {folder}, skipped"
    left = f", {there - most} more not shown" if there > most else ""
    return f"{kind}: {min(there, most)} from {folder}{left}"
