"""Figures of a diagnosis: where the gap is, how far it closes, and how well the numbers are known."""

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.summary import brief
from leapgap.effects import effect_words, label_words, parameter_words
from leapgap.reports.channel_names import LABELS, row_of
from leapgap.reports.colours import CORRECTED, GREY, NOMINAL, REAL
from leapgap.reports.page import heat_map
from leapgap.reports.similarity import Similarity
from leapgap.robot.model import Robot

HALF_OF_CHI2_95 = 1.92
"""Loss of log likelihood at the end of a parameter's 95 % interval, for errors that are noise alone."""


def gap_map(report: ReportContent, robot: Robot, phases: Sequence[str]) -> go.Figure:
    """Share of the squared gap by phase, in the order given, and channel; joints summed over the legs of a pair."""
    phases = list(dict.fromkeys([*phases, *(place.phase for place in report.where)]))
    rows: dict[str, np.ndarray] = {}
    ends: dict[str, np.ndarray] = {}
    for place in report.where:
        row, column = row_of(place.channel, robot), phases.index(place.phase)
        rows.setdefault(row, np.zeros(len(phases)))[column] += place.share
        ends.setdefault(row, np.zeros((len(phases), 2)))[column] += place.share_ci95
    order = [*(label for label in LABELS.values() if label in rows), *sorted(set(rows) - set(LABELS.values()))]
    shown = [p for p, _ in enumerate(phases) if any(rows[name][p] for name in order)] or [*range(len(phases))]
    values = 100 * np.array([[rows[name][p] for p in shown] for name in order])
    intervals = 100 * np.array([[np.minimum(ends[name][p], 1.0) for p in shown] for name in order])
    figure = heat_map(
        values,
        [phases[p].replace("_", " ") for p in shown],
        order,
        [[f"{v:.1f}" if v >= 0.05 else "0" for v in row] for row in values],
        "%{y}, %{x}: %{z:.1f} % of the gap, at most from %{customdata[0]:.1f} to %{customdata[1]:.1f}",
        **{"colorscale": "OrRd", "zmin": 0, "customdata": intervals, "colorbar": {"title": "%"}},
    )
    figure.update_layout(height=90 + 27 * len(order), margin={"l": 180, "r": 20, "t": 30, "b": 20})
    figure.update_xaxes(side="top")
    return figure


def horizons(report: ReportContent) -> go.Figure:
    """The headline gap against the length of the replays: nominal, corrected, and a robot that does not move."""
    ordered = sorted(report.horizons, key=lambda at: at.horizon_s or math.inf)
    labels = [f"{at.horizon_s:g} s" if at.horizon_s else "whole logs" for at in ordered]
    curves = [("nominal", NOMINAL, "solid", [at.nominal for at in ordered])]
    if report.answer:
        curves.append(("corrected", CORRECTED, "solid", [at.corrected for at in ordered]))
    curves.append(("does not move", GREY, "dot", [at.unmoved for at in ordered]))
    figure = go.Figure()
    for name, colour, dash, values in curves:
        line = {"color": colour, "width": 2, "dash": dash}
        figure.add_scatter(x=labels, y=values, name=name, mode="lines+markers", line=line)
    figure.update_layout(
        height=300, margin={"l": 55, "r": 15, "t": 40, "b": 30}, legend={"orientation": "h", "y": 1.18, "x": 0}
    )
    figure.update_xaxes(type="category")
    ticks = round_numbers([value for _, _, _, values in curves for value in values if value > 0])
    figure.update_yaxes(title_text="gap", type="log", tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks])
    return figure


def round_numbers(values: Sequence[float]) -> list[float]:
    """1, 2 and 5 times the powers of ten about some values, or the powers alone where these are many."""
    if not values:
        return []
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    steps = (1, 2, 5) if high - low <= 3 else (1,)
    return [step * 10.0**power for power in range(low, high + 1) for step in steps]


def similarities(alike: Similarity) -> go.Figure:
    """Correlations of what the effects change, as a map."""
    values, names = np.round(alike.correlation, 2), list(alike.names)
    texts = [[f"{value:.2f}" for value in row] for row in values]
    figure = heat_map(values, names, names, texts, "%{y} and %{x}: %{z:.2f}", zmin=-1, zmax=1, colorscale="RdBu_r")
    figure.update_layout(height=100 + 42 * len(names), margin={"l": 170, "r": 20, "t": 20, "b": 40})
    return figure


def closures(report: ReportContent) -> go.Figure:
    """Share of the gap that each hypothesis closes on held-out logs, with 95 % intervals, in the order of the report.

    Blue are the selected effects, each at the place that was selected. They are the first causes of the report.
    """
    causes = report.causes[::-1]
    closed = [cause.closure.capped_at_one for cause in causes]
    selected = {(cause.effect, cause.location) for cause in report.causes[: len(report.answer)]}
    value = 100 * np.array([one.value for one in closed])
    figure = go.Figure(
        go.Bar(
            x=value,
            y=[f"{effect_words(c.effect)} ({c.location})" for c in causes],
            orientation="h",
            marker_color=[CORRECTED if (c.effect, c.location) in selected else "#c3cad6" for c in causes],
            error_x={
                "type": "data",
                "symmetric": False,
                "color": "#4b5563",
                "thickness": 1.4,
                "array": 100 * np.array([one.high for one in closed]) - value,
                "arrayminus": value - 100 * np.array([one.low for one in closed]),
            },
            hovertemplate="%{y}: %{x:.0f} %<extra></extra>",
        )
    )
    figure.update_layout(height=80 + 34 * len(causes), margin={"l": 170, "r": 20, "t": 10, "b": 45})
    figure.update_xaxes(title_text="explained gap, %")
    return figure


def profiles(report: ReportContent) -> go.Figure:
    """Profile likelihood of each hypothesis's parameter: a narrow minimum means that the data determine it well."""
    columns = min(3, len(report.profiles))
    rows = max(1, -(-len(report.profiles) // columns))
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[label_words(p.effect) for p in report.profiles],
        shared_yaxes=True,
        horizontal_spacing=0.05,
        vertical_spacing=0.4 / rows,
    )
    for i, one in enumerate(report.profiles):
        at = {"row": i // columns + 1, "col": i % columns + 1}
        figure.add_trace(
            go.Scatter(
                x=one.values,
                y=one.loss,
                mode="lines+markers",
                showlegend=False,
                line={"color": CORRECTED},
                hovertemplate="%{x:.3g}: %{y:.1f} worse<extra></extra>",
            ),
            **at,
        )
        figure.update_xaxes(title_text=parameter_words(one.label.removesuffix(" (1)")), title_font={"size": 11}, **at)
    figure.add_hline(y=HALF_OF_CHI2_95, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(range=[0, 5 * HALF_OF_CHI2_95])
    figure.update_annotations(font_size=12)
    figure.update_layout(height=70 + 230 * rows, margin={"l": 45, "r": 15, "t": 35, "b": 45})
    return figure


def gap_per_log(report: ReportContent) -> go.Figure:
    """The headline gap of each log, of the nominal and of the corrected simulation."""
    names = list(report.gap_per_log)
    figure = go.Figure()
    shown = [("nominal", "nominal", NOMINAL), ("corrected", "corrected, not fitted on this log", CORRECTED)]
    for key, label, colour in shown if report.answer else shown[:1]:
        gaps = [report.gap_per_log[name][key] for name in names]
        figure.add_bar(
            x=names,
            y=gaps,
            name=label,
            marker_color=colour,
            text=[brief(gap) for gap in gaps],
            textposition="outside",
            cliponaxis=False,
        )
    figure.add_hline(y=report.noise_floor, line={"color": REAL, "dash": "dot", "width": 1})
    labels = 6 * max(map(len, names), default=0) if len(names) > 8 else 0  # many names are turned, below the bars
    figure.update_layout(
        height=300 + labels,
        barmode="group",
        margin={"l": 45, "r": 15, "t": 30, "b": 40},
        legend={"orientation": "h", "y": 1.18, "x": 0},
    )
    return figure
