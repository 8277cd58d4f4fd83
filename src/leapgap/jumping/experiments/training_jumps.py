"""Training jumps of the landing model: first to random goals, then to goals that the model chooses."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from leapgap import effects as effects_by_name
from leapgap.effects.base import Effect
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.identification import CONTACT_PARAMETERS, identify_effects_config
from leapgap.jumping.experiments.landing_feedback import ShiftedJumps
from leapgap.jumping.experiments.landing_model import AimConfig, LandingModel, LandingSamples
from leapgap.jumping.experiments.method import Method, References
from leapgap.jumping.experiments.methods.aiming import AimingMethod
from leapgap.jumping.experiments.run_metrics import SUPPLY_V
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial_spec import TrialSpec
from leapgap.jumping.models.corrected_robot import planar_robot_with, plannable
from leapgap.logs.log import Log

DATA_SHEET = (effects_by_name.effect("torque_speed_limit", voltage_v=SUPPLY_V),)
"""Torque limit in the motors' data sheet, which the plans account for."""


SHARED = "practice"
"""Folder of training jumps that do not depend on the method."""
FALLBACK_EFFECT_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Where the identified robot cannot do a jump, it is planned for robots with these shares of the effects, in order."""


@dataclass(frozen=True)
class GoalOffsets:
    """Ranges of uniform random offsets that are added to a chosen goal."""

    x_m: tuple[float, float] = (0.0, 0.0)
    z_m: tuple[float, float] = (0.0, 0.0)
    pitch_rad: tuple[float, float] = (0.0, 0.0)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """One offset (x, z, pitch), (3,), m, m, rad."""
        return rng.uniform(*np.transpose([self.x_m, self.z_m, self.pitch_rad]))


@dataclass(frozen=True)
class PracticeConfig:
    """How many training jumps are made, and to which targets; all of them are on flat ground, never on a box."""

    identify_jumps: int = 4
    """Number of the first jumps, from which effects in the joints are identified for the plans of all later ones."""
    random_jumps: int = 16
    rounds: tuple[int, ...] = (10, 10)
    """Jumps of each later round; their goals are chosen with the model of all jumps before."""
    distance_m: tuple[float, float] = (0.32, 0.78)
    block_m: tuple[float, float] = (0.01, 0.07)
    """Height of a block under the front feet in every second jump, drawn evenly."""
    slope_rad: tuple[float, float] = (-0.005, 0.005)
    """Slope of the ground, drawn evenly."""
    random_beyond: GoalOffsets = field(default_factory=lambda: GoalOffsets((-0.1, 0.1), (-0.04, 0.14), (-0.15, 0.15)))
    """Offsets of the goals of the first jumps. On flat ground a goal may be high above it."""
    later_beyond: GoalOffsets = field(default_factory=lambda: GoalOffsets((-0.03, 0.03), (-0.03, 0.03), (-0.05, 0.05)))
    """Offsets of the goals of all later jumps."""
    aim: AimConfig = field(default_factory=AimConfig)

    def __post_init__(self) -> None:
        """Refuse a practice from which nothing can be learned."""
        if self.identify_jumps < 1 or self.random_jumps < 1 or min(self.rounds, default=0) < 0:
            jumps = f"identify_jumps {self.identify_jumps}, random_jumps {self.random_jumps}"
            raise ValueError(f"{jumps}, rounds {list(self.rounds)}: 1 or more, 1 or more, 0 or more each")


class GoalMethod(Protocol):
    """A method whose goals can be moved for exploration."""

    def explore(self, offset: np.ndarray, references: References, rng: np.random.Generator) -> Method:
        """The method with ``offset`` (3,) added to its goals; it may draw more exploration of its own."""


@dataclass(frozen=True)
class PracticeResult:
    """A planner with the identified effects, and the samples of the landing model."""

    planner: JumpPlanner
    effects: tuple[Effect, ...]
    """Effects identified in the robot's joints."""
    samples: LandingSamples
    jumps: ShiftedJumps | None = None
    """The jumps of the samples with what was measured on the way; None where no jump was upright."""
    logs: tuple[Log, ...] = ()
    """The jumps that the effects were identified from."""


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
    logs: tuple[Log, ...] = ()
    """The jumps that they were identified from."""


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
