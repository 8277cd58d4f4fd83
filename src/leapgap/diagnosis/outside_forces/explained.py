"""Forces from outside that an answer explains: a foot that slips looks like a push until its friction is known.

Forces are searched for before anything is known of the robot. Where the robot with its answer moves through the moment
of a force as the log says, nothing pushed it.
"""

from collections.abc import Sequence

import numpy as np

from leapgap.diagnosis.channels import tangent_difference
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.outside_forces.search import MARGIN_S, dof_at
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.effects.base import Effect
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

EXPLAINED = 0.5
"""A force is explained where the answer leaves a smaller share of the nominal robot's error of velocity there."""


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
