"""The search for forces from outside, and the logs without the moments in which they act."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from leapgap.diagnosis.channels import tangent_difference
from leapgap.diagnosis.gap import SIGMAS
from leapgap.diagnosis.judged_logs import JudgedLogs, is_jump
from leapgap.diagnosis.outside_forces.episodes import Episode, episodes_of
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce, OutsideForceSettings
from leapgap.diagnosis.outside_forces.residuals import Pushed, measure
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.effects.base import Effect
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import TWIST_SLICE, VELOCITY_SLICE
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

ROUNDS = 2  # The moments of the first round are left out of what the second one fits and compares
LEAST_LOGS = 2  # So few logs can be compared with each other; a diagnosis needs as many, too
SHORTEST_S, LEAST_ROWS = 0.3, 50  # In a shorter log, or in one of fewer rows, no moment stands out
MARGIN_S = 0.03  # A force may act so much longer, before and after, than its moment shows
MODEL_ERROR = 0.1
"""Standard deviation of an impulse because masses and contacts of the model are wrong, as a share of it."""
EXPLAINED = 0.5
"""A force is explained where the answer leaves a smaller share of the nominal robot's error of velocity there."""


@dataclass(frozen=True)
class OutsideForces:
    """Forces from outside that act in some logs."""

    forces: tuple[OutsideForce, ...] = ()  # By log and time
    logs: tuple[Log, ...] = ()  # The logs without the moments in which they act; empty where nothing is left out
    part_of: Mapping[str, str] = field(default_factory=dict)
    """Name of each of these → name of the log that it is a part of."""


def find_outside_forces(
    judged: JudgedLogs, replayer: Replayer, settings: OutsideForceSettings
) -> tuple[OutsideForce, ...]:
    """Find the forces from outside that act in some logs, by log and time."""
    logs = judged.logs
    short = any(len(log) < LEAST_ROWS or float(log.time[-1] - log.time[0]) < SHORTEST_S for log in logs)
    if len(logs) < LEAST_LOGS or short:
        return ()
    residuals = measure(judged.states, judged.robot, replayer)
    episodes: list[Episode] = []
    for _ in range(ROUNDS):
        episodes = episodes_of(residuals.residuals(moments_of(episodes, len(logs))), settings)
        if not episodes:
            return ()
    return tuple(force_of(one, logs[one.log], judged.robot) for one in episodes)


def without_moments(
    forces: tuple[OutsideForce, ...], judged: JudgedLogs, settings: OutsideForceSettings
) -> OutsideForces:
    """Forces, with the logs without the moments in which they act."""
    if not forces or not settings.remove:
        return OutsideForces(forces)
    parts, part_of = quiet_parts([states.log for states in judged.whole], forces, settings)
    if len(parts) < LEAST_LOGS:
        return OutsideForces(forces)
    return OutsideForces(forces, tuple(parts), part_of)


def moments_of(episodes: Sequence[Episode], logs: int) -> Pushed:
    """Begin and end of the moments of each log."""
    return [[(one.begin_s, one.end_s) for one in episodes if one.log == log] for log in range(logs)]


def force_of(episode: Episode, log: Log, robot: Robot) -> OutsideForce:
    """A moment as a force from outside."""
    half = SIGMAS * float(np.hypot(episode.deviation, MODEL_ERROR * episode.impulse))
    at, axis, unit = place_of(episode.dof, robot)
    return OutsideForce(
        log=log.name,
        at=at,
        axis=axis,
        time_s=episode.time_s,
        begin_s=episode.begin_s,
        end_s=episode.end_s,
        peak=episode.peak,
        impulse=episode.impulse,
        impulse_ci95=(episode.impulse - half, episode.impulse + half),
        unit=unit,
        size=episode.size,
    )


def place_of(dof: int, robot: Robot) -> tuple[str, str, str]:
    """Joint or body, axis and unit of a force at a degree of freedom."""
    if robot.has_free_base and dof < TWIST_SLICE.stop:
        turns = dof >= VELOCITY_SLICE.stop
        return robot.model.body(robot.base_body).name, "xyz"[dof % 3], "N·m" if turns else "N"
    (joint,) = np.flatnonzero(robot.joint_dofs == dof)
    slides = robot.model.jnt_type[robot.model.dof_jntid[dof]] == mujoco.mjtJoint.mjJNT_SLIDE
    return robot.joints[int(joint)], "", "N" if slides else "N·m"


def dof_at(force: OutsideForce, robot: Robot) -> int:
    """Degree of freedom that a force acts on, the inverse of ``place_of``."""
    if force.axis:
        return "xyz".index(force.axis) + (0 if force.unit == "N" else VELOCITY_SLICE.stop)
    return int(robot.joint_dofs[robot.joints.index(force.at)])


def quiet_parts(
    logs: Sequence[Log], forces: Sequence[OutsideForce], settings: OutsideForceSettings
) -> tuple[list[Log], dict[str, str]]:
    """The rows of logs in which nothing acts from outside, and the log that each of them is a part of.

    A jump keeps its rows before the first force, since whole jumps are judged from their begin; other logs are cut into
    the parts between two forces.
    """
    parts: list[Log] = []
    part_of: dict[str, str] = {}
    for log in logs:
        own = [one for one in forces if one.log == log.name]
        for part in [log] if not own else parts_without(log, own, settings.least_part_s):
            parts.append(part)
            part_of[part.name] = log.name
    return parts, part_of


def parts_without(log: Log, forces: Sequence[OutsideForce], least_s: float) -> list[Log]:
    """Parts of a log between its forces, which are in order; the shorter ones are left out."""
    edges = [log.time[0], *(t for one in forces for t in (one.begin_s - MARGIN_S, one.end_s + MARGIN_S)), log.time[-1]]
    begins, ends = np.searchsorted(log.time, edges[0::2]), np.searchsorted(log.time, edges[1::2], "right")
    whole = [
        (int(begin), int(end))
        for begin, end in zip(begins, ends, strict=True)
        if end - begin >= 2 and log.time[end - 1] - log.time[begin] >= least_s
    ]
    if is_jump(log):
        return [log.first_rows(end) for begin, end in whole if begin == 0]
    return [rows_between(log, begin, end, f"{log.name}_from_{log.time[begin]:.2f}_s") for begin, end in whole]


def unexplained(
    forces: Sequence[OutsideForce], given: JudgedLogs, replayer: Replayer, answer: Sequence[Effect]
) -> tuple[OutsideForce, ...]:
    """The forces that act on the robot with its answer as well, by replays of their moments from the logs' states."""
    return tuple(force for force in forces if not explains(answer, force, given, replayer))


def explains(answer: Sequence[Effect], force: OutsideForce, given: JudgedLogs, replayer: Replayer) -> bool:
    """Whether the robot with its answer moves through the moment of a force as the log says."""
    nominal, own = moment_errors([(), tuple(answer)], force, given, replayer)
    return bool(own < EXPLAINED * nominal)


def moment_errors(
    several: Sequence[tuple[Effect, ...]], force: OutsideForce, given: JudgedLogs, replayer: Replayer
) -> np.ndarray:
    """Root mean squares of errors of the velocity that a force changes, in replays of its moment, (sets,)."""
    (states,) = (of_log for of_log in given.whole if of_log.log.name == force.log)
    log, robot = states.log, given.robot
    first, last = np.searchsorted(log.time, [force.begin_s - MARGIN_S, force.end_s + MARGIN_S])
    last = min(last, len(log) - 1)
    starts, _ = smooth_starts(states.motion, [int(first)], log, robot)
    trials = [Rollout(log, effects) for effects in several]
    pieces = replayer.replay_pieces(trials, [starts] * len(trials), int(last - first) + 1)
    logged, entry = states.motion[first : last + 1], robot.model.nv + dof_at(force, robot)
    errors = [tangent_difference(motion, logged, robot)[:, entry] for (motion,) in pieces]
    return np.sqrt(np.mean(np.square(errors), axis=1))
