"""The report of a diagnosis as one HTML page: self-contained, interactive, without network."""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from leapgap.diagnosis.best_simulator import BestNumber
from leapgap.diagnosis.channels import BASE_TURNS, is_logged, logged_values
from leapgap.diagnosis.localisation import Place, phase_names
from leapgap.diagnosis.next_experiment import in_noises
from leapgap.diagnosis.report import Cause, ReportContent
from leapgap.diagnosis.summary import brief
from leapgap.effects import effect_words, parameter_words, sentence_words
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.reports import diagnosis_figures as show
from leapgap.reports.channels_data import channel_title, channel_words, channels_data, unit_of
from leapgap.reports.page import embed_json, render_page
from leapgap.robot.model import Robot
from leapgap.robot.picture import Loop

if TYPE_CHECKING:
    from leapgap.reports.viewer import EmbeddedViewer

LEAST_CM = 0.5  # errors of where a robot lands that are told, cm
LEAST = 1e-9  # smallest number that is told; what is physical is in SI units
TIMELINE = "time"  # timeline of the recordings; ``recorder.TIMELINE``, which imports Rerun


def html(
    report: ReportContent,
    logs: Sequence[Log],
    robot: Robot,
    nominal: Mapping[str, Log],
    corrected: Mapping[str, Log],
    viewer: EmbeddedViewer | None = None,
    replayable: bool = True,
    picture: bytes | None = None,
    loop: Loop | None = None,
    correction: tuple[Effect, ...] = (),
) -> str:
    """The page as HTML text; equal reports give equal bytes. ``viewer`` is put inside, beside the plots.

    ``replayable``: whether leapgap takes the folder ``corrected`` beside the page as a robot. ``picture``:
    a PNG of the robot; ``loop``: one of its motion; ``correction``: the effects that ``corrected`` was made with.
    """
    figures = {
        "map": show.gap_map(report, robot, phase_names(logs)),
        "closure": show.closures(report),
        "logs": show.gap_per_log(report),
    }
    if len(report.horizons) > 1:
        figures["horizons"] = show.horizons(report)
    config = report.provenance.config
    lengths = {name: config[name] for name in ("horizon_s", "every_s") if name in config}
    alike = show.similarity(report.causes, logs, robot, **lengths)
    if alike is not None:
        figures["similarity"] = show.similarities(alike)
    if report.residual_force:
        log = next(one for one in logs if one.name == report.median_log)
        course = show.residual_force(log, robot, [(), correction] if report.answer else [()])
        units = {one.at: one.unit for one in report.residual_force}
        if course is not None:
            of_joints = robot.joints, [units.get(one, "N·m") for one in robot.joints]
            figures |= {
                "force": show.residual_figure(course, *of_joints),
                "by_state": show.state_figure(course, *of_joints),
            }
    channels = channels_data(report, logs, robot, nominal, corrected if report.answer else None)
    kind = "jump" if report.headline.preset == "jump" else "base" if robot.has_free_base else "fixed"
    return render_page(
        Path(__file__).with_name("report.html"),
        figures,
        report=report,
        loudest=loudest(report.where)[:6],
        words=channel_words,
        sentence=sentence_words(report.sentence),
        next_sentence=next_words(report),
        sentence_words=sentence_words,
        effect_words=effect_words,
        parameter_words=parameter_words,
        title=channel_title,
        kind=kind,
        brief=brief,
        number=number,
        split_numbers=split_numbers,
        in_noises=in_noises,
        fitted=partial(fitted_value, report.causes[: len(report.answer)]),
        tiles=tiles(report, logs, nominal, corrected),
        viewer=viewer,
        replayable=replayable,
        picture=None if picture is None else b64encode(picture).decode(),
        loop=None if loop is None else {**asdict(loop), "png": b64encode(loop.png).decode()},
        timeline=TIMELINE,
        channels=embed_json(json.dumps(channels, separators=(",", ":"), ensure_ascii=False), channels="all"),
        segments=[segment.name for segment in logs[0].info.segments],
        judged_until=max(log.time[-1] for log in logs),
    )


def next_words(report: ReportContent) -> str:
    """The sentence on the next experiment without names of code; empty where none is proposed."""
    if report.next_experiment is None:
        return ""
    sentence = sentence_words(report.next_experiment["sentence"])
    for one in report.next_experiment["expected"]:
        if "number" in one:
            parameter = one["number"].partition(".")[2]
            sentence = sentence.replace(f"is {parameter} of", f"is {parameter_words(parameter)} of")
        if channel := one.get("channel"):
            sentence = sentence.replace(channel, channel_words(channel))
    return sentence


def number(value: float) -> str:
    """Three digits of a number; what rounding leaves of nothing is 0."""
    return f"{value if abs(value) >= LEAST else 0.0:.3g}"


def loudest(places: Sequence[Place]) -> list[Place]:
    """Places in their order, one of each two whose channels of left and right these logs do not separate."""
    kept: list[Place] = []
    for place in places:
        if not any((one.phase, one.as_one_with) == (place.phase, place.channel) for one in kept):
            kept.append(place)
    return kept


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
    # The channel with the largest share of the gap that all logs have, a position where there is one
    channels = [place.channel for place in report.where if all(is_logged(log, place.channel) for log in logs)]
    positions = [one for one in channels if one.startswith(POSITIONS)]
    channel = next(iter([*positions, *channels]), None)
    if channel is not None:
        unit = unit_of(channel)
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
        if max(off) >= LEAST_CM:
            found.append(Tile(f"{off[0]:.1f}", f"{off[1]:.1f}" if answered else "", "cm", says))
    gap = brief(report.gap_corrected) if answered else ""
    says = f"gap: error over channel size, rms of all channels (sensor noise alone: about {brief(report.noise_floor)})"
    found.append(Tile(brief(report.gap_nominal), gap, "", says))
    seconds = sum(float(log.time[-1]) for log in logs)
    found.append(Tile(str(len(logs)), "", "logs", f"{seconds:.3g} s of motion"))
    return found


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
