"""The paper's MPC of the ground forces, predicting with the nominal rigid body or with a learned model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.inference import load
from leapgap.jumping.control.mpc import DepartingMpc
from leapgap.jumping.control.tracking import Excitation, JointPd, JumpController, Reference
from leapgap.jumping.experiments.goal_directed_jump import (
    GoalChoice,
    GoalDirectedJump,
    JumpPlanner,
    LandingModel,
    LandingSamples,
)
from leapgap.jumping.experiments.method import AimingMethod, JumpTask, Method, MpcMethod, References, goal_choice
from leapgap.jumping.experiments.rig import (
    Bench,
    GoalOffsets,
    LandSettings,
    LearnedMpcConfig,
    MethodSettings,
    PlanSource,
    PracticeRounds,
    Rig,
)
from leapgap.jumping.experiments.training_jumps import DATA_SHEET, run_practice
from leapgap.jumping.experiments.trial import TrialSpec
from leapgap.jumping.learning.models.kernel import DeviationKernelConfig
from leapgap.jumping.learning.recipe import DeviationTask, ModelSettings
from leapgap.jumping.learning.store import deviation_recipes
from leapgap.jumping.learning.window_extraction import DeviatingJump, deviating_jump, rolled_out
from leapgap.jumping.learning.windows import Purpose, TimeGrid
from leapgap.jumping.models.rigid_body import (
    DeviationModel,
    NominalDeviation,
    PredictionModel,
    RigidBody,
    RigidBodyModel,
)
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.planning.solve import Solution, landing_goal
from leapgap.jumping.task import Target, begin_of, metadata_of, target_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log
from leapgap.simulation.sensors import SensorNoise


@dataclass(frozen=True, kw_only=True)
class NominalMpcSettings(MethodSettings):
    """The MPC whose prediction model is the rigid body of the robot that the plans are made for."""

    name = "nominal_mpc"

    grid: str  # Steps of the MPC: a key of ``land.grids``
    plans: PlanSource = PlanSource.own

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown grid, or plans without their inputs."""
        settings.check_plans(self.plans)
        settings.grid(self.grid, name)

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """The MPC with its model; None without plans or model."""
        plans, grid = rig.plans(self.plans), rig.settings.grid(self.grid, name)
        model = None if plans is None else self.model(name, rig, plans.body, grid)
        if plans is None or model is None:
            return None
        return MpcMethod(rig.robot, plans.references, model=model, config=replace(rig.settings.mpc, grid=grid))

    def model(self, name: str, rig: Rig, body: RigidBody, grid: TimeGrid) -> PredictionModel | None:
        """The rigid body of the plans, which needs no training."""
        return RigidBodyModel(body)


@dataclass(frozen=True, kw_only=True)
class LearnedMpcSettings(NominalMpcSettings):
    """The MPC whose prediction model is ``land.model``, trained on all jumps for these steps."""

    name = "learned_mpc"

    models: str  # Folder of stage train: a key of ``land.models``

    def check(self, name: str, settings: LandSettings) -> None:
        """Refuse an unknown folder, too."""
        super().check(name, settings)
        settings.known("models", self.models, name)

    def model(self, name: str, rig: Rig, body: RigidBody, grid: TimeGrid) -> PredictionModel | None:
        """Read the exported model; None, with a printed reason, where there is none."""
        settings = rig.settings
        folder = Path(settings.known("models", self.models, name)) / "exported"
        if not folder.is_dir():
            print(f"{name}: no trained models in {folder}, left out", flush=True)
            return None
        return load(folder, settings.model, Purpose(grid, settings.schedule, rig.robot.name, rig.robot.sha256))


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


BEFORE_TAKE_OFF_S = 0.15  # Time before take-off from which landings are predicted: little is left to decide then


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


class GoalMpcJump(GoalDirectedJump):
    """Measures its stance, plans to its goal, and jumps with the MPC along that plan."""

    def __init__(self, choice: GoalChoice, first: Reference, method: "GoalMpcMethod") -> None:
        super().__init__(choice, first, method.robot, method.gains)
        self.method = method

    def track(self, solution: Solution | None) -> JumpController:
        """The method's controller along the plan; along that from level ground where there is none."""
        if solution is not None:
            self.reference = Reference.of(plan_of(solution), self.robot)
        tracker = self.method.along(self.reference)
        tracker.fallbacks, tracker.substituted = self.fallbacks, self.substituted
        return tracker


@dataclass(frozen=True)
class GoalMpcMethod(MpcMethod):
    """The MPC along plans from the measured stance to the goal whose jumps are expected to land on the target."""

    planner: JumpPlanner | None = None
    aimed: LandingModel | None = None  # Where jumps land by joint PD alone
    farther: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """How much farther by the MPC, (3,), m, m, rad: a constant, for few jumps on the ground say little of a box."""
    beyond: GoalOffsets = field(default_factory=GoalOffsets)  # Range of random offsets of the goals in practice
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured."""
        return GoalMpcJump(goal_choice(task, self.planner, self.aimed, self.goal_offset, self.farther), reference, self)

    def along(self, reference: Reference) -> JumpController:
        """The MPC along a plan, or joint PD before anything was learned; with the random forces of practice."""
        assert self.model is not None
        found: JumpController
        if isinstance(self.model, NominalDeviation):
            found = JointPd(reference, self.robot, self.gains)
        else:
            found = DepartingMpc(reference, self.robot, self.gains, self.model, self.config)
        return self.with_excitation(found)

    def excited(self, excitation: Excitation, seed: int) -> Self:
        """With random forces, and to a goal nearby."""
        offset = self.beyond.draw(np.random.default_rng([seed, 1]))
        return replace(super().excited(excitation, seed), goal_offset=offset)

    def taught(self, model: DeviationModel, rounds: Sequence[LandingSamples]) -> Self:
        """With the model, and with the landings of these rounds."""
        aimed, taught = self.aimed, super().taught(model, rounds)
        if aimed is None or not any(len(samples) for samples in rounds):
            return taught
        off = [
            landing - aimed.landing(goal, stance_pitch)
            for samples in rounds[-2:]  # earlier ones are of other models
            for goal, stance_pitch, landing in zip(samples.goal, samples.stance_pitch, samples.landing, strict=True)
        ]
        return replace(taught, farther=np.median(off, axis=0))

    def flown(self, jump: Log, plan: Log, samples: LandingSamples) -> tuple[Log, Log] | None:
        """The jump without its stand, along the plan that it made; None for one that fell or found no plan."""
        del plan
        assert self.planner is not None
        if not len(samples):
            return None
        found = self.planner.plan_nearest(target_of(jump), samples.goal[0], float(samples.stance_pitch[0]))
        if found is None:
            return None
        begin = round(begin_of(jump) / jump.info.sample_period_s)
        return rows_between(jump, begin, len(jump), jump.name), plan_of(found[1])


def plan_of(solution: Solution) -> Log:
    """A plan that states its goal as its target: models of the deviation know it by that."""
    plan, (x_m, z_m, _) = to_jump(solution), landing_goal(solution.problem)
    stated = metadata_of(solution.problem.grid.schedule, Target(float(x_m), float(z_m)))
    return replace(plan, info=replace(plan.info, extra=stated))


@dataclass(frozen=True)
class GoalPractisedMpcSettings(PractisedMpcSettings):
    """Makes the training jumps that ``ours`` makes up to its first round of chosen goals, simulates jumps of the robot
    that was identified from them, and makes rounds of its own, with the joint gains of ``ours``.

    The MPC aims at what its model expects of the plan, because the goal was chosen for that.
    """

    name = "goal_practised_mpc"

    rounds: int = 3  # Of jumps by the MPC
    simulated: int = 6  # Simulated jumps to each of its targets
    on_policy_weight: float = 1.0  # As much as a simulated jump, which shows C and G better: kicked, without feedback
    kernel: DeviationKernelConfig = field(
        default_factory=lambda: DeviationKernelConfig(phase_s=0.1, target_m=1.0, stance_rad=0.5, ridge=0.3)
    )
    """Smooth over phase, goals and stances, for the jumps of each are few."""

    def start(self, name: str, rig: Rig) -> GoalMpcMethod:
        """Joint PD to goals that the training jumps taught."""
        settings, bench = rig.settings, rig.bench
        first = replace(settings.practice, rounds=settings.practice.rounds[:1])
        learned = run_practice(bench, AimingMethod(rig.robot, bench.references, planner=rig.planner), first)
        plain = super().start(name, rig)
        return GoalMpcMethod(
            rig.robot,
            bench.references,
            model=plain.model,
            config=replace(plain.config, to_expected=True),
            planner=learned.planner,
            aimed=LandingModel(learned.samples, settings.practice.aim) if len(learned.samples) else None,
            beyond=settings.practice.later_beyond,
            identified=(*learned.effects, *DATA_SHEET),
        )

    def rounds_of(self, rig: Rig) -> PracticeRounds:
        """Those of the learned MPC, fewer, and from blocks."""
        block_m = rig.settings.practice.block_m
        first, weight = self.simulated, self.on_policy_weight
        rounds = super().rounds_of(rig)
        return replace(rounds, first_jumps=first, rounds=self.rounds, block_m=block_m, on_policy_weight=weight)

    @property
    def model_settings(self) -> dict[str, ModelSettings]:
        """Those of the kernel."""
        return {self.kernel.section: self.kernel}

    def plans(self, rig: Rig) -> References:
        """Plans are made before each jump."""
        return {Target(x_m): rig.bench.level for x_m in rig.settings.learned.practice.distances_m}
