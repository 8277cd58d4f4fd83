"""Learned models as one HTML page: errors, learning curves, roll-outs, calibration."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from leapgap.jumping.learning import evaluation, store, window_extraction, windows
from leapgap.jumping.learning.evaluation import MEASURED, HeldOutPredictions, RollOut
from leapgap.jumping.learning.store import find_recipe
from leapgap.logs.log import read_logs
from leapgap.reports.page import render_page
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json, write_metrics, write_text
from leapgap.runtime.output_folder import whole_folder

COMPONENTS = {
    "x": "forward x, m",
    "z": "height z, m",
    "pitch": "pitch (nose down), rad",
    "vx": "forward velocity, m/s",
    "vz": "vertical velocity, m/s",
    "pitch_rate": "pitch rate, rad/s",
}
MEASURED_COLOUR = "#111827"
DASHES = {"variable": "solid", "fixed": "dash"}


def html(
    figures: Mapping[str, Any],
    seconds: Mapping[str, float],
    about: Mapping[str, Any],
    curves: Path,
    predictions: Path,
    roll_outs: Mapping[str, RollOut] | None,
) -> str:
    """The page of one set of jumps.

    ``figures``: the metrics file; ``seconds`` of fitting by model; ``about``: windows.json; ``curves``: the CSV of
    losses; ``predictions``: folder of error_by_step.csv and calibration.csv; ``roll_outs`` by name, from 650 ms on.
    """

    drawn = {
        "errors": errors_by_step(read_rows(predictions / "error_by_step.csv")),
        "curves": learning_curves(read_rows(curves)),
    }
    if figures.get("coverage"):
        drawn["calibration"] = calibration(read_rows(predictions / "calibration.csv"))
    if roll_outs:
        drawn["roll_outs"] = roll_out(roll_outs, about["jumps"])
    names = sorted(figures["cv_mse"], key=lambda name: -figures["cv_mse"][name])
    labels = {name: find_recipe(name, "metrics, cv_mse").label for name in names}
    return render_page(
        Path(__file__).with_name("learning.html"),
        drawn,
        metrics=figures,
        models=names,
        labels=labels,
        best=find_recipe(names[-1], "metrics, cv_mse"),
        seconds=seconds,
        about=about,
        components=COMPONENTS,
    )


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file, by the names of its columns."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def colour_of(model: str) -> str:
    """The colour of a model in all figures, or of what was measured."""
    return MEASURED_COLOUR if model == MEASURED else find_recipe(model, "figures of learned models").colour


def six_panels() -> go.Figure:
    """An empty figure with one panel for each component of the state."""
    titles = list(COMPONENTS.values())
    return make_subplots(rows=2, cols=3, subplot_titles=titles, horizontal_spacing=0.06, vertical_spacing=0.14)


def add(
    figure: go.Figure, panel: int, x: Sequence | np.ndarray, y: Sequence | np.ndarray, name: str, **style: Any
) -> None:
    """Add a line to a panel; its legend entry appears once."""
    style.setdefault("line", {"color": colour_of(name.split("/")[0]), "width": 2})
    figure.add_trace(
        go.Scatter(
            x=x, y=y, name=name.replace("_", " "), legendgroup=name, showlegend=panel == 0, mode="lines", **style
        ),
        row=panel // 3 + 1,
        col=panel % 3 + 1,
    )


def errors_by_step(rows: Sequence[Mapping[str, str]]) -> go.Figure:
    """Root mean square error on held-out jumps over the steps of the horizon."""
    figure = six_panels()
    models = [
        m for m in dict.fromkeys(row["model"] for row in rows) if find_recipe(m, "error_by_step.csv").shown_by_step
    ]
    for panel, component in enumerate(COMPONENTS):
        for model in models:
            mine = [row for row in rows if row["model"] == model and row["component"] == component]
            add(figure, panel, [int(row["step"]) for row in mine], [float(row["rms"]) for row in mine], model)
    figure.update_layout(height=600, margin={"l": 45, "r": 15, "t": 110, "b": 40}, legend=above(1.25))
    figure.update_xaxes(title_text="step of the horizon", row=2)
    figure.update_yaxes(rangemode="tozero")
    return figure


def learning_curves(rows: Sequence[Mapping[str, str]]) -> go.Figure:
    """Mean squared error on training and held-out jumps, mean of the folds."""
    figure = go.Figure()
    folds = [row for row in rows if row["split"].startswith("fold")]
    for model in dict.fromkeys(row["model"] for row in folds):
        for column, label, dash in (("train_loss", "trained on", "dot"), ("validation_loss", "held out", "solid")):
            by_step: dict[int, list[float]] = {}
            for row in folds:
                if row["model"] == model and row[column]:
                    by_step.setdefault(int(row["step"]), []).append(float(row[column]))
            figure.add_trace(
                go.Scatter(
                    x=list(by_step),
                    y=[float(np.mean(values)) for values in by_step.values()],
                    name=f"{find_recipe(model, 'curves.csv').label}, {label}",
                    line={"color": colour_of(model), "dash": dash, "width": 2},
                    mode="lines+markers",
                )
            )
    figure.update_layout(height=400, margin={"l": 55, "r": 15, "t": 20, "b": 45})
    figure.update_xaxes(title_text="step of the optimiser")
    figure.update_yaxes(type="log", title_text="mean squared error")
    return figure


def calibration(rows: Sequence[Mapping[str, str]]) -> go.Figure:
    """Share of held-out states inside the predicted intervals, over their nominal level."""
    figure = go.Figure()
    figure.add_trace(
        go.Scatter(x=[0, 100], y=[0, 100], name="perfect", line={"color": "#8a93a3", "dash": "dot"}, mode="lines")
    )
    for model in dict.fromkeys(row["model"] for row in rows):
        mine = [row for row in rows if row["model"] == model and row["component"] == "all"]
        figure.add_trace(
            go.Scatter(
                x=[100 * float(row["nominal"]) for row in mine],
                y=[100 * float(row["observed"]) for row in mine],
                name=find_recipe(model, "calibration.csv").label,
                line={"color": colour_of(model), "width": 2},
                mode="lines",
            )
        )
    figure.update_layout(height=420, width=620, margin={"l": 55, "r": 15, "t": 20, "b": 45})
    figure.update_xaxes(title_text="nominal level of the interval, %", range=[0, 100])
    figure.update_yaxes(title_text="held-out states inside, %", range=[0, 100])
    return figure


def roll_out(found: Mapping[str, RollOut], jumps: Sequence[str]) -> go.Figure:
    """Predictions from 650 ms on, of one held-out jump after another."""
    figure, owners = six_panels(), []
    for number in range(len(jumps)):
        for panel in range(len(COMPONENTS)):
            for name, one in found.items():
                model, _, steps = name.partition("/")
                line = {"color": colour_of(model), "width": 2, "dash": DASHES.get(steps, "dot")}
                if name == "measured":
                    line |= {"width": 3, "dash": "solid"}
                values = np.round(one.states[number, :, panel], 4)
                add(figure, panel, np.round(one.time_s, 4), values, name, line=line, visible=number == 0)
                owners.append(number)
    buttons = [
        {"label": jump, "method": "update", "args": [{"visible": [owner == number for owner in owners]}]}
        for number, jump in enumerate(jumps)
    ]
    menu = {"buttons": buttons, "x": 0, "xanchor": "left", "y": 1.34, "yanchor": "top"}
    figure.update_layout(
        height=680, margin={"l": 45, "r": 15, "t": 165, "b": 40}, legend=above(1.36, 0.12), updatemenus=[menu]
    )
    figure.update_xaxes(title_text="s", row=2)
    return figure


def above(y: float, x: float = 0.0) -> dict[str, Any]:
    """Layout of a horizontal legend above the panels, at figure coordinates (x, y)."""
    return {"orientation": "h", "y": y, "x": x}


METRICS = "learning.json"


@dataclass
class EvaluateSettings:
    """Section ``evaluate`` of the configuration: models, windows and output files."""

    models: str
    windows: str
    fixed_models: str | None = None
    fixed_windows: str | None = None
    metrics: str | None = None
    timing: str | None = None
    logs: str | None = None
    out: str | None = None

    @property
    def inputs(self) -> tuple[str | None, ...]:
        """Folders that are read."""
        return self.models, self.windows, self.fixed_models, self.fixed_windows, self.logs


def evaluate_held_out(settings: EvaluateSettings, out: Path, by: str) -> dict[str, float] | None:
    """Write metrics and predictions of the jumps that models did not see; cross-validated errors by model.

    ``by``: the command that writes. Without logs a note says so, and metrics that are there already are kept.
    """
    models, extracted = Path(settings.models), windows.read(Path(settings.windows))
    metrics = Path(settings.metrics) if settings.metrics else out / METRICS
    if not len(extracted):
        with whole_folder(out, by) as folder:
            write_json(folder / "note.json", {"note": "no logs: nothing was predicted"})
            if not settings.metrics:
                write_json(folder / METRICS, {"jumps": 0})
        print(f"no logs: {metrics} kept" if settings.metrics and metrics.exists() else f"no logs: {metrics} says so")
        if not metrics.exists():
            write_json(metrics, {"jumps": 0})
        return None
    folds, sessions = (evaluation.predict_held_out(extracted, models, prefix) for prefix in ("fold", "session"))
    figures = evaluation.metrics(folds, sessions, extracted)
    roll_outs = None if folds is None else compare_time_grids(folds, settings)
    if roll_outs is not None:
        figures["landing_rms"] = evaluation.landing_rms(roll_outs)
    with whole_folder(out, by) as folder:
        if folds is None:
            write_json(folder / "note.json", {"note": "one jump: none could be held out"})
        else:
            evaluation.write_predictions(folds, folder)
            evaluation.write_tables(folds, folder)
            seconds = read_json(Path(settings.timing))["fit_seconds"] if settings.timing else {}
            about = read_json(Path(settings.windows) / "windows.json")
            text = html(figures, seconds, about, models / "curves.csv", folder, roll_outs)
            write_text(folder / "report.html", text)
        if not settings.metrics:
            write_json(folder / METRICS, figures)
    if settings.metrics:
        write_metrics(metrics, figures)
    print(f"{len(extracted)} windows of {len(extracted.jumps)} jumps predicted -> {metrics}, {out}")
    errors: Any = figures.get("cv_mse")
    return {name: float(value) for name, value in errors.items()} if isinstance(errors, dict) else None


def compare_time_grids(folds: HeldOutPredictions, settings: EvaluateSettings) -> dict[str, RollOut] | None:
    """Roll-outs from 650 ms on variable and on fixed steps; None without models of fixed steps."""
    if settings.fixed_models is None or settings.fixed_windows is None:
        return None
    of_fixed, models = windows.read(Path(settings.fixed_windows)), Path(settings.fixed_models)
    fixed = evaluation.predict_held_out(of_fixed, models, "fold")
    return None if fixed is None else evaluation.compare(folds, fixed)


def evaluate_logs(settings: EvaluateSettings, robot: Robot, out: Path, by: str) -> None:
    """Evaluate the models trained on all jumps on other logs; warn about jumps that they were trained on."""
    models, logs = Path(settings.models), Path(str(settings.logs))
    name = read_json(models / "splits.json")["all"]["models"][0]
    model = store.load(models / "all", name)
    extracted = window_extraction.cut(read_logs(logs), model.purpose.grid, robot)
    mse = evaluation.errors_on_other_jumps(extracted, models) if len(extracted) else {}
    with whole_folder(out, by) as folder:
        write_json(folder / METRICS, {"jumps": len(extracted.jumps), "windows": len(extracted), "mse": mse})
    seen = set(extracted.jumps) & set(model.trained_on)
    if seen:
        print(f"{len(seen)} of these jumps bear names of jumps the models were trained on: no test of them")
    print(f"{len(extracted.jumps)} jumps judged -> {out / METRICS}" if mse else f"no logs in {logs}")
