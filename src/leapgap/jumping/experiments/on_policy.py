"""Practice of the learned MPC: jumps by the nominal MPC, then rounds of jumps by the MPC that was learned from them all."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leapgap.jumping.control.excitation import Excitation, ExcitedController
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.mpc import MpcMethod
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial_spec import TrialSpec
from leapgap.jumping.learning.deviation_recipe import DeviationTask
from leapgap.jumping.learning.deviations import DeviatingJump, deviating_jump, rolled_out
from leapgap.jumping.learning.recipe import ModelSettings
from leapgap.jumping.learning.registry import deviation_recipes
from leapgap.jumping.models.deviation_model import DeviationModel
from leapgap.jumping.task import Target


@dataclass(frozen=True)
class OnPolicyConfig:
    """How many jumps are made, to which targets, and with which random forces."""

    distances_m: tuple[float, ...] = (0.35, 0.45, 0.55, 0.65, 0.75)
    first_jumps: int = 3
    """Jumps to each target by the nominal MPC."""
    rounds: int = 5
    """Of one jump to each target by the learned MPC."""
    first: Excitation = field(default_factory=lambda: Excitation(40.0))
    later: Excitation = field(default_factory=lambda: Excitation(15.0))
    on_policy_weight: float = 5.0
    """How much a jump of the learned MPC counts beside one of the nominal MPC."""
    slope_rad: tuple[float, float] = (-0.005, 0.005)


@dataclass(frozen=True)
class ExcitedMethod(Method):
    """Another method's controllers with random forces added."""

    inner: Method | None = None
    excitation: Excitation = field(default_factory=Excitation)
    seed: int = 0

    def __call__(self, task: JumpTask) -> Sequence[JumpController]:
        """New controllers of the task's jumps, in their order."""
        assert self.inner is not None
        rng = np.random.default_rng(self.seed)
        return [ExcitedController(one, self.excitation, rng) for one in self.inner(task)]

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """One of them."""
        raise NotImplementedError


@dataclass(frozen=True)
class Round:
    """What one round showed."""

    landed_cm: float
    """Mean |landing − plan| along x of its jumps, cm."""
    predicted_cm: float | None
    """Mean |landing − prediction| by the model that made the jumps, from their states 150 ms before take-off, cm."""
    pitch_deg: float
    """Mean |pitch − plan| at the landing."""


@dataclass(frozen=True)
class Practised:
    """The learned model, and how the rounds went."""

    model: DeviationModel
    rounds: tuple[Round, ...]
    jumps: tuple[DeviatingJump, ...]


def practise(
    bench: Bench,
    nominal: MpcMethod,
    config: OnPolicyConfig,
    recipe: str,
    settings: Mapping[str, ModelSettings],
    plan: Callable[[Target], Any],
    folder: str,
) -> Practised:
    """Make all jumps of practice on one robot, and fit the last model to them.

    ``nominal`` is the MPC with the nominal model; the learned one departs from it by its model alone.
    """
    plans = {target: plan(target) for target in (Target(x) for x in config.distances_m)}
    rng = np.random.default_rng([bench.seed, 23])
    body = nominal.model.body  # type: ignore[union-attr]
    model, jumps, rounds = nominal.model, [], []
    for number in range(config.rounds + 1):
        method = replace(nominal, model=model, references={**bench.references, **plans})
        excitation, repeats = (config.later, 1) if number else (config.first, config.first_jumps)
        targets = [target for _ in range(repeats) for target in plans]
        trials = []
        for i, target in enumerate(targets):
            task = JumpTask("practice", target.x_m, target.z_m, slope_rad=config.slope_rad)
            seeds = rng.integers(2**31, size=2)
            excited = ExcitedMethod(method.robot, {}, inner=method, excitation=excitation, seed=int(seeds[0]))
            place = f"{bench.hardware}/{folder}/round_{number}_{i:02d}"
            world = bench.world
            trials.append(TrialSpec(place, task, excited, plans[target], bench.effects, world, int(seeds[1]), True))
        weight = config.on_policy_weight if number else 1.0
        results = bench.runner.results(trials)
        made = [
            deviating_jump(result.log, plans[target], nominal.config.grid, bench.robot, weight)
            for target, result in zip(targets, results, strict=True)
            if result.log is not None
        ]
        rounds.append(judged(made, model, bool(number)))
        print(f"{bench.hardware}/{folder}: round {number}, {rounds[-1]}", flush=True)
        jumps += made
        model = deviation_recipes()[recipe].fit(DeviationTask(jumps, body, settings))
    return Practised(model, tuple(rounds), tuple(jumps))


def judged(jumps: Sequence[DeviatingJump], model: DeviationModel, learned: bool) -> Round:
    """Landings of some jumps beside their plans, and beside what the model predicts late in the push."""
    landed = np.array([jump.error[-1] for jump in jumps])
    found = []
    for jump in jumps:
        pushing = np.flatnonzero(jump.steps.pushing.any(axis=1))
        first = int(np.searchsorted(jump.steps.time_s, jump.steps.end_s[pushing[-1]] - 0.15 - 1e-6))
        found.append(rolled_out(jump, model.along(jump.steps), first)[-1])
    off = np.abs(landed - np.array(found))
    return Round(
        100 * float(np.abs(landed[:, 0]).mean()),
        100 * float(off[:, 0].mean()),
        float(np.rad2deg(np.abs(landed[:, 2]).mean())),
    )
