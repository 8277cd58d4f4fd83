"""The paper's learned variable-frequency MPC: it practises on the robot, and predicts with what it learned there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.experiments.goal_directed_jump import LandingSamples
from leapgap.jumping.experiments.method import JumpTask, Method, MpcMethod, References
from leapgap.jumping.experiments.rig import Bench, MethodSettings, Rig
from leapgap.jumping.experiments.settings import LandSettings, LearnedMpcConfig, PracticeRounds
from leapgap.jumping.experiments.trial import TrialSpec
from leapgap.jumping.learning.recipe import DeviationTask, ModelSettings
from leapgap.jumping.learning.store import deviation_recipes
from leapgap.jumping.learning.window_extraction import DeviatingJump, deviating_jump, rolled_out
from leapgap.jumping.models.rigid_body import DeviationModel, NominalDeviation
from leapgap.jumping.task import Target
from leapgap.simulation.sensors import SensorNoise


@dataclass(frozen=True)
class Round:
    """What the jumps of one round showed; ``landed`` beside the plan, ``predicted`` beside the model that made them."""

    jumps: int
    landed_cm: float  # Mean |landing − plan| along x, cm
    predicted_cm: float  # Mean |landing − prediction| along x from the states 150 ms before take-off, cm
    pitch_deg: float  # Mean |pitch − plan| at the landing
    simulated: bool = False  # Whether they are of the identified robot, and no jumps of the robot itself

    def __str__(self) -> str:
        told = f"{self.landed_cm:.1f} cm beside the plan, {self.predicted_cm:.1f} cm beside the prediction"
        return f"{self.jumps}{' simulated' * self.simulated} jumps land {told}, pitched {self.pitch_deg:.0f} degrees"


@dataclass(frozen=True)
class Practised:
    """What is kept, and how the rounds went."""

    method: MpcMethod  # The MPC with the model that is kept
    name: str  # Of its recipe
    kept: int  # Number of rounds whose jumps it was fitted to
    rounds: tuple[Round, ...]

    @property
    def model(self) -> DeviationModel:
        """The model that is kept."""
        assert isinstance(self.method.model, DeviationModel)
        return self.method.model


def practise(
    bench: Bench,
    nominal: MpcMethod,
    plans: References,
    config: LearnedMpcConfig,
    settings: Mapping[str, ModelSettings],
    folder: str,
) -> Practised:
    """Make all jumps of practice on one robot, and fit the model to them.

    ``nominal`` is the MPC with the nominal model; the learned one departs from it by its model alone. ``plans`` holds
    those of the practised targets, ``settings`` those of the models by their section.
    """
    practice, grid = config.practice, nominal.config.grid
    rng = np.random.default_rng([bench.seed, 23])
    assert isinstance(nominal.model, DeviationModel)
    models, jumps, rounds, landings = [nominal.model], list[DeviatingJump](), list[Round](), list[LandingSamples]()
    for number in range(practice.rounds + 1):
        method = replace(nominal.taught(models[-1], landings[1:]), references=plans)
        trials = round_trials(bench, method, practice, number, rng, folder)
        weight = practice.on_policy_weight if number else 1.0
        simulated = not number and method.identified is not None
        made, landed = list[DeviatingJump](), LandingSamples()
        for trial, result in zip(trials, bench.runner.results(trials), strict=True):
            landed = landed.extended_by(result.samples)
            flown = None if result.log is None else method.flown(result.log, trial.reference, result.samples)
            if flown is not None:
                kicked_s = trial.task.disturbed_at_s[0] if trial.task.kick_m_s else None
                made.append(deviating_jump(*flown, grid, bench.robot, weight, kicked_s, simulated))
        if not made:
            continue  # all fell, and teach nothing
        landings.append(landed)
        rounds.append(replace(judged(made, models[-1]), simulated=simulated))
        jumps += made
        models.append(
            deviation_recipes()[config.model].fit(DeviationTask(jumps, nominal.model.body, settings, bench.seed))
        )
    learned = [one.predicted_cm for one in rounds[1:]]
    kept = len(rounds) if not learned or learned[-1] <= practice.trusted_cm else 1 + int(np.argmin(learned))
    return Practised(nominal.taught(models[kept], landings[1:kept]), config.model, kept, tuple(rounds))


def round_trials(
    bench: Bench, method: MpcMethod, practice: PracticeRounds, number: int, rng: np.random.Generator, folder: str
) -> list[TrialSpec]:
    """The jumps of a round; round 0 is the nominal MPC's, simulated where the robot was identified."""
    excitation, repeats = (practice.later, 1) if number else (practice.first, practice.first_jumps)
    simulated = number == 0 and method.identified is not None
    trials = []
    for i, x_m in enumerate(practice.distances_m * repeats):
        block = practice.block_m if (i + number) % 2 else (0.0, 0.0)
        task, target = JumpTask("practice", x_m, block_m=block, slope_rad=practice.slope_rad), Target(x_m)
        force_seed, seed = (int(one) for one in rng.integers(2**31, size=2))
        effects, world = bench.effects, bench.world
        if simulated:
            task, effects = kicked(task, method.config.period_s, rng), method.identified or ()
            world = replace(world, sensing=replace(world.sensing, noise=EXACT))
        place, plan = f"{bench.hardware}/{folder}/round_{number}_{i:02d}", method.references[target]
        own = replace(method, references={target: plan}).excited(excitation, force_seed)
        trials.append(TrialSpec(place, task, own, plan, effects, world, seed, with_log=True))
    return trials


EXACT = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Of simulated jumps: noise of a velocity looks like one that fades within a step, and C is learned too large."""
KICKED_S = (0.1, 0.75)  # Range of the times of simulated kicks, since the start of the jump


def kicked(task: JumpTask, period_s: float, rng: np.random.Generator) -> JumpTask:
    """The task with a kick of 0.2 m/s or 1 rad/s in the middle of a step, so that it shows in one step alone."""
    first, last = (int(time_s / period_s) for time_s in KICKED_S)
    at_s = float(period_s * (int(rng.integers(first, last)) + 0.5))
    return replace(task, kick_m_s=0.2, kick_rad_s=1.0, disturbed_at_s=(at_s,))


BEFORE_TAKE_OFF_S = 0.15
"""Time before take-off from which landings are predicted: the learned MPC has little left to decide then."""


def judged(jumps: Sequence[DeviatingJump], model: DeviationModel) -> Round:
    """Landings of some jumps beside their plans, and beside what the model predicts late in the push."""
    landed, predicted = np.array([jump.error[-1] for jump in jumps]), []
    for jump in jumps:
        take_off_s = jump.steps.end_s[np.flatnonzero(jump.steps.pushing.any(axis=1))[-1]]
        first = int(np.searchsorted(jump.steps.time_s, take_off_s - BEFORE_TAKE_OFF_S - 1e-6))
        predicted.append(rolled_out(jump, model.along(jump.steps), first)[-1])
    off = np.abs(landed - np.array(predicted))
    x_cm, pitch_deg = 100 * np.abs(landed[:, 0]), np.rad2deg(np.abs(landed[:, 2]))
    return Round(len(jumps), float(x_cm.mean()), float(100 * off[:, 0].mean()), float(pitch_deg.mean()))


NOMINAL = "nominal"  # In place of a learned model: the same MPC without practice


@dataclass(frozen=True)
class PractisedMpcSettings(MethodSettings):
    """The MPC in deviations from the plan, its model learned on the robot itself: section ``land.learned``."""

    name = "practised_mpc"

    grid: str  # Steps of the MPC and of the model: a key of ``land.grids``
    model: str | None = None  # ``nominal``, or a recipe in place of ``land.learned.model``

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown grid or model."""
        settings.grid(self.grid, name)
        model, known = self.model or settings.learned.model, (NOMINAL, *deviation_recipes())
        if model not in known:
            raise InputError(f"land.method_settings.{name}.model", model, f"one of {', '.join(known)}", "choose one")

    @property
    def practises(self) -> bool:
        """Whether it learns anything."""
        return self.model != NOMINAL

    def start(self, name: str, rig: Rig) -> MpcMethod:
        """The MPC with the nominal model."""
        learned = rig.settings.learned
        config = replace(learned.mpc, grid=rig.settings.grid(self.grid, name))
        return MpcMethod(rig.robot, rig.bench.references, learned.gains, NominalDeviation(rig.body), config)

    def rounds_of(self, rig: Rig) -> PracticeRounds:
        """Rounds, jumps and targets of its practice, by the settings of the rig."""
        return rig.settings.learned.practice

    @property
    def model_settings(self) -> dict[str, ModelSettings]:
        """Of models by their section, where they are not the defaults."""
        return {}

    def plans(self, rig: Rig) -> References:
        """Plans from level ground to the practised targets."""
        return {target: rig.plan(target) for target in map(Target, self.rounds_of(rig).distances_m)}

    def practise(self, name: str, rig: Rig) -> Practised:
        """The rounds of practice on this robot; those that were made before are read."""
        learned = rig.settings.learned
        learned = replace(learned, model=self.model or learned.model, practice=self.rounds_of(rig))
        found = practise(
            rig.bench, self.start(name, rig), self.plans(rig), learned, self.model_settings, f"practice_{name}"
        )
        for number, one in enumerate(found.rounds):
            print(f"{rig.bench.hardware}/{name}, round {number}: {one}", flush=True)
        return found

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Practise on the robot, unless it was done before."""
        return self.practise(name, rig).method if self.practises else self.start(name, rig)
