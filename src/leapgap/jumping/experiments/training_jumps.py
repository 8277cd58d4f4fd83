"""Training jumps of the landing model: first to random goals, then to goals that the model chooses."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from leapgap import effects
from leapgap import effects as effects_by_name
from leapgap.effects.base import Effect
from leapgap.jumping.control.shifted_plan import Observation
from leapgap.jumping.control.tracking import JumpController, Reference
from leapgap.jumping.experiments.goal_directed_jump import (
    GoalChoice,
    GoalDirectedJump,
    JumpPlanner,
    LandingModel,
    LandingSamples,
    best_goal,
)
from leapgap.jumping.experiments.goal_shift_jump import ShiftedJumps
from leapgap.jumping.experiments.method import JumpTask, Method, References
from leapgap.jumping.experiments.rig import Bench
from leapgap.jumping.experiments.settings import GoalOffsets, PracticeConfig
from leapgap.jumping.experiments.trial import SUPPLY_V, TrialSpec
from leapgap.jumping.models.planar import planar_robot_with, plannable
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


@dataclass(frozen=True)
class FitParameter:
    """One parameter of an effect to fit, and the size of a typical change of it, in the parameter's unit."""

    effect: str
    parameter: str
    scale: float
    starts: tuple[float, ...] = (0.3,)
    """Values from which the fit starts, in units of ``scale``: where a fit ends may depend on it."""


JOINT_PARAMETERS = (
    FitParameter("joint_damping", "damping", 0.5),
    FitParameter("joint_friction", "torque_nm", 0.5),
    FitParameter("armature", "inertia", 0.02),
    FitParameter("command_delay", "delay_s", 0.003),
)
CONTACT_PARAMETERS = (*JOINT_PARAMETERS, FitParameter("foot_compliance", "time_constant_s", 0.005, starts=(4.0, 5.6)))
"""With the softness of the feet. Plans cannot account for it, but a simulation can. Hard and soft feet are separate
minima, so the fit starts from both."""
BASE_SCALE, JOINT_SCALE = (0.05, 0.05, 0.1), 0.1
"""Errors of x, z and pitch of the base (m, m, rad) and of a joint (rad) that count alike in the fit."""
COMPARISON_STEP_S = 0.02  # Simulated and measured motions are compared at this interval


def identify_effects_config(
    logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...], fitted: Sequence[FitParameter] = JOINT_PARAMETERS
) -> dict[str, Any]:
    """``identify_effects`` in the form of a configuration, which a JSON file can hold."""
    return {"effects": effects.to_config(identify_effects(logs, robot, known, fitted))}


def identify_effects(
    logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...] = (), fitted: Sequence[FitParameter] = JOINT_PARAMETERS
) -> tuple[Effect, ...]:
    """The effects of ``fitted``, with the parameters whose replays come nearest to the measured motion.

    The effects ``known`` act as well and are not fitted; an example is the limit in the motors' data sheet.
    """
    from scipy.optimize import least_squares  # most processes read this file and fit nothing

    replayer = Replayer(robot, max((len(log.info.terrain) for log in logs), default=0) or 1)
    kinds = effects.known()
    ranges = [next(p for p in kinds[u.effect].parameters(robot) if p.name == u.parameter) for u in fitted]
    scale = np.array([u.scale for u in fitted])
    rows = [min(log.rows_before_gain_change, round(1.1 / log.info.sample_period_s)) for log in logs]

    def effects_with(sizes: np.ndarray) -> tuple[Effect, ...]:
        values = zip(fitted, sizes * scale, strict=True)
        entries: list[Mapping[str, Any]] = [{"name": u.effect, u.parameter: float(value)} for u, value in values]
        return effects.from_config(entries)

    def residuals(sizes: np.ndarray) -> np.ndarray:
        acting = (*known, *effects_with(sizes))
        motions = [replayer.motions([Rollout(log, acting)], count)[0] for log, count in zip(logs, rows, strict=True)]
        return np.concatenate([difference(m.qpos, log, robot) for m, log in zip(motions, logs, strict=True)])

    # Only additions to the model are fitted: no parameter goes below its nominal value.
    bounds = np.array([[max(p.lower, p.nominal) for p in ranges], [p.upper for p in ranges]]) / scale
    starts = [np.clip(np.array(start), *bounds) for start in itertools.product(*(u.starts for u in fitted))]
    fits = [
        least_squares(residuals, start, bounds=bounds, loss="soft_l1", diff_step=0.05, max_nfev=15) for start in starts
    ]
    return effects_with(np.clip(min(fits, key=lambda fit: float(fit.cost)).x, *bounds))


def difference(qpos: np.ndarray, log: Log, robot: Robot) -> np.ndarray:
    """Simulated minus measured x, z, pitch and joints every ``COMPARISON_STEP_S``, divided by their scales, (n,)."""
    at = slice(0, len(qpos), log.info.rows(COMPARISON_STEP_S))
    pitch = pitch_of(qpos[at, 3:7]) - log.pitch[: len(qpos)][at]
    base = qpos[at, 0] - log["base_pos_x"][: len(qpos)][at], qpos[at, 2] - log["base_pos_z"][: len(qpos)][at]
    joints = (qpos[at][:, robot.joint_qpos] - log.per_joint("joint_pos", robot.joints)[: len(qpos)][at]) / JOINT_SCALE
    x_scale, z_scale, pitch_scale = BASE_SCALE
    return np.concatenate([base[0] / x_scale, base[1] / z_scale, pitch / pitch_scale, joints.ravel()])


@dataclass(frozen=True)
class AimingMethod(Method):
    """Plans from the measured stance to the goal that a landing model says will land on the target."""

    planner: JumpPlanner | None = None
    landing: LandingModel | None = None
    offset: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By name of the task: mean landing − predicted landing of its jumps, (3,), m, m, rad."""
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Added to each goal for exploration, (3,), m, m, rad."""
    observation: Observation = field(default_factory=Observation)  # When deviations from the plan are kept

    def explore(self, offset: np.ndarray, references: References, rng: np.random.Generator) -> "AimingMethod":
        """The method with an offset (3,) of its goals."""
        del rng
        return replace(self, goal_offset=offset, references=references)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured."""
        assert self.planner is not None
        offset = self.offset.get(task.name)

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(self.landing, target, stance_pitch, offset) + self.goal_offset

        choice = GoalChoice(task.target, self.planner, aim, task.stance_is_seen, observation=self.observation)
        return GoalDirectedJump(choice, reference, self.robot, self.gains)


DATA_SHEET = (effects_by_name.effect("torque_speed_limit", voltage_v=SUPPLY_V),)
"""Torque limit in the motors' data sheet, which the plans account for."""


SHARED = "practice"  # Folder of training jumps that do not depend on the method
FALLBACK_EFFECT_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Where the identified robot cannot do a jump, it is planned for robots with these shares of the effects, in order."""


class GoalMethod(Protocol):
    """A method whose goals can be moved for exploration."""

    def explore(self, offset: np.ndarray, references: References, rng: np.random.Generator) -> Method:
        """The method with ``offset`` (3,) added to its goals; it may draw more exploration of its own."""


@dataclass(frozen=True)
class PracticeResult:
    """A planner with the identified effects, and the samples of the landing model."""

    planner: JumpPlanner
    effects: tuple[Effect, ...]  # Effects identified in the robot's joints
    samples: LandingSamples
    jumps: ShiftedJumps | None = None
    """The jumps of the samples with what was measured on the way; None where no jump was upright."""
    logs: tuple[Log, ...] = ()  # The jumps that the effects were identified from


@dataclass(frozen=True)
class PracticeDraws:
    """Draws the tasks of training jumps, all with one generator."""

    bench: Bench
    config: PracticeConfig
    rng: np.random.Generator
    folder: str = SHARED

    def trials(
        self, name: str, jumps: int, method: GoalMethod, offsets: GoalOffsets, with_log: bool = False
    ) -> list[TrialSpec]:
        """Trials of a method at random tasks, with random offsets of their goals."""
        bench, config, rng = self.bench, self.config, self.rng
        drawn = []
        for i in range(jumps):
            block = config.block_m if i % 2 else (0.0, 0.0)
            distance_m = round(float(rng.uniform(*config.distance_m)), 3)
            task = JumpTask(name, distance_m, block_m=block, slope_rad=config.slope_rad)
            own = method.explore(offsets.draw(rng), {task.target: bench.level}, rng)
            place, seed = f"{bench.hardware}/{self.folder}/{name}_{i:02d}", int(rng.integers(2**31))
            drawn.append(TrialSpec(place, task, own, bench.level, bench.effects, bench.world, seed, with_log))
        return drawn


@dataclass(frozen=True)
class IdentifiedRobot:
    """A planner for the robot with the effects that were identified in its joints."""

    planner: JumpPlanner
    effects: tuple[Effect, ...]
    logs: tuple[Log, ...] = ()  # The jumps that they were identified from


def identify_robot(draws: PracticeDraws, method: AimingMethod) -> IdentifiedRobot:
    """Make the first jumps, identify the joints' effects from them, and plan for the robot that has them.

    Plans of different robots do not form one family. So the robot is chosen once: that with the largest share of the
    effects whose family reaches the ends of what is practised; where none does, that with all of the effects.
    """
    bench, config = draws.bench, draws.config
    # Methods that share this practice share these jumps.
    trials = replace(draws, folder=SHARED).trials(
        "identify", config.identify_jumps, method, GoalOffsets(), with_log=True
    )
    logs = [result.log for result in bench.runner.results(trials) if result.log is not None]
    found = identify_joint_effects(bench, logs)
    assert method.planner is not None
    robots = [planar_robot_with(bench.robot, scale_effects(found, share)) for share in (1.0, *FALLBACK_EFFECT_SHARES)]
    planner = method.planner
    chosen = bench.runner.call(first_that_reaches, [replace(planner, robot=robot) for robot in robots], ends_of(config))
    robot, *fallback_robots = robots[chosen:]
    return IdentifiedRobot(replace(planner, robot=robot, fallback_robots=tuple(fallback_robots)), found, tuple(logs))


def first_that_reaches(planners: Sequence[JumpPlanner], ends: Sequence[np.ndarray]) -> int:
    """Number of the first planner that reaches all of the goals (3,); 0 where none does."""
    return next((i for i, planner in enumerate(planners) if planner.reaches(ends)), 0)


def ends_of(config: PracticeConfig) -> list[np.ndarray]:
    """The nearest and the farthest goal of practice, and the highest in the middle between them, (3,) each."""
    near, far = config.distance_m
    high = config.random_beyond.z_m[1]
    return [np.array([near, 0.0, 0.0]), np.array([far, 0.0, 0.0]), np.array([(near + far) / 2, high, 0.0])]


def run_practice(bench: Bench, method: AimingMethod, config: PracticeConfig, folder: str = SHARED) -> PracticeResult:
    """Make all training jumps: identify the joints' effects, then collect samples for the landing model.

    Methods that practise alike share a ``folder``, and so their jumps.
    """
    draws = PracticeDraws(bench, config, np.random.default_rng([bench.seed, 7]), folder)
    identified = identify_robot(draws, method)
    method, samples = replace(method, planner=identified.planner), LandingSamples()
    upright: list[ShiftedJumps] = []
    for number, jumps in enumerate((config.random_jumps, *config.rounds)):
        landing = LandingModel(samples, config.aim) if len(samples) else None
        offsets = config.later_beyond if number else config.random_beyond
        for result in bench.runner.results(
            draws.trials(f"round_{number}", jumps, replace(method, landing=landing), offsets)
        ):
            samples = samples.extended_by(result.samples)
            upright += [] if result.shifted is None else [result.shifted]
    joined = ShiftedJumps.join(upright) if upright else None
    return PracticeResult(identified.planner, identified.effects, samples, joined, identified.logs)


def scale_effects(found: Sequence[Effect], share: float) -> tuple[Effect, ...]:
    """The effects that plans can account for, with all their values multiplied by ``share``; 0 gives no change."""
    scaled: list[Effect] = []
    for effect in plannable(found):
        values: dict[str, Any] = {name: share * value for name, value in effect.values.items()}
        scaled.append(replace(effect, **values))
    return tuple(scaled)


def identify_joint_effects(bench: Bench, logs: Sequence[Log]) -> tuple[Effect, ...]:
    """Effects in the joints by the logs, from the cache of the bench where they are there."""
    place = f"{bench.hardware}/practice/identified"
    found = bench.runner.value(place, identify_effects_config, list(logs), bench.robot, DATA_SHEET)
    return effects_by_name.from_config(found["effects"])


def identify_contact_effects(bench: Bench, logs: Sequence[Log], folder: str) -> tuple[Effect, ...]:
    """The same with the softness of the feet, for simulations; ``folder`` is that of the method's practice."""
    place = f"{bench.hardware}/{folder}/identified"
    fitted = CONTACT_PARAMETERS
    found = bench.runner.value(place, identify_effects_config, list(logs), bench.robot, DATA_SHEET, fitted)
    return effects_by_name.from_config(found["effects"])
