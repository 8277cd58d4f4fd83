"""One run of a method at a task on simulated hardware, from standing to what came of each jump."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.control.jump_sequence import JumpSequence, SequenceConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.landing import Landing, landing
from leapgap.jumping.experiments.run_metrics import RunMetrics, run_metrics
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import rigid_body_of
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.rotations import yaw_of
from leapgap.simulation.closed_loop import ClosedLoopRun, Sensing, run_closed_loop
from leapgap.simulation.open_loop import Course, MotionPlan, prepare, terrain_slots
from leapgap.simulation.replay import Replayer

Jumps = Callable[[JumpTask], Sequence[JumpController]]
"""Makes fresh controllers of a task's jumps, in their order."""

LONGEST_STAND_S = 0.1
"""A method may stand this long to measure before it jumps."""


@dataclass(frozen=True)
class TrialSetup:
    """What all runs share."""

    robot: Robot
    sensing: Sensing = field(default_factory=Sensing)
    sequence: SequenceConfig = field(default_factory=SequenceConfig)
    course: Course = field(default_factory=Course)
    body: RigidBody | None = None
    """What landings take the robot for; None: its own mass and inertia, in the pose that the plans begin in."""

    def body_for(self, reference: Reference) -> RigidBody:
        """That of runs whose jumps are planned so."""
        return rigid_body_of(self.robot, reference.joint_pos[0]) if self.body is None else self.body


@dataclass(frozen=True)
class TrialOutcome:
    """What came of a run."""

    run: ClosedLoopRun
    starts: tuple[int, ...]
    """Row at which each jump began."""
    landings: tuple[Landing, ...]
    total_error_cm: float | None
    """Of all jumps: the sum of their targets − the way from the first start to the last landing, positive is short;
    None where not all were made."""
    substituted: tuple[tuple[float, str], ...]
    """When, s since the run's first row, and why a controller sent something else than what it stands for."""
    fallbacks: dict[str, int]
    """How often, by reason; landings too."""
    conduct: RunMetrics
    controllers: tuple[JumpController, ...]


def attempt_task(
    task: JumpTask,
    method: Jumps,
    reference: Log,
    effects: tuple[Effect, ...],
    world: TrialSetup,
    rng: np.random.Generator,
) -> TrialOutcome:
    """Let a method do a task on a robot with effects; ``reference`` is the plan of its jumps from level ground."""
    robot = world.robot
    planned = Reference.of(reference, robot)
    course = replace(world.course, after_landing_s=length_s(task, planned, world.sequence) - planned.schedule.landing_s)
    terrain = (*reference.info.terrain, *task.ground(planned, rng))
    level = replace(reference, info=replace(reference.info, target=task.target, terrain=terrain))
    plans = [MotionPlan(task.name, level, task.start_block(rng))]
    effects = (*effects, *task.tilt(rng))
    replayer = Replayer(robot, terrain_slots(plans), threads=1)
    (ready,) = prepare(plans, replayer, effects, course)
    controller = JumpSequence(list(method(task)), robot, world.sequence, world.body_for(planned))
    run = run_closed_loop(ready, controller, replayer, effects, world.sensing, rng)
    period = run.log.info.sample_period_s
    began = [jump.start_s for jump in controller.jumps if jump.start_s is not None]
    starts = tuple(round(start / period) for start in began)
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
    )


def length_s(task: JumpTask, reference: Reference, sequence: SequenceConfig) -> float:
    """How long a task's run is watched: its jumps, and half a second after the last landing."""
    one = reference.schedule.landing_s + sequence.latest_touch_s + sequence.landing.duration_s + sequence.settle_s
    return LONGEST_STAND_S + task.jumps * one + 0.2


def total_error_cm(run: ClosedLoopRun, task: JumpTask, starts: Sequence[int]) -> float | None:
    """Along the heading of the first start, from the true state, at the end of the last scheduled flight."""
    info = run.log.info
    if len(starts) < task.jumps:
        return None
    end = min(len(run.log) - 1, starts[-1] + round(info.schedule.landing_s / info.sample_period_s))
    yaw = yaw_of(run.truth.base_quaternion[starts[0]])
    way = (run.truth.qpos[end] - run.truth.qpos[starts[0]])[:2] @ np.array([np.cos(yaw), np.sin(yaw)])
    return float(100 * (task.jumps * task.x_m - way))
