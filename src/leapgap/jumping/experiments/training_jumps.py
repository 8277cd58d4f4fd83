"""Practice: jumps from which a robot learns where it lands, first at random, then where it believes to land well."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leapgap import effects as effects_by_name
from leapgap.effects.base import Effect
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.identification import identified_config
from leapgap.jumping.experiments.landing_model import AimConfig, LandingModel, Tried
from leapgap.jumping.experiments.methods.aiming import ByAiming
from leapgap.jumping.experiments.run_metrics import SUPPLY_V
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial_spec import TrialSpec
from leapgap.jumping.models.corrected_robot import plannable, planned_with
from leapgap.logs.log import Log

DATA_SHEET = (effects_by_name.effect("torque_speed_limit", voltage_v=SUPPLY_V),)
"""What the motors' maker says, and the plans reckon with."""


NIMBLER = (0.75, 0.5, 0.25, 0.0)
"""Shares of the found effects in the robots that are planned for where the found one itself cannot do a jump."""


@dataclass(frozen=True)
class Beyond:
    """Ranges from which goals are drawn, evenly, beyond what is believed to be best."""

    x_m: tuple[float, float] = (0.0, 0.0)
    z_m: tuple[float, float] = (0.0, 0.0)
    pitch_rad: tuple[float, float] = (0.0, 0.0)

    def drawn(self, rng: np.random.Generator) -> np.ndarray:
        """(3,), m, m, rad."""
        return rng.uniform(*np.transpose([self.x_m, self.z_m, self.pitch_rad]))


@dataclass(frozen=True)
class PracticeConfig:
    """How a robot practises; all targets are on the flat: a box is never among them."""

    identify_jumps: int = 4
    """First ones, from which joint damping and inertia are found for the plans of all later ones."""
    random_jumps: int = 16
    rounds: tuple[int, ...] = (10, 10)
    """Jumps of each later round, aimed with what was learned until then."""
    distance_m: tuple[float, float] = (0.32, 0.78)
    block_m: tuple[float, float] = (0.01, 0.07)
    """Under the front feet in every second jump."""
    slope_rad: tuple[float, float] = (-0.005, 0.005)
    """Of the ground."""
    random_beyond: Beyond = field(default_factory=lambda: Beyond((-0.1, 0.1), (-0.04, 0.14), (-0.15, 0.15)))
    """Excitation of the first jumps; on the flat a jump may be aimed to be high in the air at its scheduled landing."""
    later_beyond: Beyond = field(default_factory=lambda: Beyond((-0.03, 0.03), (-0.03, 0.03), (-0.05, 0.05)))
    """Of the later ones."""
    aim: AimConfig = field(default_factory=AimConfig)


@dataclass(frozen=True)
class Learned:
    """What a robot knows of itself after practice."""

    planner: JumpPlanner
    found: tuple[Effect, ...]
    """Effects identified in its joints."""
    tried: Tried


def practised(bench: Bench, method: ByAiming, config: PracticeConfig) -> Learned:
    """What a robot learns from all jumps of the practice."""
    rng = np.random.default_rng([bench.seed, 7])

    def attempts(name: str, jumps: int, chosen: ByAiming, beyond: Beyond, with_log: bool = False) -> list[TrialSpec]:
        made = []
        for i in range(jumps):
            block = config.block_m if i % 2 else (0.0, 0.0)
            distance_m = round(float(rng.uniform(*config.distance_m)), 3)
            task = JumpTask(name, distance_m, block_m=block, slope_rad=config.slope_rad)
            own = replace(chosen, beyond=beyond.drawn(rng), references={task.target: bench.level})
            place, seed = f"{bench.hardware}/practice/{name}_{i:02d}", int(rng.integers(2**31))
            made.append(TrialSpec(place, task, own, bench.level, bench.effects, bench.world, seed, with_log))
        return made

    trials = attempts("identify", config.identify_jumps, method, Beyond(), with_log=True)
    logs = [done.log for done in bench.runner.results(trials) if done.log is not None]
    found = identified_once(bench, logs)
    assert method.planner is not None
    robot, *nimbler = (planned_with(bench.robot, shares(found, share)) for share in (1.0, *NIMBLER))
    planner = replace(method.planner, robot=robot, nimbler=tuple(nimbler))
    method, tried = replace(method, planner=planner), Tried()
    for number, jumps in enumerate((config.random_jumps, *config.rounds)):
        landing = LandingModel(tried, config.aim) if len(tried) else None
        beyond = config.later_beyond if number else config.random_beyond
        for done in bench.runner.results(attempts(f"round_{number}", jumps, replace(method, landing=landing), beyond)):
            tried = tried.and_also(done.tried)
    return Learned(planner, found, tried)


def shares(found: Sequence[Effect], share: float) -> tuple[Effect, ...]:
    """Of the effects that plans can reckon with, all of them nothing at the size 0."""
    scaled: list[Effect] = []
    for effect in plannable(found):
        values: dict[str, Any] = {name: share * value for name, value in effect.values.items()}
        scaled.append(replace(effect, **values))
    return tuple(scaled)


def identified_once(bench: Bench, logs: Sequence[Log]) -> tuple[Effect, ...]:
    """Effects of the joints by the logs; identified once and kept in the cache of the bench."""
    place = f"{bench.hardware}/practice/identified"
    found = bench.runner.value(place, identified_config, list(logs), bench.robot, DATA_SHEET)
    return effects_by_name.from_config(found["effects"])
