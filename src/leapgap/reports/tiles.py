"""The figures at the head of a report's page: a value with its unit, and what it is."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import BASE_TURNS, is_logged, logged_values
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.summary import brief
from leapgap.logs.log import Log
from leapgap.logs.schema import QUANTITIES, quantity_of
from leapgap.reports.channel_names import channel_words

POSITIONS = ("joint_pos", "base_pos", *BASE_TURNS)
ANGLES = {"rad": "°", "rad/s": "°/s"}


@dataclass(frozen=True)
class Tile:
    """One figure: nominal and, after an arrow, corrected; or one value."""

    nominal: str
    corrected: str
    unit: str
    says: str


def tiles(
    report: ReportContent, logs: Sequence[Log], nominal: Mapping[str, Log], corrected: Mapping[str, Log]
) -> list[Tile]:
    """The figures, the most telling first."""
    answered, found = bool(report.answer), []
    channel = worst_channel(report, logs)
    if channel is not None:
        unit = "rad" if channel in BASE_TURNS else unit_of(channel)
        factor = math.degrees(1) if unit in ANGLES else 1.0
        own = [factor * rms(logs, replays, channel) for replays in (nominal, corrected)]
        says = f"{channel_words(channel)}, rms error{', corrected on held-out logs' if answered else ''}"
        found.append(Tile(brief(own[0]), brief(own[1]) if answered else "", ANGLES.get(unit, unit), says))
    if report.closure_of_answer is not None and answered:
        closed = report.closure_of_answer.capped_at_one
        share, low, high = (f"{100 * one:.0f}" for one in (closed.value, closed.low, closed.high))
        found.append(Tile(share, "", "%", f"of the gap explained (95 %: {low} to {high} %)"))
    if report.landing_misplaced_m:
        off = [report.landing_off_cm(of) or 0.0 for of in ("nominal", "corrected")]
        says = "error in base x at the last judged sample, mean over logs"
        found.append(Tile(f"{off[0]:.1f}", f"{off[1]:.1f}" if answered else "", "cm", says))
    gap = brief(report.gap_corrected) if answered else ""
    says = f"gap: error over channel size, rms of all channels (sensor noise alone: {brief(report.noise_floor)})"
    found.append(Tile(brief(report.gap_nominal), gap, "", says))
    seconds = sum(float(log.time[-1]) for log in logs)
    found.append(Tile(str(len(logs)), "", "logs", f"{seconds:.3g} s of motion"))
    return found


def worst_channel(report: ReportContent, logs: Sequence[Log]) -> str | None:
    """The channel with the largest share of the gap that all logs have, a position where there is one."""
    channels = [place.channel for place in report.where if all(is_logged(log, place.channel) for log in logs)]
    positions = [one for one in channels if one.startswith(POSITIONS)]
    return next(iter([*positions, *channels]), None)


def unit_of(channel: str) -> str:
    """Unit of a channel of a log."""
    known = quantity_of(channel) or QUANTITIES[channel.partition("/")[0]]
    return known.unit


def rms(logs: Sequence[Log], replays: Mapping[str, Log], channel: str) -> float:
    """Root mean square difference of the logs and their replays in one channel, all rows pooled."""
    squares, rows = 0.0, 0
    for log in logs:
        replay = replays.get(log.name)
        if replay is None or not is_logged(replay, channel):
            continue
        count = min(len(log), len(replay))
        error = logged_values(replay, channel)[:count] - logged_values(log, channel)[:count]
        error = error[np.isfinite(error)]
        squares, rows = squares + float(error @ error), rows + len(error)
    return math.sqrt(squares / rows) if rows else math.nan
