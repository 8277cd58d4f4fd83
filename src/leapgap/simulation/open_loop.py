"""Open-loop runs of simulated hardware: the nominal robot with effects unknown to its controller, and sensor noise.

The robot tracks a planned reference with feed-forward torque and joint PD at the reference's rate. The commands are
known beforehand, so runs roll out as replays do, without a Python loop. Each run gives a log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.logs.state import columns_of, motion_of
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, Motion
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PAIRS
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import NoiseRows, SensorNoise

LARGEST_DEPTH_M = 0.002  # largest depth of a foot at the start; contact resolves it, and deeper ones throw the robot


@dataclass(frozen=True)
class Course:
    """Times before and after the reference, s, and size of the block under the front feet, m."""

    settle_s: float = 0.5  # the robot stands on its terrain this long before the reference begins
    after_landing_s: float = 0.3  # the last command is held this long after the reference ends
    block_length_m: float = 0.2
    block_width_m: float = 0.5


@dataclass(frozen=True)
class MotionPlan:
    """One planned run: its reference and the height of the block under the front feet, m (0: none)."""

    name: str
    reference: Log
    block_height_m: float = 0.0
    rear_block_height_m: float = 0.0  # height of a block under the rear feet, m (0: none)
    crouch_error_rad: tuple[float, ...] = ()
    """How far each joint stands from the reference's first pose at the start, (joints,); empty: not at all."""


@dataclass(frozen=True)
class PreparedRun:
    """A planned run with the commands to send and the true state at its start."""

    plan: MotionPlan
    commanded: Log  # the reference, extended beyond its end, on the plan's terrain
    start: np.ndarray  # true state after standing for a while, (nq + nv,)


def prepare(
    plans: Sequence[MotionPlan], replayer: Replayer, effects: tuple[Effect, ...], course: Course
) -> list[PreparedRun]:
    """Settle the simulated hardware at the start of each plan; ``replayer`` has slots for their terrain."""
    robot = replayer.robot
    commanded = [with_block(extend_reference(plan.reference, course), plan, robot, course) for plan in plans]
    held = [
        misplace_joints(hold_first_command(log, course.settle_s), plan, robot)
        for log, plan in zip(commanded, plans, strict=True)
    ]
    standing = []
    for log, plan in zip(held, plans, strict=True):
        state = replayer.first_state(Rollout(log))
        state = raise_front(state, plan.block_height_m - plan.rear_block_height_m, robot)
        state[2] += plan.rear_block_height_m
        standing.append(state)
    settling = [Rollout(log, effects) for log in held]
    settling = [
        replace(trial, first_state=lift_out_of_ground(trial, state, replayer))
        for trial, state in zip(settling, standing, strict=True)
    ]
    starts = [motion.last_state for motion in replayer.true_motions(settling)]
    return [PreparedRun(*each) for each in zip(plans, commanded, starts, strict=True)]


def terrain_slots(plans: Sequence[MotionPlan]) -> int:
    """Number of boxes that the models of the plans need: those of the reference and the block."""
    rear = any(plan.rear_block_height_m > 0 for plan in plans)
    return 1 + rear + max((len(plan.reference.info.terrain) for plan in plans), default=0)


def run_open_loop(
    plans: Sequence[MotionPlan],
    robot: Robot,
    effects: tuple[Effect, ...],
    noise: SensorNoise,
    course: Course,
    rng: np.random.Generator,
) -> list[Log]:
    """Run the plans open loop on simulated hardware; logs in the order of the plans."""
    replayer = Replayer(robot, terrain_slots(plans))
    ready = prepare(plans, replayer, effects, course)
    motions = replayer.motions([Rollout(one.commanded, effects, first_state=one.start) for one in ready])
    logs = []
    for one, motion in zip(ready, motions, strict=True):
        errors = NoiseRows.draw(noise, len(motion.qpos), len(robot.joints), rng)
        logs.append(log_of(one.plan.name, one.commanded, errors.add_to(motion, robot), robot))
    return logs


def extend_reference(reference: Log, course: Course) -> Log:
    """The reference with its last set points held after its end, planned velocities and forces zero."""
    period = reference.info.sample_period_s
    more = round(course.after_landing_s / period)
    columns = {}
    for name, values in reference.columns.items():
        zero = name.startswith(("cmd_tau/", "cmd_vel/", "mpc_force/"))
        columns[name] = np.concatenate([values, np.full(more, 0.0 if zero else values[-1])])
    columns["time"] = np.arange(len(reference) + more) * period
    return replace(reference, columns=columns)


def hold_first_command(log: Log, seconds: float) -> Log:
    """The log with its first row repeated for some seconds."""
    rows = max(2, round(seconds / log.info.sample_period_s))
    columns = {name: np.full(rows, values[0]) for name, values in log.columns.items()}
    columns["time"] = np.arange(rows) * log.info.sample_period_s
    return replace(log, columns=columns)


def misplace_joints(log: Log, plan: MotionPlan, robot: Robot) -> Log:
    """The log with the plan's wrong crouch in its joints and their set points."""
    columns = dict(log.columns)
    for joint, error in zip(robot.joints, plan.crouch_error_rad, strict=False):
        for name in (f"cmd_pos/{joint}", f"joint_pos/{joint}"):
            columns[name] = columns[name] + error
    return replace(log, columns=columns)


def with_block(log: Log, plan: MotionPlan, robot: Robot, course: Course) -> Log:
    """The reference with the plan's blocks, if it has any, under the front and the rear feet."""
    terrain = log.info.terrain
    for pair, height in (("front", plan.block_height_m), ("rear", plan.rear_block_height_m)):
        if height > 0:
            feet = feet_positions(robot, motion_of(log, robot, slice(1)).qpos)[0]
            x, y = feet[robot.feet_at(pair), :2].mean(axis=0)
            size = (course.block_length_m, course.block_width_m, height)
            terrain = (*terrain, Box(round(float(x), 4), round(float(y), 4), size, height))
    return log if terrain == log.info.terrain else replace(log, info=replace(log.info, terrain=terrain))


def lift_out_of_ground(trial: Rollout, state: np.ndarray, replayer: Replayer) -> np.ndarray:
    """The state (nq + nv,), tilted and lifted until no foot penetrates the ground of the trial.

    Effects may put that ground elsewhere than it was planned.
    """
    robot = replayer.robot
    depth = replayer.foot_depths(replace(trial, first_state=state))
    if depth.max(initial=0.0) < LARGEST_DEPTH_M:
        return state
    front, rear = (depth[robot.feet_at(pair)].max() for pair in PAIRS)
    state = raise_front(state, front - rear, robot)
    state[2] += replayer.foot_depths(replace(trial, first_state=state)).max()
    return state


def raise_front(state: np.ndarray, height_m: float, robot: Robot) -> np.ndarray:
    """The first state (nq + nv,), pitched about the rear feet so that the front feet are ``height_m`` higher."""
    state = state.copy()
    if height_m == 0:
        return state
    feet = feet_positions(robot, state[None, : robot.model.nq])[0]
    front, rear = (feet[robot.feet_at(pair)].mean(axis=0) for pair in PAIRS)
    pitch = -np.arcsin(height_m / (front[0] - rear[0]))  # nose up is negative
    c, s = np.cos(pitch), np.sin(pitch)
    arm = state[POSITION_SLICE] - rear
    state[0], state[2] = rear[0] + c * arm[0] + s * arm[2], rear[2] - s * arm[0] + c * arm[2]
    level = state[QUATERNION_SLICE].copy()
    mujoco.mju_mulQuat(state[QUATERNION_SLICE], np.array([np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0]), level)
    return state


def log_of(name: str, commanded: Log, measured: Motion, robot: Robot) -> Log:
    """Log of a measured motion and its commands, with the planned forces of the pairs where there are any."""
    columns = {"time": commanded.time} | columns_of(measured, robot)
    columns |= {key: values for key, values in commanded.columns.items() if key.startswith(("cmd_", "mpc_force/"))}
    info = replace(commanded.info, robot=robot.name, source="simulated hardware")
    return Log(name, {key: np.ascontiguousarray(values) for key, values in columns.items()}, info)
