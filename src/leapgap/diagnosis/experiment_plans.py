"""What experiments start from, and plans: logs whose commands are to be sent, from a state that they hold."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import columns_of, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion

MOST_LIMITED, BEYOND_RAD = 0.05, 0.02
"""Share of the rows in which a motor may be at its limit, and how far a joint may press into its stop, rad."""


@dataclass(frozen=True)
class Given:
    """What experiments start from: the logs, the robot, and where the causes that are to be told apart act."""

    logs: tuple[Log, ...]  # The logs, of which each has the rows that are judged
    robot: Robot
    places: tuple[str, ...] = ()  # Locations of the causes, without doubles

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that the logs command, in the order of the robot."""
        return tuple(joint for joint in self.robot.joints if f"cmd_kp/{joint}" in self.logs[0])

    @property
    def is_jumps(self) -> bool:
        """Whether every log is a jump to a stated target."""
        return all("target" in log.info.extra for log in self.logs)

    @property
    def is_even(self) -> bool:
        """Whether all rows last one period, so that commands can be planned on it."""
        return all(log.is_even for log in self.logs)

    @property
    def has_gains(self) -> bool:
        """Whether a joint PD acts anywhere."""
        return any(bool(log.per_joint("cmd_kp").any()) for log in self.logs)

    def median(self, quantity: str) -> dict[str, float]:
        """Median of a commanded quantity over all logs, by joint."""
        return {
            joint: float(np.median(np.concatenate([log[f"{quantity}/{joint}"] for log in self.logs])))
            for joint in self.joints
        }

    @cached_property
    def fastest(self) -> float:
        """Largest speed of a joint in the logs, rad/s, of those that are commanded."""
        motions = [motion_of(log, self.robot) for log in self.logs]
        dofs = self.robot.joint_dofs[[self.robot.joints.index(joint) for joint in self.joints]]
        return max(float(np.percentile(np.abs(motion.qvel[:, dofs]), 99)) for motion in motions)

    @cached_property
    def pose(self) -> np.ndarray:
        """The state at rest that sines are about, (nq + nv,).

        That of a standing robot is its first row; the median pose of a robot that is held.
        """
        model, motions = self.robot.model, [motion_of(log, self.robot) for log in self.logs]
        state = np.concatenate([motions[0].qpos[0], np.zeros(model.nv)])
        if not self.robot.has_free_base:
            state[: model.nq] = np.median(np.concatenate([motion.qpos for motion in motions]), axis=0)
        return state

    @property
    def sine_places(self) -> list[tuple[str, ...]]:
        """Sets of joints to move: those of the first place of a cause that is smaller than the robot, then all.

        Where a cause acts on the whole robot or at a foot, the first single joint or limb stands for its place.
        """
        robot = self.robot
        singles = robot.joint_groups if robot.has_free_base and robot.joint_groups else self.joints
        at = [self.joints_at(place) for place in self.places if place not in ("all", *robot.feet)]
        if len(at) < len(self.places) or not at or () in at:
            at += map(self.joints_at, singles)
        some = [joints for joints in dict.fromkeys(at) if joints not in ((), self.joints)]
        return [*some[:1], self.joints]

    def joints_at(self, location: str) -> tuple[str, ...]:
        """The commanded joints of a location."""
        joints = (self.robot.joints[i] for i in self.robot.joints_at(location))
        return tuple(joint for joint in joints if joint in self.joints)

    def gains(self, factor: float = 1.0) -> str:
        """``kp 40`` of so many times the gains, or a range over joints."""
        values = sorted({float(f"{factor * value:.3g}") for value in self.median("cmd_kp").values() if value > 0})
        return f"kp {values[0]:g}" + (f" to {values[-1]:g}" if len(values) > 1 else "") if values else "kp 0"


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


def repeated(given: Given) -> list[Log]:
    """The logs' own commands from their own starts."""
    return [plan_of(log, k, given.robot) for k, log in enumerate(given.logs)]


def from_rest(given: Given, number: int, columns: Mapping[str, np.ndarray]) -> Log:
    """A plan of commands from the pose of the logs, at rest."""
    of_logs = given.logs[0].info
    info = LogInfo(of_logs.robot, of_logs.sample_period_s, "a planned experiment", of_logs.terrain)
    return planned(f"next_{number}", columns, given.pose, info, given.robot)


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
