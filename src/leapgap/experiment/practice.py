"""Practice: jumps from which a robot learns where it lands, first at random, then where it believes to land well."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.effects.base import Effect
from leapgap.experiment.aimed import AimedJump
from leapgap.experiment.aiming import AimConfig, LandingModel, Tried
from leapgap.experiment.methods import ByAiming
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import Outcome, World, attempt_task
from leapgap.recording.jump import Jump, pitch_of, yaw_of

Spread = tuple[float, float, float]


@dataclass(frozen=True)
class PracticeConfig:
    """How a robot practises; all targets are on the flat: a box is never among them."""

    random_jumps: int = 20
    rounds: tuple[int, ...] = (10, 10)
    """Jumps of each later round, aimed with what was learned until then."""
    distance_m: tuple[float, float] = (0.35, 0.75)
    block_m: tuple[float, float] = (0.0, 0.07)
    """Under the front feet in every second jump."""
    random_beyond: Spread = (0.1, 0.08, 0.2)
    """Largest excitation of the goals of the first jumps, drawn evenly: m, m, rad."""
    later_beyond: Spread = (0.03, 0.03, 0.05)
    """Of the later ones."""
    aim: AimConfig = field(default_factory=AimConfig)


@dataclass(frozen=True)
class Attempt:
    """One jump to practise."""

    task: Task
    method: ByAiming
    reference: Jump
    effects: tuple[Effect, ...]
    world: World
    seed: int

    def made(self) -> Tried:
        """Jump, and say what was tried and where it landed, as the sensors tell."""
        outcome = attempt_task(
            self.task, self.method, self.reference, self.effects, self.world, np.random.default_rng(self.seed)
        )
        return tried_in(outcome)


Mapper = Callable[[Sequence[Attempt]], Sequence[Tried]]
"""Makes attempts, maybe at the same time; results in their order."""


def practise(
    method: ByAiming,
    level: Jump,
    effects: tuple[Effect, ...],
    world: World,
    config: PracticeConfig,
    rng: np.random.Generator,
    make: Mapper,
) -> Tried:
    """All jumps of the practice; ``level`` is any plan from level ground, to start from its first pose."""
    tried = Tried()
    for number, jumps in enumerate((config.random_jumps, *config.rounds)):
        landing = LandingModel(tried, config.aim) if len(tried) else None
        spread = np.array(config.later_beyond if number else config.random_beyond)
        attempts = []
        for i in range(jumps):
            block = config.block_m if i % 2 else (0.0, 0.0)
            task = Task("practice", round(float(rng.uniform(*config.distance_m)), 3), block_m=block)
            beyond = spread * rng.uniform(-1, 1, 3)
            attempts.append(
                Attempt(
                    task,
                    replace(method, landing=landing, beyond=beyond, references={task.target: level}),
                    level,
                    effects,
                    world,
                    int(rng.integers(2**31)),
                )
            )
        for made in make(attempts):
            tried = tried.and_also(made)
    return tried


def tried_in(outcome: Outcome, upright_rad: float = 0.8) -> Tried:
    """What was tried in a run and where it landed, by its log; jumps that turned over teach nothing."""
    log, rows = outcome.run.log, []
    position = log.stack(("base_pos_x", "base_pos_y", "base_pos_z"))
    quaternion = log.stack(("base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z"))
    for first, jump in zip(outcome.starts, outcome.controllers, strict=True):
        assert isinstance(jump, AimedJump)
        end = first + round(jump.reference.schedule.landing_s / log.info.sample_period_s)
        pitch = float(pitch_of(quaternion[end]))
        if jump.goal is None or abs(pitch) > upright_rad:
            continue
        yaw = yaw_of(quaternion[first])
        x = (position[end] - position[first])[:2] @ np.array([np.cos(yaw), np.sin(yaw)])
        z = position[end, 2] - jump.standing_height_m
        rows.append((jump.goal, jump.stance_pitch, [x, z, pitch]))
    if not rows:
        return Tried()
    goals, stances, landings = (np.array(column) for column in zip(*rows, strict=True))
    return Tried(goals, stances, landings)
