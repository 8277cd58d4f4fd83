"""Figures of a diagnosis: where the gap is, how far it closes, and how well the numbers are known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from leapgap import effects
from leapgap.diagnosis.horizons import RestartedReplayer
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.report import Cause, ReportContent
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.diagnosis.summary import brief
from leapgap.effects import effect_words
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.reports.channels_data import LABELS, row_of
from leapgap.reports.page import CORRECTED, GREY, NOMINAL, REAL, heat_map
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


@dataclass(frozen=True)
class Similarity:
    """Correlations of the changes by effects."""

    names: tuple[str, ...]  # effects with their places, such as ``viscous friction (elbow)``
    correlation: np.ndarray  # between −1 and 1, (effects, effects)


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


INTERVAL_S = 0.05  # length of the replays, s: long beside the noise of sensors, short beside a motion
NO_RESPONSE = 0.01  # share of the usual response, squared, below which no torque is told: the motor gives all it can
MOST_JOINTS, MOST_BY_STATE = 6, 2


@dataclass(frozen=True)
class ForceCourse:
    """What lacks in each replay, on average over it."""

    time: np.ndarray  # middle of each replay, (replays,), s
    force: np.ndarray  # nominal, then corrected, (simulations, replays, joints), N·m or N
    position: np.ndarray  # of the joints, on average over each replay, (replays, joints), as the next two
    velocity: np.ndarray
    acceleration: np.ndarray


def residual_force(log: Log, robot: Robot, corrections: Sequence[tuple[Effect, ...]]) -> ForceCourse | None:
    """The constant torques that would end each replay where the log is; None where it is not told.

    What a torque does to a joint under control is told by replays with it.
    """
    replayer, rows = Replayer(robot), log.info.rows(INTERVAL_S)
    starts, _ = RestartedReplayer(replayer, INTERVAL_S).starts(Rollout(log))
    count = min(sum(begin + rows < len(log) for begin in starts.rows), len(starts.rows) - 1)
    kind = effects.known()["torque_offset"]
    if count < 2 or kind.lacks(robot) is not None:
        return None
    chosen, begins = starts.chosen(range(count)), np.array(starts.rows)[:count]
    of_joints = np.concatenate([robot.joint_qpos, robot.model.nq + robot.joint_dofs])
    weight = np.repeat([2 / INTERVAL_S, 1.0], len(robot.joints))

    def ends(acting: tuple[Effect, ...]) -> np.ndarray:
        (pieces,) = replayer.replay_pieces([Rollout(log, acting)], [chosen], rows + 1)
        states = np.array([np.concatenate([piece.qpos[-1], piece.qvel[-1]]) for piece in pieces])
        return states[:, of_joints] * weight

    found = []
    for correction in corrections:
        own, columns = ends(correction), []
        for joint in robot.joints:
            torque = kind.parameters(robot, joint)[0].moderate
            columns.append((ends((*correction, effects.effect(kind.name, joint, torque_nm=torque))) - own) / torque)
        missed = starts.states[1 : count + 1, of_joints] * weight - own
        response = np.stack(columns, axis=2)
        normal = response.transpose(0, 2, 1) @ response
        normal += NO_RESPONSE * np.diag(np.median(np.diagonal(normal, axis1=1, axis2=2), axis=0) + 1e-300)
        found.append(np.linalg.solve(normal, np.einsum("kij,ki->kj", response, missed)[..., None])[..., 0])
    middle = (log.time[begins] + log.time[begins + rows]) / 2
    mean = (starts.states[:count] + starts.states[1 : count + 1]) / 2
    gain = starts.states[1 : count + 1] - starts.states[:count]
    acceleration = gain[:, of_joints[len(robot.joints) :]] / (log.time[begins + rows] - log.time[begins])[:, None]
    position, velocity = np.split(mean[:, of_joints], 2, axis=1)
    return ForceCourse(middle, np.array(found), position, velocity, acceleration)


def residual_figure(found: ForceCourse, joints: Sequence[str], units: Sequence[str]) -> go.Figure:
    """A panel for each of the joints that lack most: nominal and, where there is one, corrected; rms in its title."""
    sizes = np.sqrt((found.force**2).mean(axis=1))
    shown = np.argsort(-sizes[0], kind="stable")[:MOST_JOINTS].tolist()
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    titles = [f"{joints[j]}: {' → '.join(f'{size:.2g}' for size in sizes[:, j])} {units[j]}" for j in shown]
    figure = make_subplots(
        rows=rows, cols=columns, subplot_titles=titles, horizontal_spacing=0.06, vertical_spacing=0.3 / rows
    )
    simulations = zip(found.force, ("nominal", "corrected"), (NOMINAL, CORRECTED), strict=False)
    for force, name, colour in simulations:
        for i, j in enumerate(shown):
            figure.add_scatter(
                x=found.time.round(4),
                y=np.array([float(f"{value:.3g}") for value in force[:, j]]),
                name=name,
                mode="lines",
                showlegend=False,
                line={"color": colour, "width": 1.6},
                row=i // columns + 1,
                col=i % columns + 1,
            )
    figure.update_xaxes(title_text="s", title_standoff=2)
    figure.update_annotations(font_size=13)
    figure.update_layout(height=40 + 200 * rows, margin={"l": 45, "r": 15, "t": 30, "b": 40})
    return figure


def state_figure(found: ForceCourse, joints: Sequence[str], units: Sequence[str]) -> go.Figure:
    """The force at the joints that lack most against their velocity, position and acceleration."""
    sizes = np.sqrt((found.force[0] ** 2).mean(axis=0))
    shown = np.argsort(-sizes, kind="stable")[:MOST_BY_STATE].tolist()
    of_unit = {j: ("m/s", "m", "m/s²") if units[j] == "N" else ("rad/s", "rad", "rad/s²") for j in shown}
    quantities = {"velocity": found.velocity, "position": found.position, "acceleration": found.acceleration}
    titles = [f"{joints[j]}, {units[j]}, by its {what}" for j in shown for what in quantities]
    figure = make_subplots(
        rows=len(shown), cols=3, subplot_titles=titles, horizontal_spacing=0.06, vertical_spacing=0.35 / len(shown)
    )
    for force, name, colour in zip(found.force, ("nominal", "corrected"), (NOMINAL, CORRECTED), strict=False):
        for row, j in enumerate(shown, start=1):
            for column, values in enumerate(quantities.values(), start=1):
                figure.add_scatter(
                    x=[float(f"{value:.3g}") for value in values[:, j]],
                    y=[float(f"{value:.3g}") for value in force[:, j]],
                    name=name,
                    mode="markers",
                    showlegend=False,
                    marker={"color": colour, "size": 4, "opacity": 0.6},
                    row=row,
                    col=column,
                )
                unit = of_unit[j][column - 1]
                figure.update_xaxes(title_text=unit, title_standoff=2, row=row, col=column)
    figure.update_annotations(font_size=13)
    figure.update_layout(height=40 + 210 * len(shown), margin={"l": 45, "r": 15, "t": 30, "b": 40})
    return figure


MOST_CAUSES = 6
MOST_PIECES = 12
"""Numbers of effects and of short replays of each that are compared; it bounds the time to a second or two."""
HORIZON_S, EVERY_S = 0.1, 0.01
"""Length of the replays and interval of comparison, s, where the settings of the diagnosis name none."""


def similarity(
    causes: Sequence[Cause], logs: Sequence[Log], robot: Robot, horizon_s: float = HORIZON_S, every_s: float = EVERY_S
) -> Similarity | None:
    """Correlations between the first causes at their fitted values; None where fewer than two change anything."""
    acting = [(f"{effect_words(cause.effect)} ({cause.location})", effect_of(cause)) for cause in causes[:MOST_CAUSES]]
    known = [(name, effect) for name, effect in acting if effect is not None]
    if len(known) < 2:
        return None
    replayer = Replayer(robot, max(1, *(len(log.info.terrain) for log in logs)))
    pieces = ShortRollouts.of(JudgedLogs.of(logs, robot).states, replayer, horizon_s, every_s, MOST_PIECES)
    without = errors(pieces, ())
    changes = {name: errors(pieces, (effect,)) - without for name, effect in known}
    sizes = {name: float(np.linalg.norm(change)) for name, change in changes.items()}
    names = tuple(name for name, size in sizes.items() if size > 0 and np.isfinite(size))
    if len(names) < 2:
        return None
    unit = np.stack([changes[name] / sizes[name] for name in names])
    return Similarity(names, unit @ unit.T)


def effect_of(cause: Cause) -> Effect | None:
    """A cause as an effect with its fitted values; None for a class of somebody's own."""
    if cause.effect not in effects.known():
        return None
    return effects.effect(cause.effect, cause.location, **{name: one.value for name, one in cause.parameters.items()})


def errors(pieces: ShortRollouts, acting: tuple[Effect, ...]) -> np.ndarray:
    """Simulated − logged in all short replays in units of the channels' noise, one vector."""
    found = pieces.errors([(number, acting, one.starts) for number, one in enumerate(pieces.pieces)])
    scaled = [error / np.tile(one.noise, len(one.ages)) for error, one in zip(found, pieces.pieces, strict=True)]
    return np.nan_to_num(np.concatenate([of.ravel() for of in scaled]), nan=0.0, posinf=0.0, neginf=0.0)
