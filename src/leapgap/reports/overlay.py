"""Figure of a few channels: each log beside its nominal and its corrected replay.

Plotly is imported where the figure is drawn, so that ``import leapgap`` stays fast.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from leapgap.diagnosis.channels import JUMP, is_logged, logged_values
from leapgap.diagnosis.report import ReportContent
from leapgap.logs.log import Log
from leapgap.reports.channel_names import channel_title
from leapgap.reports.colours import CORRECTED, GREY, NOMINAL, REAL

if TYPE_CHECKING:
    import plotly.graph_objects as go

OVERLAID = 6
"""Number of channels whose curves are drawn, where the headline does not name them."""
SHOWN_EVERY_S = 0.004
"""Interval between drawn points: the page stays small and the curves look smooth."""


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
    first = report.median_log
    lines = {log.name: segment_lines(log, len(channels)) for log in logs}
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
            "args": [{"visible": [owner == log.name for owner in owners]}, {"shapes": lines[log.name]}],
        }
        for log in logs
    ]
    height = 280 * rows if rows > 1 else 340
    plotted = height - 95 - 40  # without the margins; what stands above is placed in shares of it
    figure.update_layout(
        shapes=lines[first],
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


def segment_lines(log: Log, plots: int) -> list[dict[str, Any]]:
    """Dotted lines where the segments of a log begin, in each of some plots; logs may begin theirs at other times."""
    line = {"color": GREY, "width": 1, "dash": "dot"}
    begins = [segment.begin_s for segment in log.info.segments if 0 < segment.begin_s < log.time[-1]]
    axes = ["", *map(str, range(2, plots + 1))]
    return [
        {"type": "line", "x0": at, "x1": at, "y0": 0, "y1": 1, "xref": f"x{n}", "yref": f"y{n} domain", "line": line}
        for at in begins
        for n in axes[:plots]
    ]


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


def overlay_channels(report: ReportContent, logs: Sequence[Log]) -> list[str]:
    """Channels of the overlay: those of the headline of jumps; else the channels with the largest gap."""
    if report.headline.preset == "jump":
        return [name for name in JUMP if all(is_logged(log, name) for log in logs)]
    return list(dict.fromkeys(place.channel for place in report.where))[:OVERLAID]
