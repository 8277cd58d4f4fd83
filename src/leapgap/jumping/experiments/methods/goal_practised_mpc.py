"""The learned MPC along plans whose goal was chosen before the jump: it corrects only what nobody expected then."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from leapgap.jumping.control.mpc import DepartingMpc
from leapgap.jumping.control.shifted_plan import DEVIATIONS
from leapgap.jumping.control.tracking import Excitation, JointPd, JumpController, Reference
from leapgap.jumping.experiments.goal_directed_jump import (
    GoalChoice,
    GoalDirectedJump,
    JumpPlanner,
    LandingModel,
    LandingSamples,
    best_goal,
)
from leapgap.jumping.experiments.method import AimingMethod, JumpTask, MpcMethod, References
from leapgap.jumping.experiments.methods.practised_mpc import PractisedMpcSettings
from leapgap.jumping.experiments.rig import Rig
from leapgap.jumping.experiments.settings import GoalOffsets, PracticeRounds
from leapgap.jumping.experiments.training_jumps import DATA_SHEET, run_practice
from leapgap.jumping.learning.models.deviation_kernel import DeviationKernelConfig
from leapgap.jumping.learning.recipe import ModelSettings
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import DeviationModel, NominalDeviation
from leapgap.jumping.planning.reference import Gains, to_jump
from leapgap.jumping.planning.solve import Solution, landing_goal
from leapgap.jumping.task import Target, begin_of, metadata_of, target_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log


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

    @property
    def deviations(self) -> np.ndarray:
        """None are kept, (0, 10): the model is of the whole log."""
        return np.zeros((0, DEVIATIONS))


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
        assert self.planner is not None

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(self.aimed, target, stance_pitch, self.farther) + self.goal_offset

        return GoalMpcJump(GoalChoice(task.target, self.planner, aim, task.stance_is_seen), reference, self)

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
    plan, (x_m, z_m, _) = to_jump(solution, Gains()), landing_goal(solution.problem)
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
    on_policy_weight: float = 1.0
    """As much as a simulated jump, which shows C and G better: it is kicked, and no feedback decides its forces."""
    kernel: DeviationKernelConfig = field(
        default_factory=lambda: DeviationKernelConfig(phase_s=0.1, target_m=1.0, stance_rad=0.5, ridge=0.3)
    )
    """Smooth over phase, goals and stances, for the jumps of each are few."""

    def start(self, name: str, rig: Rig) -> GoalMpcMethod:
        """Joint PD to goals that the training jumps taught."""
        settings, bench = rig.settings, rig.bench
        planner = JumpPlanner(planar_robot(rig.robot), settings.schedule, settings.limits)
        first = replace(settings.practice, rounds=settings.practice.rounds[:1])
        learned = run_practice(bench, AimingMethod(rig.robot, bench.references, planner=planner), first)
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
