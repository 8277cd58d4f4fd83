"""Practice: jumps from which a robot learns where it lands, first at random, then where it believes to land well."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap import effects as effects_by_name
from leapgap.effects.base import Effect
from leapgap.experiment.aimed import AimedJump, JumpPlanner
from leapgap.experiment.aiming import AimConfig, LandingModel, Tried
from leapgap.experiment.identify import identified, plannable, planned_with
from leapgap.experiment.methods import ByAiming
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import Outcome, World, attempt_task
from leapgap.recording.jump import Jump, pitch_of, yaw_of

Spread = tuple[float, float, float]

DATA_SHEET = (effects_by_name.effect("torque_speed_limit", voltage_v=21.5),)
"""What the motors' maker says, and the plans reckon with."""


@dataclass(frozen=True)
class PracticeConfig:
    """How a robot practises; all targets are on the flat: a box is never among them."""

    identify_jumps: int = 4
    """First ones, from which joint damping and inertia are found for the plans of all later ones."""
    random_jumps: int = 16
    rounds: tuple[int, ...] = (10, 10)
    """Jumps of each later round, aimed with what was learned until then."""
    distance_m: tuple[float, float] = (0.35, 0.75)
    block_m: tuple[float, float] = (0.0, 0.07)
    """Under the front feet in every second jump."""
    random_beyond: Spread = (0.1, 0.06, 0.15)
    """Largest excitation of the goals of the first jumps, drawn evenly: m, m, rad."""
    later_beyond: Spread = (0.03, 0.03, 0.05)
    """Of the later ones."""
    aim: AimConfig = field(default_factory=AimConfig)


@dataclass(frozen=True)
class Learned:
    """What a robot knows of itself after practice."""

    planner: JumpPlanner
    found: tuple[Effect, ...]
    """Effects identified in its joints."""
    tried: Tried


@dataclass(frozen=True)
class Attempt:
    """One jump to practise."""

    task: Task
    method: ByAiming
    reference: Jump
    effects: tuple[Effect, ...]
    world: World
    seed: int

    def made(self) -> tuple[Tried, Jump]:
        """Jump, and say what was tried and where it landed, as the sensors tell; with the log."""
        outcome = attempt_task(
            self.task, self.method, self.reference, self.effects, self.world, np.random.default_rng(self.seed)
        )
        return tried_in(outcome), outcome.run.log


Mapper = Callable[[Sequence[Attempt]], Sequence[tuple[Tried, Jump]]]
"""Makes attempts, maybe at the same time; results in their order."""


def practise(
    method: ByAiming,
    level: Jump,
    effects: tuple[Effect, ...],
    world: World,
    config: PracticeConfig,
    rng: np.random.Generator,
    make: Mapper,
) -> Learned:
    """All jumps of the practice; ``level`` is any plan from level ground, to start from its first pose."""

    def attempts(jumps: int, chosen: ByAiming, spread: Spread) -> list[Attempt]:
        made = []
        for i in range(jumps):
            block = config.block_m if i % 2 else (0.0, 0.0)
            task = Task("practice", round(float(rng.uniform(*config.distance_m)), 3), block_m=block)
            beyond = np.array(spread) * rng.uniform(-1, 1, 3)
            own = replace(chosen, beyond=beyond, references={task.target: level})
            made.append(Attempt(task, own, level, effects, world, int(rng.integers(2**31))))
        return made

    first = make(attempts(config.identify_jumps, method, (0.0, 0.0, 0.0)))
    found = identified([log for _, log in first], world.robot, DATA_SHEET)
    assert method.planner is not None
    planner = replace(method.planner, robot=planned_with(world.robot, plannable(found)))
    method, tried = replace(method, planner=planner), Tried()
    for number, jumps in enumerate((config.random_jumps, *config.rounds)):
        landing = LandingModel(tried, config.aim) if len(tried) else None
        spread = config.later_beyond if number else config.random_beyond
        for one, _ in make(attempts(jumps, replace(method, landing=landing), spread)):
            tried = tried.and_also(one)
    return Learned(planner, found, tried)


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
