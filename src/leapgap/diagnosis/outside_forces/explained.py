"""Forces from outside that an answer explains: a foot that slips looks like a push until its friction is known.

Forces are searched for before anything is known of the robot. Where the robot with its answer moves through the moment
of a force as the log says, nothing pushed it.
"""

from collections.abc import Sequence

import numpy as np

from leapgap.diagnosis.channels import tangent_difference
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.outside_forces.search import MARGIN_S
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer, Rollout

EXPLAINED = 0.5
"""A force is explained where the answer leaves a smaller share of the nominal robot's error of velocity there."""


def unexplained(
    forces: Sequence[OutsideForce], given: JudgedLogs, replayer: Replayer, answer: Sequence[Effect]
) -> tuple[OutsideForce, ...]:
    """The forces that act on the robot with its answer as well, by replays of their moments from the logs' states."""
    return tuple(force for force in forces if not explains(answer, force, given, replayer))


def explains(answer: Sequence[Effect], force: OutsideForce, given: JudgedLogs, replayer: Replayer) -> bool:
    """Whether the robot with its answer moves through the moment of a force as the log says."""
    nominal, own = (moment_error(effects, force, given, replayer) for effects in ((), answer))
    return own < EXPLAINED * nominal


def moment_error(effects: Sequence[Effect], force: OutsideForce, given: JudgedLogs, replayer: Replayer) -> float:
    """Error of the velocity that a force changes, in a replay of its moment, root mean square, m/s or rad/s."""
    (states,) = (of_log for of_log in given.whole if of_log.log.name == force.log)
    log, robot = states.log, given.robot
    first, last = np.searchsorted(log.time, [force.begin_s - MARGIN_S, force.end_s + MARGIN_S])
    last = min(last, len(log) - 1)
    starts, _ = smooth_starts(states.motion, [int(first)], log, robot)
    ((motion,),) = replayer.replay_pieces([Rollout(log, tuple(effects))], [starts], int(last - first) + 1)
    error = tangent_difference(motion, states.motion[first : last + 1], robot)
    return float(np.sqrt(np.mean(error[:, robot.model.nv + dof_of(force, robot)] ** 2)))


def dof_of(force: OutsideForce, robot: Robot) -> int:
    """Degree of freedom that a force acts on."""
    if force.axis:
        return "xyz".index(force.axis) + (0 if force.unit == "N" else 3)
    return int(robot.joint_dofs[robot.joints.index(force.at)])
