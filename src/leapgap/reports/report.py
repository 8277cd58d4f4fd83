"""The report as one HTML page for a person: self-contained, interactive, no network."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from leapgap.diagnosis.channels import HEADLINE, is_logged, logged
from leapgap.diagnosis.localisation import PHASES
from leapgap.diagnosis.report import ReportContent
from leapgap.logs.log import Log
from leapgap.reports.page import rendered
from leapgap.robot.model import Robot

REAL, NOMINAL, CORRECTED = "#111827", "#e2542f", "#2563c9"
GREY = "#8a93a3"
LABELS = {
    "base_pos_x": "forward x",
    "base_pos_z": "height z",
    "base_pitch": "pitch (nose down)",
    "base_linvel_x": "forward velocity",
    "base_linvel_z": "vertical velocity",
    "base_angvel_y": "pitch rate",
}
UNITS = dict(zip(HEADLINE, ("m", "m", "rad", "m/s", "m/s", "rad/s"), strict=True))
HALF_OF_CHI2_95 = 1.92
"""Log likelihood that a number may lose within its 95 % interval, were there nothing but noise."""
SHOWN_EVERY_S = 0.004
"""A point is drawn so often: the page stays small and the curves smooth."""


def html(
    report: ReportContent, jumps: Sequence[Log], robot: Robot, nominal: Mapping[str, Log], corrected: Mapping[str, Log]
) -> str:
    """The whole page; the same report gives the same bytes."""
    figures = {
        "map": gap_map(report, robot),
        "overlay": overlay(report, jumps, nominal, corrected),
        "closure": closures(report),
        "profiles": profiles(report),
        "logs": gap_per_log(report),
    }
    return rendered(
        Path(__file__).with_name("report.html"),
        figures,
        report=report,
        loudest=list(report.where[:6]),
        labels=LABELS,
        jumps=len(jumps),
        judged_until=max(jump.time[-1] for jump in jumps),
    )


def gap_map(report: ReportContent, robot: Robot) -> go.Figure:
    """Share of the squared gap by phase and channel; joints summed over the legs of a pair."""
    rows: dict[str, np.ndarray] = {}
    for place in report.where:
        rows.setdefault(row_of(place.channel, robot), np.zeros(len(PHASES)))[PHASES.index(place.phase)] += place.share
    order = [
        *(LABELS[name] for name in HEADLINE if LABELS[name] in rows),
        *sorted(set(rows) - set(LABELS.values())),
    ]
    shown = [p for p, _ in enumerate(PHASES) if any(rows[name][p] for name in order)]
    values = 100 * np.array([[rows[name][p] for p in shown] for name in order])
    figure = go.Figure(
        go.Heatmap(
            z=values,
            x=[PHASES[p].replace("_", " ") for p in shown],
            y=order,
            colorscale="OrRd",
            zmin=0,
            text=np.vectorize(lambda v: f"{v:.1f}" if v >= 0.05 else "")(values),
            texttemplate="%{text}",
            hovertemplate="%{y}, %{x}: %{z:.1f} % of the gap<extra></extra>",
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
    """Row of the map: a base channel by its plain name, a joint's by the pair of its leg, joint group and quantity.

    A robot whose legs are not two pairs keeps the names of its limbs.
    """
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    what = {"joint_pos": "position", "joint_vel": "velocity"}[quantity]
    group = next((name for name, alike in robot.topology.groups.items() if joint in alike), None)
    if group is None:
        return f"{joint} {what}"
    limb = robot.limb_of(joint)
    pair = next((name for name, limbs in robot.limbs_of_pair.items() if limb in limbs), limb)
    return f"{pair} {group} {what}"


def overlay(
    report: ReportContent, jumps: Sequence[Log], nominal: Mapping[str, Log], corrected: Mapping[str, Log]
) -> go.Figure:
    """Log, nominal and corrected replay of one jump after another, chosen from a list."""
    from plotly.subplots import make_subplots

    channels = [name for name in HEADLINE if all(is_logged(jump, name) for jump in jumps)]
    figure = make_subplots(
        rows=2,
        cols=3,
        subplot_titles=[f"{LABELS[c]}, {UNITS[c]}" for c in channels],
        horizontal_spacing=0.06,
        vertical_spacing=0.14,
    )
    first = report.median_log
    owners: list[str] = []
    for jump in jumps:
        sources = [("measured", jump, REAL, 2.4), ("nominal simulation", nominal[jump.name], NOMINAL, 1.6)]
        if report.answer:
            sources.append(("corrected, not fitted on this jump", corrected[jump.name], CORRECTED, 1.6))
        for c, channel in enumerate(channels):
            for name, source, colour, width in sources:
                shown = slice(0, min(len(jump), len(source)), jump.info.rows(SHOWN_EVERY_S))
                figure.add_trace(
                    go.Scatter(
                        x=np.round(source.time[shown], 3),
                        y=np.round(logged(source, channel)[shown], 4),
                        name=name,
                        legendgroup=name,
                        showlegend=c == 0,
                        visible=jump.name == first,
                        line={"color": colour, "width": width},
                        mode="lines",
                    ),
                    row=c // 3 + 1,
                    col=c % 3 + 1,
                )
                owners.append(jump.name)
    schedule = jumps[0].info.schedule
    for boundary in (schedule.front_lift_off_s, schedule.take_off_s):
        figure.add_vline(x=boundary, line={"color": GREY, "width": 1, "dash": "dot"})
    buttons = [
        {
            "label": jump.name,
            "method": "update",
            "args": [{"visible": [owner == jump.name for owner in owners]}],
        }
        for jump in jumps
    ]
    figure.update_layout(
        height=560,
        margin={"l": 45, "r": 15, "t": 95, "b": 40},
        legend={"orientation": "h", "y": 1.19, "x": 0.16},
        updatemenus=[
            {
                "buttons": buttons,
                "active": [jump.name for jump in jumps].index(first),
                "x": 0,
                "xanchor": "left",
                "y": 1.2,
                "yanchor": "top",
            }
        ],
    )
    figure.update_xaxes(title_text="s", row=2)
    return figure


def closures(report: ReportContent) -> go.Figure:
    """How much of the gap each hypothesis closes on held-out jumps, alone or on top of what is believed."""
    causes = sorted(report.causes, key=lambda cause: cause.closure.value)
    believed = {name for names in report.answer for name in names[:1]}
    value = 100 * np.array([cause.closure.value for cause in causes])
    figure = go.Figure(
        go.Bar(
            x=value,
            y=[f"{c.effect} ({c.location})" for c in causes],
            orientation="h",
            marker_color=[CORRECTED if c.effect in believed else "#c3cad6" for c in causes],
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
    figure.update_xaxes(title_text="share of the gap above the noise floor that goes away on jumps not fitted on, %")
    return figure


def profiles(report: ReportContent) -> go.Figure:
    """The loss over each hypothesis's own number: a narrow valley is a number the data know."""
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
        figure.update_xaxes(title_text=one.label, title_font={"size": 11}, **at)
    figure.add_hline(y=HALF_OF_CHI2_95, line={"color": GREY, "dash": "dot", "width": 1})
    figure.update_yaxes(range=[0, 5 * HALF_OF_CHI2_95])
    figure.update_layout(height=70 + 230 * rows, margin={"l": 45, "r": 15, "t": 35, "b": 45})
    return figure


def gap_per_log(report: ReportContent) -> go.Figure:
    """The headline gap of each log, before and after."""
    names = list(report.gap_per_log)
    figure = go.Figure()
    shown = [("nominal", "nominal", NOMINAL), ("corrected", "corrected, not fitted on this jump", CORRECTED)]
    for key, label, colour in shown if report.answer else shown[:1]:
        figure.add_bar(x=names, y=[report.gap_per_log[name][key] for name in names], name=label, marker_color=colour)
    figure.add_hline(y=report.noise_floor, line={"color": REAL, "dash": "dot", "width": 1})
    figure.update_layout(
        height=300,
        barmode="group",
        margin={"l": 45, "r": 15, "t": 30, "b": 40},
        legend={"orientation": "h", "y": 1.18, "x": 0},
    )
    return figure
