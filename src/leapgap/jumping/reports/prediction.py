"""Predictions of learned and nominal models beside the measured jump, as a Rerun recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr
import rerun.blueprint as rrb

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.reports.log_recording import add_panels, log_notes, overview, plot
from leapgap.reports.plots import COMPONENTS, Curve, components, log_phases, log_plot
from leapgap.reports.scene import WORLD, log_scene
from leapgap.reports.shown_robot import GHOSTS, Colour, Recorder, ShownRobot, recording, shown_robots
from leapgap.robot.model import Robot

TRUTH = "measured"
COLUMNS = ("model", "window", "step", "time", *(part.key for part in COMPONENTS))
SHOWN_WINDOW_S = 0.65
"""Start of the roll-out that is plotted, s: the rear feet push, before the flight."""
MORE_COLOURS: tuple[Colour, ...] = ((160, 160, 160), (200, 170, 90), (150, 200, 90))


@dataclass(frozen=True)
class ShownPrediction:
    """Prediction of one model from the start of one window on."""

    time: np.ndarray
    """Times of the steps, s, (steps,)."""
    values: Mapping[str, np.ndarray]
    """Predicted absolute values by ``Component.key``, (steps,) each."""

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
    colours = dict(zip(models, palette(len(models)), strict=True))
    title = title or f"predictions of {jump.name}"
    with recording(path, title, prediction_blueprint(actors)) as to:
        log_scene(to, actors)
        log_phases(to, actors[0])
        for name in models:
            log_predicted_ways(to, actors[0], name, by_model[name], colours[name])
        log_predicted_base(to, actors[0], by_model, colours, window_start_s)
        log_notes(to, actors, title)


def palette(count: int) -> list[Colour]:
    """``count`` colours; they repeat where there are more than colours to choose from."""
    every_colour = (*GHOSTS, *MORE_COLOURS)
    return [every_colour[i % len(every_colour)] for i in range(count)]


def log_predicted_ways(
    to: Recorder, actor: ShownRobot, model: str, roll_outs: Sequence[ShownPrediction], colour: Colour
) -> None:
    """Log each predicted path of the base at the time of its prediction, with the measured y."""
    entity = f"{WORLD}/predicted/{model}"
    to.static(entity, rr.LineStrips3D.from_fields(colors=[colour], radii=[0.006]))
    aside = actor.jump["base_pos_y"] if "base_pos_y" in actor.jump else np.zeros(len(actor.jump))
    first_of = {roll_out.start_s: roll_out for roll_out in roll_outs}
    strips = [
        np.stack([r.values["x"], np.interp(r.time, actor.jump.time, aside), r.values["z"]], axis=-1).astype(np.float32)
        for r in first_of.values()
    ]
    to.over_time(entity, np.array(list(first_of)), rr.LineStrips3D.columns(strips=strips))


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
            log_plot(
                to,
                f"base/{part.key}/{TRUTH}",
                time,
                [Curve(TRUTH, actor.colour, part.of(actor.jump))],
                width=2.5,
            )
        for model, colour in colours.items():
            shown = min(by_model[model], key=lambda roll_out: abs(roll_out.start_s - window_start_s))
            curve = Curve(model, colour, shown.values[part.key])
            log_plot(to, f"base/{part.key}/{model}", shown.time, [curve])


def prediction_blueprint(actors: Sequence[ShownRobot]) -> rrb.Blueprint:
    """Layout of the recording: scene on the left, six components on the right, phases below."""
    views = [plot(f"base/{part.key}", part.label, legend=part is COMPONENTS[0]) for part in COMPONENTS]
    plots = rrb.Grid(*views, grid_columns=2, name="Base, predicted from one window on")
    notes = rrb.TextDocumentView(origin="notes", name="Notes")
    return add_panels(rrb.Tabs(overview(actors, plots), notes, active_tab=0))
