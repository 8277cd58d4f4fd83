"""One closed-loop run of a method at a task on simulated hardware, and the landing of each of its jumps."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.effects.drive import resistance_of
from leapgap.jumping.control.jump_sequence import JumpSequence, SequenceConfig
from leapgap.jumping.control.tracking import JumpController, Reference
from leapgap.jumping.experiments.goal_directed_jump import GoalDirectedJump, LandingSamples, Stand
from leapgap.jumping.experiments.goal_shift_jump import ShiftedJumps
from leapgap.jumping.experiments.method import JumpTask, Method
from leapgap.jumping.models.rigid_body import GRAVITY, RigidBody, rigid_body_of
from leapgap.jumping.task import ContactSchedule, metadata_of, of_latest_jump, planned_segments, schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, per_axis, per_pair
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, PAIR_FORCE_AXES
from leapgap.logs.state import commanded_torque, motion_of, pd_torques
from leapgap.robot.kinematics import feet_positions, joint_torque_to_foot_force
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import pitch_of, upright_cosine, yaw_of
from leapgap.simulation.closed_loop import ClosedLoopRun, Disturbance, Sensing, run_closed_loop
from leapgap.simulation.open_loop import Course, MotionPlan, prepare, terrain_slots
from leapgap.simulation.replay import Replayer

LEAST_PUSH_N = 20.0  # A pair of feet pushes if its vertical force is larger; the ratio of small forces means nothing
SUPPLY_V = 21.5  # Limit of |R τ + q̇| at the joint, V, by the motors' data sheet
IMPULSE_S = 0.005  # Ground forces are averaged over this time, because single steps of a simulated contact chatter


@dataclass(frozen=True)
class RunMetrics:
    """Figures over the rows from the start of the first jump to its take-off, over both pairs and all joints."""

    friction: float  # Largest |F_x| / F_z of a pair's ground force while it pushes, 1
    force_n: float  # Largest F_z of a pair, N
    tracking_rad: float  # Root mean square of set point − joint angle, rad
    torque_nm: float  # Largest commanded joint torque, N·m
    short_of_torque: float  # Share of joint-milliseconds in which the data sheet's motors cannot deliver the command


def run_metrics(run: ClosedLoopRun, robot: Robot, first: int) -> RunMetrics:
    """Figures of the jump that begins at row ``first``."""
    schedule, period = schedule_of(run.log), run.log.info.sample_period_s
    rows = slice(first, min(len(run.log), first + round(schedule.take_off_s / period)))
    width = max(1, round(IMPULSE_S / period))
    window = np.ones(width) / width
    of_pairs = [np.convolve(column, window, mode="same") for column in per_pair(robot, run.ground_force).T]
    force = np.stack(of_pairs, axis=1)[rows]
    horizontal, vertical = force[:, FORCE_X], force[:, FORCE_Z]
    pushing = vertical > LEAST_PUSH_N
    joint_vel = run.truth.qvel[rows][:, robot.joint_dofs]
    commanded = commanded_torque(run.log)[rows]
    tracking_error = (run.log.per_joint("cmd_pos") - run.truth.qpos[:, robot.joint_qpos])[rows]
    return RunMetrics(
        friction=float(np.max(np.abs(horizontal[pushing]) / vertical[pushing], initial=0.0)),
        force_n=float(np.max(vertical, initial=0.0)),
        tracking_rad=float(np.sqrt(np.mean(tracking_error**2))),
        torque_nm=float(np.abs(commanded).max()),
        short_of_torque=float(np.mean(np.abs(resistance_of(robot) * commanded + joint_vel) > SUPPLY_V)),
    )


LARGEST_PITCH_RAD = np.deg2rad(15)
STANDS_AFTER_S = 0.5  # A successful landing is still upright after this time
UPRIGHT_COSINE = np.cos(np.deg2rad(30))  # Cosine of the largest angle between the vertical of the base and the world's
FOOT_ABOVE_SURFACE_M = 0.03  # Largest distance of a sole from the target surface, or from blocks on it, to stand on it


@dataclass(frozen=True)
class Landing:
    """Errors are target distance − displacement along the heading at take-off, cm; positive is short."""

    error_cm: float  # Error at the end of the scheduled flight
    contact_error_cm: float | None  # Error when the first foot touches again; None where none does
    pitch_deg: float  # Pitch at the end of the scheduled flight, nose-down
    apex: float  # Largest height of the base, divided by its height at the start
    success: bool  # Pitch below 15°, and half a second later all feet on the target surface and the base upright


def landing(run: ClosedLoopRun, robot: Robot, first: int = 0) -> Landing:
    """Landing of the jump that begins at row ``first``."""
    jump, truth = run.log, run.truth
    schedule, period = schedule_of(jump), jump.info.sample_period_s
    target_x = target_of(jump).x_m
    row, take_off = (
        min(len(jump) - 1, first + round(seconds / period)) for seconds in (schedule.landing_s, schedule.take_off_s)
    )
    end = min(len(jump) - 1, row + round(STANDS_AFTER_S / period))
    position = truth.base_position
    yaw = yaw_of(truth.base_quaternion[first])
    forward = (position - position[first])[:, :2] @ np.array([np.cos(yaw), np.sin(yaw)])
    airborne = np.flatnonzero(~run.touching[take_off:row].any(axis=1))
    left = take_off + airborne[0] if len(airborne) else row
    touched = np.flatnonzero(run.touching[left:].any(axis=1))
    pitch = float(pitch_of(truth.base_quaternion[row]))
    return Landing(
        error_cm=float(100 * (target_x - forward[row])),
        contact_error_cm=float(100 * (target_x - forward[left + touched[0]])) if len(touched) else None,
        pitch_deg=float(np.rad2deg(pitch)),
        apex=float(position[first : end + 1, 2].max() / position[first, 2]),
        success=bool(abs(pitch) < LARGEST_PITCH_RAD and stands(truth, robot, end, target_of(jump).z_m, jump)),
    )


def stands(truth: Motion, robot: Robot, row: int, surface_z_m: float, jump: Log) -> bool:
    """Whether at a row the base is upright and all feet stand on the target surface, which may be a box."""
    feet = feet_positions(robot, truth.qpos[row : row + 1])[0]
    height = feet[:, 2] - robot.foot_radius - surface_z_m
    highest = max((box.top_m - surface_z_m for box in jump.info.terrain), default=0.0)
    on_surface = (height > -FOOT_ABOVE_SURFACE_M) & (height < max(highest, 0.0) + FOOT_ABOVE_SURFACE_M)
    for box in jump.info.terrain:
        if surface_z_m > 0 and box.top_m == surface_z_m:
            on_surface &= np.abs(feet[:, 0] - box.x_m) < box.size_m[0] / 2
    return bool(on_surface.all() and upright_cosine(truth.base_quaternion[row]) > UPRIGHT_COSINE)


Jumps = Callable[[JumpTask], Sequence[JumpController]]  # Returns new controllers of a task's jumps, in their order


@dataclass(frozen=True)
class TrialSetup:
    """Everything that all runs of an experiment have in common."""

    robot: Robot
    sensing: Sensing = field(default_factory=Sensing)
    sequence: SequenceConfig = field(default_factory=SequenceConfig)
    course: Course = field(default_factory=Course)
    body: RigidBody | None = None  # Body that the landing controller assumes; None: the robot's, as plans begin


@dataclass(frozen=True)
class TrialOutcome:
    """The simulated run, its landings, and its fallbacks."""

    run: ClosedLoopRun
    starts: tuple[int, ...]  # Row at which each jump starts
    landings: tuple[Landing, ...]
    total_error_cm: float | None
    """Sum of the jumps' target distances − distance from the first start to the last landing, cm; positive is short.
    None where not all jumps were made."""
    substituted: tuple[tuple[float, str], ...]  # Time, s since the run's first row, and reason of each fallback command
    fallbacks: dict[str, int]  # Count of fallback commands by reason, those of the landings included
    metrics: RunMetrics
    controllers: tuple[JumpController, ...]
    disturbances: tuple[Disturbance, ...]  # What acted on the trunk, times counted from the start of the first jump


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
    # Each jump, with the longest stand before it and its landing, and 0.2 s more.
    one_s = planned.schedule.landing_s + world.sequence.latest_touch_s + world.sequence.landing.duration_s
    whole_s = task.jumps * (Stand.longest_s + (one_s + world.sequence.settle_s)) + 0.2
    course = replace(world.course, after_landing_s=whole_s - planned.schedule.landing_s)
    terrain = (*reference.info.terrain, *task.ground(planned, rng))
    metadata = metadata_of(planned.schedule, task.target)
    level = replace(reference, info=replace(reference.info, extra=metadata, terrain=terrain))
    block_m = task.start_block(rng)
    effects = (*effects, *task.tilt(rng))
    plans = [MotionPlan(task.name, level, block_m, task.rear_start_block(rng), task.crouch_error(robot, rng))]
    disturbances = task.disturbances(rng)
    replayer = Replayer(robot, terrain_slots(plans), threads=1)
    (ready,) = prepare(plans, replayer, effects, course)
    body = world.body or rigid_body_of(robot, planned.joint_pos[0])
    controller = JumpSequence(list(method(task)), robot, world.sequence, body)
    run = run_closed_loop(
        ready, controller, replayer, effects, world.sensing, rng, disturbances, lambda: controller.jumps[0].start_s
    )
    start_times = [jump.start_s for jump in controller.jumps if jump.start_s is not None]
    log = run.log
    if start_times and start_times != [0.0]:  # the schedule alone says what is planned of one jump from the first row
        end_s = float(log.time[-1]) + log.info.sample_period_s
        segments = planned_segments(schedule_of(log), start_times, end_s)
        log = replace(log, info=replace(log.info, stated_segments=segments))
    run = replace(run, log=with_pd_force(log, robot, start_times or (0.0,)))
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


def total_error_cm(run: ClosedLoopRun, task: JumpTask, starts: Sequence[int]) -> float | None:
    """``TrialOutcome.total_error_cm``: true positions, along the heading at the first start."""
    info = run.log.info
    if len(starts) < task.jumps:
        return None
    end = min(len(run.log) - 1, starts[-1] + round(schedule_of(run.log).landing_s / info.sample_period_s))
    yaw = yaw_of(run.truth.base_quaternion[starts[0]])
    way = (run.truth.qpos[end] - run.truth.qpos[starts[0]])[:2] @ np.array([np.cos(yaw), np.sin(yaw)])
    return float(100 * (task.jumps * task.x_m - way))


MOST_N = 1e4  # A foot's larger force is none: the leg's Jacobian is singular, as with a foot as high as the hip


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


LEAVES_WITHIN_S = 0.05  # A foot that touches within this time after the planned take-off has not left the ground yet
UPRIGHT_RAD = 0.5  # A jump that lands with a larger pitch is no sample for the landing model: the robot fell


@dataclass(frozen=True)
class TrialSpec:
    """One closed-loop run to make: the method, the task, the simulated robot and the seed."""

    place: str  # Path of its result, ``<hardware>/<method>/<task>_<number>``; each trial of an experiment has its own
    task: JumpTask
    method: Method
    reference: Log  # The plan of its jumps from level ground
    effects: tuple[Effect, ...]
    world: TrialSetup
    seed: int
    with_log: bool = False

    def run(self) -> "TrialResult":
        """Simulate the run; the same specification gives the same result bit for bit."""
        outcome = attempt_task(
            self.task, self.method, self.reference, self.effects, self.world, np.random.default_rng(self.seed)
        )
        shared = ("landings", "total_error_cm", "fallbacks", "substituted", "metrics")
        return TrialResult(
            **{name: getattr(outcome, name) for name in shared},
            disturbance=", ".join(str(one) for one in outcome.disturbances),
            samples=landing_samples(outcome),
            shifted=shifted_jumps(outcome),
            log=log_of(outcome, self.world.robot, Path(self.place).name) if self.with_log else None,
        )


@dataclass(frozen=True)
class TrialResult:
    """Landings of a trial, what it demanded of the robot, and when its controller fell back."""

    landings: tuple[Landing, ...]
    total_error_cm: float | None
    fallbacks: Mapping[str, int]
    substituted: tuple[tuple[float, str], ...]  # Time, s, and reason of each fallback command
    metrics: RunMetrics
    samples: LandingSamples = field(default_factory=LandingSamples)
    log: Log | None = None
    shifted: ShiftedJumps | None = None  # What goal-directed jumps did on the way; None for other methods
    disturbance: str = ""  # What acted on the trunk, in words; empty if nothing did

    def to_json(self) -> dict[str, Any]:
        """All fields but the log, which is a file of its own."""
        found = {
            "landings": [asdict(one) for one in self.landings],
            "total_error_cm": self.total_error_cm,
            "fallbacks": dict(self.fallbacks),
            "substituted": [list(one) for one in self.substituted],
            "conduct": asdict(self.metrics),
            "disturbance": self.disturbance,
            "tried": {name: values.tolist() for name, values in asdict(self.samples).items()},
        }
        return found if self.shifted is None else found | {"shifted": self.shifted.to_json()}

    @staticmethod
    def from_json(raw: Mapping[str, Any], log: Log | None) -> "TrialResult":
        """The inverse of ``to_json``; numbers in JSON keep all their digits."""
        empty = LandingSamples()
        samples = {n: np.array(v, float).reshape(-1, *getattr(empty, n).shape[1:]) for n, v in raw["tried"].items()}
        return TrialResult(
            landings=tuple(Landing(**one) for one in raw["landings"]),
            total_error_cm=raw["total_error_cm"],
            fallbacks=raw["fallbacks"],
            substituted=tuple((time_s, reason) for time_s, reason in raw["substituted"]),
            metrics=RunMetrics(**raw["conduct"]),
            disturbance=raw["disturbance"],
            samples=LandingSamples(**samples),
            shifted=ShiftedJumps.from_json(raw["shifted"]) if "shifted" in raw else None,
            log=log,
        )


def log_of(outcome: TrialOutcome, robot: Robot, name: str) -> Log:
    """The log with two quantities that only a simulation knows: contacts, and the true ground forces."""
    columns = dict(outcome.run.log.columns)
    columns |= {f"contact/{foot}": outcome.run.touching[:, i].astype(float) for i, foot in enumerate(robot.feet)}
    force = per_pair(robot, outcome.run.ground_force)
    columns |= {f"ground_force/{axis}": force[:, i] for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(outcome.run.log, name=name, columns=columns)


def landing_samples(outcome: TrialOutcome) -> LandingSamples:
    """Goals, stances and landing poses of a run's goal-directed jumps, by the robot's own sensors.

    Jumps without a goal and jumps that fell are left out.
    """
    rows = [(jump.goal, jump.stance_pitch, landing) for jump, landing in upright_jumps(outcome)]
    if not rows:
        return LandingSamples()
    goals, stances, landings = (np.array(column) for column in zip(*rows, strict=True))
    return LandingSamples(goals, stances, landings)


def shifted_jumps(outcome: TrialOutcome) -> ShiftedJumps | None:
    """The same jumps with the shifts of their goals, and the deviations from the plan; None where there are none."""
    rows = [
        (jump.goal, jump.stance_pitch, landing, jump.shifts, jump.deviations)
        for jump, landing in upright_jumps(outcome)
    ]
    if not rows:
        return None
    goal, stance, landing, shift, deviation = (np.array(column) for column in zip(*rows, strict=True))
    return ShiftedJumps(goal, stance, landing, shift, deviation)


def upright_jumps(outcome: TrialOutcome) -> Iterator[tuple[GoalDirectedJump, np.ndarray]]:
    """The goal-directed jumps that did not fall, each with its landing pose."""
    for first, jump in zip(outcome.starts, outcome.controllers, strict=False):  # those never begun have no start
        if isinstance(jump, GoalDirectedJump) and jump.goal is not None:
            landing = landing_pose(outcome, first, jump.reference.schedule, jump.standing_height_m)
            if abs(landing[2]) <= UPRIGHT_RAD:
                yield jump, landing


def landing_pose(outcome: TrialOutcome, first: int, schedule: ContactSchedule, standing_height_m: float) -> np.ndarray:
    """Pose (x, z, pitch; m, m, rad) at the end of the scheduled flight of the jump begun at row ``first``, by its log.

    Where a foot touches earlier, the flight is extrapolated from there as a free one: landings then depend smoothly on
    the goal. x counts from the start along the heading, z from a robot that stands on the floor.
    """
    log, period = outcome.run.log, outcome.run.log.info.sample_period_s
    take_off, end = (first + round(seconds / period) for seconds in (schedule.take_off_s, schedule.landing_s))
    settled = take_off + round(LEAVES_WITHIN_S / period)
    touched = np.flatnonzero(outcome.run.touching[settled:end].any(axis=1))
    row = settled + touched[0] - 1 if len(touched) else end
    left_s = (end - row) * period
    quaternion = log.stack(BASE_QUATERNION)
    yaw = yaw_of(quaternion[first])
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    position, velocity = (log.stack(columns) for columns in (BASE_POSITION, BASE_VELOCITY))
    flown = position[row] + left_s * velocity[row] - np.array([0.0, 0.0, GRAVITY * left_s**2 / 2])
    pitch = pitch_of(quaternion[row]) + left_s * log["base_angvel_y"][row]
    return np.array([(flown - position[first]) @ ahead, flown[2] - standing_height_m, pitch])
