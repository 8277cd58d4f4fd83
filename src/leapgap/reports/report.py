"""The report of a diagnosis as one HTML page: self-contained, interactive, without network.

Plotly is imported where a figure is drawn, so that ``import leapgap`` stays fast.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from leapgap.diagnosis.best_simulator import BestNumber
from leapgap.diagnosis.channels import JUMP, is_logged, logged_values
from leapgap.diagnosis.localisation import phase_names
from leapgap.diagnosis.next_experiment import in_noises
from leapgap.diagnosis.report import Cause, ReportContent
from leapgap.diagnosis.summary import brief
from leapgap.logs.log import Log
from leapgap.logs.schema import QUANTITIES, quantity_of
from leapgap.reports.channels_data import channels_data
from leapgap.reports.page import embed_json, render_page
from leapgap.reports.similarity import Similarity, similarity
from leapgap.robot.model import Robot

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from leapgap.reports.viewer import EmbeddedViewer

TIMELINE = "time"
"""Timeline of the recordings; ``recorder.TIMELINE``, which imports Rerun."""

REAL, NOMINAL, CORRECTED = "#111827", "#e2542f", "#2563c9"
GREY = "#8a93a3"
LABELS = {
    "base_pos_x": "forward x",
    "base_pos_y": "sideways y",
    "base_pos_z": "height z",
    "base_roll": "roll",
    "base_pitch": "pitch (nose down)",
    "base_yaw": "yaw",
    "base_linvel_x": "forward velocity",
    "base_linvel_y": "sideways velocity",
    "base_linvel_z": "vertical velocity",
    "base_angvel_x": "roll rate",
    "base_angvel_y": "pitch rate",
    "base_angvel_z": "yaw rate",
    "imu_acc_x": "acceleration x of the IMU",
    "imu_acc_y": "acceleration y of the IMU",
    "imu_acc_z": "acceleration z of the IMU",
}
JOINT_WORDS = {"joint_pos": "position", "joint_vel": "velocity", "foot_force": "force"}
HALF_OF_CHI2_95 = 1.92
"""Loss of log likelihood at the end of a parameter's 95 % interval, for errors that are noise alone."""
OVERLAID = 6
"""Number of channels whose curves are drawn, where the headline does not name them."""
CHANNELS_A_ROW, MOST_POINTS = 4, 300
"""Plots in a row where all channels are drawn, and the largest number of points of a curve there."""
SHOWN_EVERY_S = 0.004
"""Interval between drawn points: the page stays small and the curves look smooth."""


def html(
    report: ReportContent,
    logs: Sequence[Log],
    robot: Robot,
    nominal: Mapping[str, Log],
    corrected: Mapping[str, Log],
    viewer: EmbeddedViewer | None = None,
) -> str:
    """The page as HTML text; equal reports give equal bytes. ``viewer`` is put inside, beside the plots."""
    figures = {
        "map": gap_map(report, robot, phase_names(logs)),
        "overlay": overlay(report, logs, nominal, corrected),
        "horizons": horizons(report),
        "closure": closures(report),
        "profiles": profiles(report),
        "logs": gap_per_log(report),
    }
    config = report.provenance.config
    lengths = {name: config[name] for name in ("horizon_s", "every_s") if name in config}
    alike = similarity(report.causes, logs, robot, **lengths)
    if alike is not None:
        figures["similarity"] = similarities(alike)
    channels = channels_data(
        logs, robot, nominal, corrected if report.answer else None, report.median_log, channel_title
    )
    return render_page(
        Path(__file__).with_name("report.html"),
        figures,
        report=report,
        loudest=list(report.where[:6]),
        words=channel_words,
        title=channel_title,
        kind=kind_of(report, robot),
        brief=brief,
        split_numbers=split_numbers,
        in_noises=in_noises,
        fitted=partial(fitted_value, report.causes[: len(report.answer)]),
        number_of_logs=len(logs),
        viewer=viewer,
        timeline=TIMELINE,
        channels=embed_json(json.dumps(channels, separators=(",", ":"), ensure_ascii=False), channels="all"),
        segments=[segment.name for segment in logs[0].info.segments],
        judged_until=max(log.time[-1] for log in logs),
    )


def fitted_value(causes: Sequence[Cause], quantity: str) -> str:
    """What the answer has for a number that evidence tells, ``<effect>.<parameter>``; a dash where it has none."""
    effect, _, parameter = quantity.partition(".")
    own = (cause.parameters[parameter] for cause in causes if cause.effect == effect and parameter in cause.parameters)
    found = next(own, None)
    return "–" if found is None else f"{found.value:.4g} {found.unit}"


def split_numbers(numbers: Sequence[BestNumber]) -> tuple[list[BestNumber], list[BestNumber]]:
    """Numbers of the best simulator to show, those to believe first, and those whose interval holds nominal."""
    hidden = [one for one in numbers if one.ci95[0] <= one.nominal <= one.ci95[1]]
    shown = sorted((one for one in numbers if one not in hidden), key=lambda one: not one.believed)
    return shown, hidden


def gap_map(report: ReportContent, robot: Robot, phases: Sequence[str]) -> go.Figure:
    """Share of the squared gap by phase, in the order given, and channel; joints summed over the legs of a pair."""
    import plotly.graph_objects as go

    phases = list(dict.fromkeys([*phases, *(place.phase for place in report.where)]))
    rows: dict[str, np.ndarray] = {}
    ends: dict[str, np.ndarray] = {}
    for place in report.where:
        row, column = row_of(place.channel, robot), phases.index(place.phase)
        rows.setdefault(row, np.zeros(len(phases)))[column] += place.share
        ends.setdefault(row, np.zeros((len(phases), 2)))[column] += place.share_ci95
    order = [
        *(label for label in LABELS.values() if label in rows),
        *sorted(set(rows) - set(LABELS.values())),
    ]
    shown = [p for p, _ in enumerate(phases) if any(rows[name][p] for name in order)]
    values = 100 * np.array([[rows[name][p] for p in shown] for name in order])
    figure = go.Figure(
        go.Heatmap(
            z=values,
            x=[phases[p].replace("_", " ") for p in shown],
            y=order,
            colorscale="OrRd",
            zmin=0,
            text=np.vectorize(lambda v: f"{v:.1f}" if v >= 0.05 else "")(values),
            texttemplate="%{text}",
            customdata=100 * np.array([[np.minimum(ends[name][p], 1.0) for p in shown] for name in order]),
            hovertemplate="%{y}, %{x}: %{z:.1f} % of the gap, at most from %{customdata[0]:.1f} to %{customdata[1]:.1f}"
            "<extra></extra>",
            colorbar={"title": "%"},
            xgap=2,
            ygap=2,
        )
    )
    figure.update_layout(height=90 + 27 * len(order), margin={"l": 180, "r": 20, "t": 30, "b": 20})
    figure.update_xaxes(side="top")
    figure.update_yaxes(autorange="reversed")
    return figure


def row_of(channel: str, robot: Robot) -> str:
    """Label of a channel's row in the map, such as ``forward x`` or ``rear calf velocity``.

    A joint channel is named by the pair of its leg, its joint group and its quantity. Where the legs are not two pairs,
    the name of the limb stands in place of the pair.
    """
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    what = JOINT_WORDS[quantity]
    if quantity == "foot_force":
        return f"{joint} foot {what}"
    group = next((name for name, alike in robot.topology.groups.items() if joint in alike), None)
    if group is None:
        return f"{joint} {what}"
    limb = robot.limb_of(joint)
    pair = next((name for name, limbs in robot.limbs_of_pair.items() if limb in limbs), limb)
    return f"{pair} {group} {what}"


def overlay(
    report: ReportContent, logs: Sequence[Log], nominal: Mapping[str, Log], corrected: Mapping[str, Log]
) -> go.Figure:
    """Log, nominal and corrected replay of one log after another, chosen from a list."""
    from plotly.subplots import make_subplots

    channels = overlay_channels(report, logs)
    rows = math.ceil(len(channels) / 3)
    figure = make_subplots(
        rows=rows,
        cols=3,
        subplot_titles=[channel_title(c) for c in channels],
        horizontal_spacing=0.06,
        vertical_spacing=0.14,
    )
    line = {"color": GREY, "width": 1, "dash": "dot"}
    for segment in logs[0].info.segments:
        if 0 < segment.begin_s < logs[0].time[-1]:
            for c in range(len(channels)):  # before the curves: asking which plots are empty takes longer than all else
                figure.add_vline(segment.begin_s, c // 3 + 1, c % 3 + 1, exclude_empty_subplots=False, line=line)
    first = report.median_log
    owners: list[str] = []
    for log in logs:
        for c, channel in enumerate(channels):
            for curve in curves(report, log, channel, nominal, corrected, log.info.rows(SHOWN_EVERY_S)):
                curve.update(showlegend=c == 0, visible=log.name == first)
                figure.add_trace(curve, row=c // 3 + 1, col=c % 3 + 1)
                owners.append(log.name)
    buttons = [
        {
            "label": log.name,
            "method": "update",
            "args": [{"visible": [owner == log.name for owner in owners]}],
        }
        for log in logs
    ]
    height = 280 * rows if rows > 1 else 340
    plotted = height - 95 - 40  # without the margins; what stands above is placed in shares of it
    figure.update_layout(
        height=height,
        margin={"l": 45, "r": 15, "t": 95, "b": 40},
        legend={"orientation": "h", "y": 1 + 81 / plotted, "x": 0.16},
        updatemenus=[
            {
                "buttons": buttons,
                "active": [log.name for log in logs].index(first),
                "x": 0,
                "xanchor": "left",
                "y": 1 + 85 / plotted,
                "yanchor": "top",
            }
        ],
    )
    figure.update_xaxes(title_text="s", row=rows)
    return figure


def curves(
    report: ReportContent,
    log: Log,
    channel: str,
    nominal: Mapping[str, Log],
    corrected: Mapping[str, Log],
    every: int,
) -> list[go.Scatter]:
    """One channel of a log, every so many rows: measured, and of its nominal and, with an answer, corrected replay."""
    import plotly.graph_objects as go

    sources = [("measured", log, REAL, 2.4), ("nominal simulation", nominal[log.name], NOMINAL, 1.6)]
    if report.answer:
        sources.append(("corrected, not fitted on this log", corrected[log.name], CORRECTED, 1.6))
    found = []
    for name, source, colour, width in sources:
        shown = slice(0, min(len(log), len(source)), every)
        found.append(
            go.Scatter(
                x=np.round(source.time[shown], 3),
                y=rounded(logged_values(source, channel)[shown]),
                name=name,
                legendgroup=name,
                line={"color": colour, "width": width},
                mode="lines",
            )
        )
    return found


def rounded(values: np.ndarray) -> np.ndarray:
    """Values to four decimals, and to four digits of the largest: the page stays small and small motions are seen."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    return np.round(values, 4 if largest == 0 else max(4, 4 - math.ceil(math.log10(largest))))


def kind_of(report: ReportContent, robot: Robot) -> str:
    """``jump`` for logs of jumps, ``base`` for others of a robot with a free base, ``fixed`` for one without."""
    if report.headline.preset == "jump":
        return "jump"
    return "base" if robot.has_free_base else "fixed"


def overlay_channels(report: ReportContent, logs: Sequence[Log]) -> list[str]:
    """Channels of the overlay: those of the headline of jumps; else the channels with the largest gap."""
    if report.headline.preset == "jump":
        return [name for name in JUMP if all(is_logged(log, name) for log in logs)]
    return list(dict.fromkeys(place.channel for place in report.where))[:OVERLAID]


def channel_title(channel: str) -> str:
    """Label and unit of a channel, such as ``height z, m`` or ``elbow velocity, rad/s``."""
    if channel in LABELS:
        known = quantity_of(channel)
        return f"{LABELS[channel]}, {known.unit if known else 'rad'}"
    return f"{channel_words(channel)}, {QUANTITIES[channel.partition('/')[0]].unit}"


def channel_words(channel: str) -> str:
    """Label of a channel, such as ``height z`` or ``elbow velocity``."""
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    return f"{joint} {JOINT_WORDS[quantity]}"


def horizons(report: ReportContent) -> go.Figure:
    """The headline gap against the length of the replays: nominal, corrected, and a robot that stays as it was."""
    import plotly.graph_objects as go

    ordered = sorted(report.horizons, key=lambda at: at.horizon_s or math.inf)
    labels = [f"{at.horizon_s:g} s" if at.horizon_s else "whole logs" for at in ordered]
    curves = [("nominal", NOMINAL, "solid", [at.nominal for at in ordered])]
    if report.answer:
        curves.append(("corrected", CORRECTED, "solid", [at.corrected for at in ordered]))
    curves.append(("stays as it was", GREY, "dot", [at.unmoved for at in ordered]))
    figure = go.Figure()
    for name, colour, dash, values in curves:
        line = {"color": colour, "width": 2, "dash": dash}
        figure.add_scatter(x=labels, y=values, name=name, mode="lines+markers", line=line)
    figure.update_layout(
        height=330, margin={"l": 55, "r": 15, "t": 40, "b": 45}, legend={"orientation": "h", "y": 1.18, "x": 0}
    )
    figure.update_xaxes(title_text="replays start anew from the log after", type="category")
    figure.update_yaxes(title_text="gap", type="log")
    return figure


def similarities(alike: Similarity) -> go.Figure:
    """Correlations of what the effects change, as a map."""
    import plotly.graph_objects as go

    values = np.round(alike.correlation, 2)
    figure = go.Figure(
        go.Heatmap(
            z=values,
            x=list(alike.names),
            y=list(alike.names),
            zmin=-1,
            zmax=1,
            colorscale="RdBu_r",
            text=[[f"{value:.2f}" for value in row] for row in values],
            texttemplate="%{text}",
            hovertemplate="%{y} and %{x}: %{z:.2f}<extra></extra>",
            xgap=2,
            ygap=2,
        )
    )
    figure.update_layout(height=130 + 42 * len(alike.names), margin={"l": 170, "r": 20, "t": 20, "b": 90})
    figure.update_yaxes(autorange="reversed")
    return figure


def closures(report: ReportContent) -> go.Figure:
    """Share of the gap that each hypothesis closes on held-out logs, with 95 % intervals.

    Blue are the selected effects, each at the place that was selected. They are the first causes of the report.
    """
    import plotly.graph_objects as go

    causes = sorted(report.causes, key=lambda cause: cause.closure.value)
    selected = {(cause.effect, cause.location) for cause in report.causes[: len(report.answer)]}
    value = 100 * np.array([cause.closure.value for cause in causes])
    figure = go.Figure(
        go.Bar(
            x=value,
            y=[f"{c.effect} ({c.location})" for c in causes],
            orientation="h",
            marker_color=[CORRECTED if (c.effect, c.location) in selected else "#c3cad6" for c in causes],
            error_x={
                "type": "data",
                "symmetric": False,
                "color": "#4b5563",
                "thickness": 1.4,
                "array": 100 * np.array([c.closure.high for c in causes]) - value,
                "arrayminus": value - 100 * np.array([c.closure.low for c in causes]),
            },
            hovertemplate="%{y}: %{x:.0f} %<extra></extra>",
        )
    )
    figure.update_layout(height=80 + 34 * len(causes), margin={"l": 170, "r": 20, "t": 10, "b": 45})
    figure.update_xaxes(title_text="closed on logs not fitted on, % of the gap above noise")
    return figure


def profiles(report: ReportContent) -> go.Figure:
    """Profile likelihood of each hypothesis's parameter: a narrow minimum means that the data determine it well."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    columns = 3
    rows = max(1, -(-len(report.profiles) // columns))
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[p.effect for p in report.profiles],
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
        figure.update_xaxes(title_text=one.label.removesuffix(" (1)"), title_font={"size": 11}, **at)
    figure.add_hline(y=HALF_OF_CHI2_95, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(range=[0, 5 * HALF_OF_CHI2_95])
    figure.update_layout(height=70 + 230 * rows, margin={"l": 45, "r": 15, "t": 35, "b": 45})
    return figure


def gap_per_log(report: ReportContent) -> go.Figure:
    """The headline gap of each log, of the nominal and of the corrected simulation."""
    import plotly.graph_objects as go

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
    figure.update_layout(
        height=300,
        barmode="group",
        margin={"l": 45, "r": 15, "t": 30, "b": 40},
        legend={"orientation": "h", "y": 1.18, "x": 0},
    )
    return figure
