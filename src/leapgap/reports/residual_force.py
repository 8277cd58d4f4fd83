"""Force that a simulation lacks at each joint over the time of a log, from short replays of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from leapgap import effects
from leapgap.diagnosis.restarts import RestartedReplayer
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.reports.colours import CORRECTED, NOMINAL
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

INTERVAL_S = 0.05
"""Length of the replays, s: long beside the noise of sensors, short beside a motion."""
NO_RESPONSE = 0.01
"""Share of the usual response, squared, below which no torque is told: the motor gives all it can."""
MOST_JOINTS, MOST_BY_STATE = 6, 2


@dataclass(frozen=True)
class ForceCourse:
    """What lacks in each replay, on average over it."""

    time: np.ndarray
    """Middle of each replay, (replays,), s."""
    force: np.ndarray
    """Nominal, then corrected, (simulations, replays, joints), N·m or N."""
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    """Of the joints, on average over each replay, (replays, joints)."""


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
