"""Training jumps of the landing model: first to random goals, then to goals that the model chooses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leapgap import effects as effects_by_name
from leapgap.effects.base import Effect
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner, LandingModel, LandingSamples
from leapgap.jumping.experiments.goal_shift_jump import ShiftedJumps
from leapgap.jumping.experiments.identification import identify_effects_config
from leapgap.jumping.experiments.method import AimingMethod, JumpTask
from leapgap.jumping.experiments.rig import Bench, GoalOffsets, PracticeConfig
from leapgap.jumping.experiments.trial import SUPPLY_V, TrialSpec
from leapgap.jumping.models.planar import planar_robot_with, plannable
from leapgap.logs.log import Log

DATA_SHEET = (effects_by_name.effect("torque_speed_limit", voltage_v=SUPPLY_V),)
"""Torque limit in the motors' data sheet, which the plans account for."""


SHARED = "practice"  # Folder of training jumps that do not depend on the method
FALLBACK_EFFECT_SHARES = (0.75, 0.5, 0.25, 0.0)
"""Where the identified robot cannot do a jump, it is planned for robots with these shares of the effects, in order."""


@dataclass(frozen=True)
class PracticeResult:
    """A planner with the identified effects, and the samples of the landing model."""

    planner: JumpPlanner
    effects: tuple[Effect, ...]  # Effects identified in the robot's joints
    samples: LandingSamples
    jumps: ShiftedJumps | None = None  # Jumps of the samples with what was measured; None where none was upright
    logs: tuple[Log, ...] = ()  # The jumps that the effects were identified from


def run_practice(bench: Bench, method: AimingMethod, config: PracticeConfig, folder: str = SHARED) -> PracticeResult:
    """Make all training jumps: identify the joints' effects, then collect samples for the landing model.

    Methods that practise alike share a ``folder``, and so their jumps; all share those for the identification.
    """
    rng = np.random.default_rng([bench.seed, 7])

    def trials(name: str, jumps: int, offsets: GoalOffsets, own: str, with_log: bool = False) -> list[TrialSpec]:
        """Trials of the method at random tasks, with random offsets of their goals."""
        drawn = []
        for i in range(jumps):
            block = config.block_m if i % 2 else (0.0, 0.0)
            distance_m = round(float(rng.uniform(*config.distance_m)), 3)
            task = JumpTask(name, distance_m, block_m=block, slope_rad=config.slope_rad)
            moved = replace(method, goal_offset=offsets.draw(rng), references={task.target: bench.level})
            place, seed = f"{bench.hardware}/{own}/{name}_{i:02d}", int(rng.integers(2**31))
            drawn.append(TrialSpec(place, task, moved, bench.level, bench.effects, bench.world, seed, with_log))
        return drawn

    made = bench.runner.results(trials("identify", config.identify_jumps, GoalOffsets(), SHARED, with_log=True))
    logs = tuple(result.log for result in made if result.log is not None)
    found, samples = identify_on(bench, logs), LandingSamples()
    method = replace(method, planner=planner_with(bench, method, found, config))
    upright: list[ShiftedJumps] = []
    for number, jumps in enumerate((config.random_jumps, *config.rounds)):
        method = replace(method, landing=LandingModel(samples, config.aim) if len(samples) else None)
        offsets = config.later_beyond if number else config.random_beyond
        for result in bench.runner.results(trials(f"round_{number}", jumps, offsets, folder)):
            samples = samples.extended_by(result.samples)
            upright += [] if result.shifted is None else [result.shifted]
    joined = ShiftedJumps.join(upright) if upright else None
    assert method.planner is not None
    return PracticeResult(method.planner, found, samples, joined, logs)


def planner_with(bench: Bench, method: AimingMethod, found: Sequence[Effect], config: PracticeConfig) -> JumpPlanner:
    """The method's planner for the robot that has the identified effects.

    Plans of different robots do not form one family. So the robot is chosen once: that with the largest share of the
    effects whose family reaches the ends of what is practised; where none does, that with all of the effects.
    """
    planner, robots = method.planner, []
    assert planner is not None
    parts: list[tuple[Effect, Mapping[str, Any]]] = [(effect, effect.values) for effect in plannable(found)]
    for share in (1.0, *FALLBACK_EFFECT_SHARES):
        scaled = [replace(one, **{name: share * value for name, value in values.items()}) for one, values in parts]
        robots.append(planar_robot_with(bench.robot, scaled))
    (near, far), high = config.distance_m, config.random_beyond.z_m[1]
    ends = [np.array(goal) for goal in ((near, 0.0, 0.0), (far, 0.0, 0.0), ((near + far) / 2, high, 0.0))]
    chosen = bench.runner.call(first_that_reaches, [replace(planner, robot=robot) for robot in robots], ends)
    robot, *fallback_robots = robots[chosen:]
    return replace(planner, robot=robot, fallback_robots=tuple(fallback_robots))


def first_that_reaches(planners: Sequence[JumpPlanner], ends: Sequence[np.ndarray]) -> int:
    """Number of the first planner that reaches all of the goals (3,); 0 where none does."""
    return next((i for i, planner in enumerate(planners) if planner.reaches(ends)), 0)


def identify_on(bench: Bench, logs: Sequence[Log], folder: str = SHARED, *fitted: Any) -> tuple[Effect, ...]:
    """Effects by the logs, those in the joints unless others are ``fitted``; from the cache where they are there."""
    place = f"{bench.hardware}/{folder}/identified"
    found = bench.runner.value(place, identify_effects_config, list(logs), bench.robot, DATA_SHEET, *fitted)
    return effects_by_name.from_config(found["effects"])
