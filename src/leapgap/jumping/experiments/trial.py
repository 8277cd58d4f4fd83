"""One closed-loop run of a method at a task on simulated hardware, and the landing of each of its jumps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.control.jump_sequence import JumpSequence, SequenceConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.goal_directed_jump import Stand
from leapgap.jumping.experiments.landing import Landing, landing
from leapgap.jumping.experiments.run_metrics import RunMetrics, run_metrics
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import rigid_body_of
from leapgap.jumping.task import metadata_of, of_latest_jump, planned_segments, schedule_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis, per_pair
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.logs.state import motion_of, pd_torques
from leapgap.robot.kinematics import joint_torque_to_foot_force
from leapgap.robot.model import Robot
from leapgap.robot.rotations import yaw_of
from leapgap.simulation.closed_loop import ClosedLoopRun, Disturbance, Sensing, run_closed_loop
from leapgap.simulation.open_loop import Course, MotionPlan, prepare, terrain_slots
from leapgap.simulation.replay import Replayer

Jumps = Callable[[JumpTask], Sequence[JumpController]]
"""Returns new controllers of a task's jumps, in their order."""


@dataclass(frozen=True)
class TrialSetup:
    """Everything that all runs of an experiment have in common."""

    robot: Robot
    sensing: Sensing = field(default_factory=Sensing)
    sequence: SequenceConfig = field(default_factory=SequenceConfig)
    course: Course = field(default_factory=Course)
    body: RigidBody | None = None
    """Rigid body that the landing controller assumes; None: the robot's own, in the pose that the plans begin in."""

    def body_for(self, reference: Reference) -> RigidBody:
        """The rigid body that the landing controller assumes in runs along this reference."""
        return rigid_body_of(self.robot, reference.joint_pos[0]) if self.body is None else self.body


@dataclass(frozen=True)
class TrialOutcome:
    """The simulated run, its landings, and its fallbacks."""

    run: ClosedLoopRun
    starts: tuple[int, ...]
    """Row at which each jump starts."""
    landings: tuple[Landing, ...]
    total_error_cm: float | None
    """Sum of the jumps' target distances − distance from the first start to the last landing, cm; positive is short.
    None where not all jumps were made."""
    substituted: tuple[tuple[float, str], ...]
    """Time, s since the run's first row, and reason of each fallback command."""
    fallbacks: dict[str, int]
    """Count of fallback commands by reason, those of the landings included."""
    metrics: RunMetrics
    controllers: tuple[JumpController, ...]
    disturbances: tuple[Disturbance, ...]
    """What acted on the trunk, times counted from the start of the first jump."""


def attempt_task(
    task: JumpTask,
    method: Jumps,
    reference: Log,
    effects: tuple[Effect, ...],
    world: TrialSetup,
    rng: np.random.Generator,
) -> TrialOutcome:
    """Simulate a method at a task on a robot with effects; ``reference`` plans one of its jumps from level ground."""
    robot = world.robot
    planned = Reference.of(reference, robot)
    course = replace(
        world.course, after_landing_s=run_duration_s(task, planned, world.sequence) - planned.schedule.landing_s
    )
    terrain = (*reference.info.terrain, *task.ground(planned, rng))
    metadata = metadata_of(planned.schedule, task.target)
    level = replace(reference, info=replace(reference.info, extra=metadata, terrain=terrain))
    block_m = task.start_block(rng)
    effects = (*effects, *task.tilt(rng))
    plans = [MotionPlan(task.name, level, block_m, task.rear_start_block(rng), task.crouch_error(robot, rng))]
    disturbances = task.disturbances(rng)
    replayer = Replayer(robot, terrain_slots(plans), threads=1)
    (ready,) = prepare(plans, replayer, effects, course)
    controller = JumpSequence(list(method(task)), robot, world.sequence, world.body_for(planned))
    run = run_closed_loop(
        ready, controller, replayer, effects, world.sensing, rng, disturbances, lambda: controller.jumps[0].start_s
    )
    start_times = [jump.start_s for jump in controller.jumps if jump.start_s is not None]
    run = replace(run, log=with_plan(run.log, robot, start_times))
    period = run.log.info.sample_period_s
    starts = tuple(round(start / period) for start in start_times)
    landings = tuple(landing(run, robot, first) for first in starts)
    return TrialOutcome(
        run,
        starts,
        landings,
        total_error_cm(run, task, starts),
        tuple(
            (round(jump.start_s + time_s, 6), reason)
            for jump in controller.jumps
            if jump.start_s is not None
            for time_s, reason in jump.substituted
        ),
        dict(controller.fallbacks),
        run_metrics(run, robot, starts[0]),
        tuple(controller.jumps),
        disturbances,
    )


def with_plan(log: Log, robot: Robot, begins_s: Sequence[float]) -> Log:
    """The log of jumps that began at some times, s, with their planned phases, and ``pd_force`` by these."""
    if begins_s and tuple(begins_s) != (0.0,):  # the schedule alone says what is planned of one jump from the first row
        end_s = float(log.time[-1]) + log.info.sample_period_s
        segments = planned_segments(schedule_of(log), begins_s, end_s)
        log = replace(log, info=replace(log.info, stated_segments=segments))
    return with_pd_force(log, robot, begins_s or (0.0,))


def run_duration_s(task: JumpTask, reference: Reference, sequence: SequenceConfig) -> float:
    """Simulated time of a task's run: its jumps, each with its landing and the longest stand before it, and 0.2 s more,
    s."""
    one = reference.schedule.landing_s + sequence.latest_touch_s + sequence.landing.duration_s + sequence.settle_s
    return task.jumps * (Stand.longest_s + one) + 0.2


def total_error_cm(run: ClosedLoopRun, task: JumpTask, starts: Sequence[int]) -> float | None:
    """``TrialOutcome.total_error_cm``: true positions, along the heading at the first start."""
    info = run.log.info
    if len(starts) < task.jumps:
        return None
    end = min(len(run.log) - 1, starts[-1] + round(schedule_of(run.log).landing_s / info.sample_period_s))
    yaw = yaw_of(run.truth.base_quaternion[starts[0]])
    way = (run.truth.qpos[end] - run.truth.qpos[starts[0]])[:2] @ np.array([np.cos(yaw), np.sin(yaw)])
    return float(100 * (task.jumps * task.x_m - way))


MOST_N = 1e4
"""A foot's force that is larger is none: the leg's Jacobian is singular, as where the foot is as high as the hip."""


def with_pd_force(jump: Log, robot: Robot, begins_s: Sequence[float]) -> Log:
    """The log with u_pd = −(Jᵀ Rᵀ)⁻¹ τ_pd of each pair as columns ``pd_force``, N on the robot.

    It is zero where the schedule has the pair in the air; jumps begin at ``begins_s``. A foot counts for nothing where
    no force at it can stand for the torques of its leg, as may be once a robot has fallen.
    """
    motion = motion_of(jump, robot)
    joint_pos = motion.qpos[:, robot.joint_qpos]
    spring, damper = pd_torques(jump, robot.joints, joint_pos, motion.qvel[:, robot.joint_dofs])
    of_feet = joint_torque_to_foot_force(robot, motion.base_quaternion, joint_pos, spring + damper)
    planned = schedule_of(jump).in_contact(of_latest_jump(jump.time, begins_s))
    stands_for = np.abs(of_feet).max(axis=2) < MOST_N
    force = per_pair(robot, np.where(stands_for[..., None], of_feet, 0.0)) * per_axis(planned)
    columns = {f"pd_force/{axis}": force[:, i].copy() for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(jump, columns=dict(jump.columns) | columns)
