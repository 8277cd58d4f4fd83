"""Plans: logs whose commands are to be sent, and whose measured columns hold the state that they start from."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from leapgap.diagnosis.experiments.given import Given
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import columns_of, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.rollout import LOAD

MOST_LIMITED, BEYOND_RAD = 0.05, 0.02
"""Share of the rows in which a motor may be at its limit, and how far a joint may press into its stop, rad."""


def standing_commands(given: Given, rows: int) -> dict[str, np.ndarray]:
    """Commands that hold the pose of the logs, (rows,) each, with the median gains.

    Feed-forward torque is that of the first row of a standing robot, and the median of one that is held.
    """
    robot = given.robot
    commands: dict[str, np.ndarray] = {}
    kp, kd, torque = (given.median(quantity) for quantity in ("cmd_kp", "cmd_kd", "cmd_tau"))
    first = given.logs[0]
    for joint in given.joints:
        at = float(given.pose[robot.joint_qpos[robot.joints.index(joint)]])
        held = float(first[f"cmd_pos/{joint}"][0]) if robot.has_free_base else at
        push = float(first[f"cmd_tau/{joint}"][0]) if robot.has_free_base else torque[joint]
        values = {"tau": push if given.has_gains else 0.0, "pos": held, "vel": 0.0, "kp": kp[joint], "kd": kd[joint]}
        commands |= {f"cmd_{name}/{joint}": np.full(rows, value) for name, value in values.items()}
    return commands


def with_load(plan: Log, load: Mapping[str, float]) -> Log:
    """The plan with known masses, joint → kg, in its metadata."""
    extra = {**plan.info.extra, LOAD: dict(load)}
    return replace(plan, info=replace(plan.info, extra=extra))


def commands_of(log: Log) -> list[str]:
    """Names of the columns of commands."""
    return [name for name in log.columns if name.startswith("cmd_")]


def plan_of(log: Log, number: int, robot: Robot) -> Log:
    """The commands of a log as a plan, from its own first state."""
    columns = {name: log[name] for name in commands_of(log)}
    if not log.is_even:
        columns["time"] = log.time
    start = motion_of(log, robot).first_state
    return planned(f"next_{number}", columns, start, log.info, robot)


def planned(name: str, columns: Mapping[str, np.ndarray], start: np.ndarray, info: LogInfo, robot: Robot) -> Log:
    """A plan of commands from a state (nq + nv,)."""
    rows = len(next(iter(columns.values())))
    time = {"time": np.arange(rows) * info.sample_period_s}
    extra = {key: value for key, value in info.extra.items() if key != "derived"}
    return with_start(Log(name, time | dict(columns), replace(info, extra=extra)), start, robot)


def with_start(plan: Log, start: np.ndarray, robot: Robot) -> Log:
    """The plan from another state (nq + nv,)."""
    nq = robot.model.nq
    rows = Motion(np.tile(start[:nq], (len(plan), 1)), np.tile(start[nq:], (len(plan), 1)))
    return replace(plan, columns=dict(plan.columns) | columns_of(rows, robot))


def names_of(joints: Sequence[str], robot: Robot) -> str:
    """``knee``, ``hip and knee``, or the name of the group that these joints are."""
    for location in (*robot.joint_groups, *robot.limbs_of_pair, *robot.topology.limbs):
        if {robot.joints[i] for i in robot.joints_at(location)} == set(joints):
            return location
    return " and ".join([", ".join(joints[:-1]), joints[-1]] if len(joints) > 1 else joints)


def is_possible(plan: Log, motion: Motion, robot: Robot) -> bool:
    """Whether a simulated plan stays finite, within joint ranges, and mostly within what the motors can give."""
    if not (np.isfinite(motion.qpos).all() and np.isfinite(motion.qvel).all()):
        return False
    joints = [joint for joint in robot.joints if f"cmd_kp/{joint}" in plan]
    which = [robot.joints.index(joint) for joint in joints]
    q, v = motion.qpos[:, robot.joint_qpos[which]], motion.qvel[:, robot.joint_dofs[which]]
    tau, pos, vel, kp, kd = (
        plan.per_joint(f"cmd_{name}", joints)[: len(q)] for name in ("tau", "pos", "vel", "kp", "kd")
    )
    asked = np.abs(tau + kp * (pos - q) + kd * (vel - v))
    limits = np.minimum(robot.torque_limits[which], math.inf)
    if (asked > limits).mean(axis=0).max() > MOST_LIMITED:
        return False
    for k, joint in enumerate(joints):
        number = robot.model.joint(joint).id
        if robot.model.jnt_limited[number]:
            low, high = robot.model.jnt_range[number]
            if q[:, k].min() < low - BEYOND_RAD or q[:, k].max() > high + BEYOND_RAD:
                return False
    return True
