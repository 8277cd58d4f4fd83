"""Learned models as one HTML page: errors, learning curves, roll-outs, calibration."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from leapgap.jumping.learning.evaluation import MEASURED
from leapgap.jumping.learning.registry import find_recipe
from leapgap.jumping.learning.time_grid_comparison import RollOut
from leapgap.reports.page import render_page

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


def six_panels(vertical_spacing: float = 0.14) -> go.Figure:
    """An empty figure with one panel for each component of the state."""
    return make_subplots(
        rows=2,
        cols=3,
        subplot_titles=list(COMPONENTS.values()),
        horizontal_spacing=0.06,
        vertical_spacing=vertical_spacing,
    )


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
