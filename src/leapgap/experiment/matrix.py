"""The whole matrix of experiments on one robot with effects: shifts, adaptation, then every method at every task."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.control.gains import PhaseGains
from leapgap.experiment.aiming import LandingModel, Tried
from leapgap.experiment.bench import Bench
from leapgap.experiment.made import TrialSpec
from leapgap.experiment.methods import ByAiming, ByJointPd, Method, shifted
from leapgap.experiment.tasks import Task
from leapgap.recording.jump import Jump, Target

SHIFTING, ADAPTING = 900, 800
"""Numbers of the runs that a shift or an offset is learned from: other ground and sensors than in those that count."""


@dataclass(frozen=True)
class AdaptConfig:
    """How an offset a task is learned from its own jumps."""

    jumps: int = 4
    """Of each task, one after the other."""
    rate: float = 0.7
    """Share of a surprise that is believed."""


def best_shift(
    bench: Bench, learned_on: Sequence[Task], tasks: Sequence[Task], plan: Callable[[Target], Jump]
) -> ByJointPd:
    """Joint PD with the constant shift of the target that lands best over some tasks: two steps of correction."""
    references = dict(bench.references)
    method = ByJointPd(bench.robot, references, PhaseGains())

    def moved(shift_m: float, of: Sequence[Task]) -> ByJointPd:
        for task in of:
            goal = shifted(task.target, shift_m)
            if goal not in references:
                references[goal] = plan(goal)
        return replace(method, references=dict(references), shift_m=shift_m)

    for number in range(2):
        trials = [bench.trial("shifting", method, task, SHIFTING + number) for task in learned_on]
        errors = [done.landings[0].error_cm / 100 for done in bench.runner.results(trials)]
        method = moved(round(method.shift_m + float(np.mean(errors)), 3), learned_on)
    return moved(method.shift_m, tasks)


def adapted(bench: Bench, method: ByAiming, tasks: Sequence[Task], config: AdaptConfig) -> ByAiming:
    """With an offset for each task, learned from its own first jumps."""
    assert method.landing is not None
    for number in range(config.jumps):
        trials = [bench.trial("adapting", method, task, ADAPTING + number) for task in tasks]
        offset = dict(method.offset)
        for trial, done in zip(trials, bench.runner.results(trials), strict=True):
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
) -> list[tuple[str, TrialSpec]]:
    """Every method, by its name, at every task, as often as the task says; each first run with its log."""
    return [
        (name, bench.trial(name, method, task, number, with_log=number == 0))
        for name, method in methods.items()
        for task in tasks
        for number in range(repeats[task.name])
    ]
