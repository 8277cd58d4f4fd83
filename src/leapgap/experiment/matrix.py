"""The whole matrix of experiments on one robot with effects: practice, shifts, adaptation, then everything scored."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from leapgap.control.gains import PhaseGains
from leapgap.effects.base import Effect
from leapgap.experiment.aiming import LandingModel, Tried
from leapgap.experiment.methods import ByAiming, ByJointPd, Method, References
from leapgap.experiment.practice import Attempt, Learned, PracticeConfig, practise, tried_in
from leapgap.experiment.scores import Scored
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import World, attempt_task
from leapgap.recording.jump import Jump, Target

Item = TypeVar("Item")
Result = TypeVar("Result")
Mapper = Callable[[Callable[[Item], Result], Sequence[Item]], Iterator[Result]]


@dataclass(frozen=True)
class Trial:
    """One run to make; data, so that it travels to worker processes."""

    hardware: str
    name: str
    """Of the method."""
    task: Task
    method: Method
    reference: Jump
    effects: tuple[Effect, ...]
    world: World
    seed: int

    def done(self) -> "Done":
        """Make it."""
        rng = np.random.default_rng(self.seed)
        outcome = attempt_task(self.task, self.method, self.reference, self.effects, self.world, rng)
        scored = Scored(
            self.hardware, self.name, self.task.name, self.task.jumps, outcome.landings, dict(outcome.fallbacks)
        )
        tried = tried_in(outcome) if isinstance(self.method, ByAiming) else Tried()
        return Done(scored, outcome.run.log, tried)


@dataclass(frozen=True)
class Done:
    """What came of a trial."""

    scored: Scored
    log: Jump
    tried: Tried


@dataclass(frozen=True)
class AdaptConfig:
    """How an offset a task is learned from its own jumps."""

    jumps: int = 4
    """Of each task, one after the other."""
    rate: float = 0.7
    """Share of a surprise that is believed."""


@dataclass(frozen=True)
class Bench:
    """One simulated robot, and what all its trials share."""

    hardware: str
    effects: tuple[Effect, ...]
    world: World
    references: References
    gains: PhaseGains = field(default_factory=PhaseGains)
    seed: int = 0

    def trial(self, name: str, method: Method, task: Task, number: int) -> Trial:
        """The same number gives the same ground and sensors to every method."""
        level = self.references[task.target]
        seed = int(np.random.SeedSequence([self.seed, number, *task.name.encode()]).generate_state(1)[0])
        return Trial(self.hardware, name, task, method, level, self.effects, self.world, seed)


def best_shift(bench: Bench, tasks: Sequence[Task], extend: Callable[[Target], Jump], run: Mapper) -> ByJointPd:
    """Joint PD with the constant shift of the target that lands best over some tasks: two steps of correction."""
    references = dict(bench.references)
    method = ByJointPd(bench.world.robot, references, bench.gains)
    for number in range(2):
        trials = [bench.trial("joint_pd_shifted", method, task, 900 + number) for task in tasks]
        errors = [done.scored.landings[0].error_cm / 100 for done in run(Trial.done, trials)]
        shift = round(method.shift_m + float(np.mean(errors)), 3)
        for task in tasks:
            goal = Target(round(task.x_m + shift, 3), task.z_m)
            references.setdefault(goal, extend(goal))
        method = replace(method, references=dict(references), shift_m=shift)
    return method


def practised(bench: Bench, method: ByAiming, config: PracticeConfig, run: Mapper) -> Learned:
    """What ``ours`` learns from its own jumps on this robot."""
    rng = np.random.default_rng([bench.seed, 7])
    level = next(iter(bench.references.values()))

    def make(attempts: Sequence[Attempt]) -> Sequence[tuple[Tried, Jump]]:
        return list(run(Attempt.made, attempts))

    return practise(method, level, bench.effects, bench.world, config, rng, make)


def adapted(bench: Bench, method: ByAiming, tasks: Sequence[Task], config: AdaptConfig, run: Mapper) -> ByAiming:
    """With an offset for each task, learned from its own first jumps."""
    assert method.landing is not None
    for number in range(config.jumps):
        trials = [bench.trial("adapting", method, task, 800 + number) for task in tasks]
        offset = dict(method.offset)
        for trial, done in zip(trials, run(Trial.done, trials), strict=True):
            if len(done.tried):
                before = offset.get(trial.task.name, np.zeros(3))
                surprise = surprises(method.landing, done.tried).mean(axis=0) - before
                offset[trial.task.name] = before + config.rate * surprise
        method = replace(method, offset=offset)
    return method


def surprises(model: LandingModel, tried: Tried) -> np.ndarray:
    """How much farther than predicted each jump landed, (n, 3)."""
    pairs = zip(tried.goal, tried.stance_pitch, tried.landing, strict=True)
    return np.array([landed - model.landing(goal, stance) for goal, stance, landed in pairs])


def all_trials(
    bench: Bench, methods: Mapping[str, Method], tasks: Sequence[Task], repeats: Mapping[str, int]
) -> list[Trial]:
    """Every method at every task, as often as the task says."""
    return [
        bench.trial(name, method, task, number)
        for name, method in methods.items()
        for task in tasks
        for number in range(repeats[task.name])
    ]
