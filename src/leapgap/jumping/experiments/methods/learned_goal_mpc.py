"""Goal-directed jumps whose goal is shifted on the way by an MPC with a learned model of the landing."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from leapgap.effects import to_config
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import GoalChoice, JumpPlanner
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump, ShiftSettings
from leapgap.jumping.experiments.landing_feedback import (
    Authority,
    FeedbackConfig,
    LandingFeedback,
    ShiftedJumps,
    learn_feedback,
)
from leapgap.jumping.experiments.landing_model import best_goal
from leapgap.jumping.experiments.method import Method, References
from leapgap.jumping.experiments.methods.aiming import AimingMethod
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.simulated_shifts import ShiftDraws, ShiftSimulator, SimulatedShiftsConfig
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.training_jumps import (
    DATA_SHEET,
    IdentifiedRobot,
    PracticeDraws,
    identify_contact_effects,
    identify_robot,
)
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.task import Target

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import Rig


@dataclass(frozen=True)
class GoalShiftMethod(Method):
    """Goal-shift MPC along plans from the measured stance to the goal that the model says will land on the target."""

    planner: JumpPlanner | None = None
    feedback: LandingFeedback | None = None
    config: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    draws: ShiftDraws | None = None
    """Random shifts of exploration; None: without."""
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Added to each goal for exploration, (3,), m, m, rad."""
    exploration: np.ndarray | None = None

    def explore(self, offset: np.ndarray, references: References, rng: np.random.Generator) -> "GoalShiftMethod":
        """The method with an offset (3,) of its goals and with random shifts."""
        assert self.planner is not None and self.draws is not None
        grid = ShiftGrid(self.planner.schedule, self.config.period_s)
        shifts = self.draws.draw(grid.updates, grid.period_s, rng)
        return replace(self, goal_offset=offset, references=references, exploration=shifts)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured, and shifted on the way."""
        assert self.planner is not None
        landing = None if self.feedback is None else self.feedback.landing

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(landing, target, stance_pitch) + self.goal_offset

        settings = ShiftSettings(self.config, self.feedback, self.exploration)
        choice = GoalChoice(task.target, self.planner, aim, task.stance_is_seen)
        return GoalShiftJump(choice, reference, self.robot, self.gains, settings)


@dataclass(frozen=True)
class LearnedGoalMpcSettings(MethodSettings):
    """Simulates jumps of the identified robot, then makes the training jumps of ``land.practice``, randomly shifted."""

    name = "learned_goal_mpc"

    mpc: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    model: FeedbackConfig = field(default_factory=FeedbackConfig)
    simulated: SimulatedShiftsConfig = field(default_factory=SimulatedShiftsConfig)
    first_shifts: ShiftDraws = field(default_factory=lambda: ShiftDraws((0.02, 0.015, 0.03)))
    """Random shifts of the first jumps."""
    later_shifts: ShiftDraws = field(default_factory=lambda: ShiftDraws((0.008, 0.006, 0.015)))
    """Random shifts in addition to those of the MPC, in later jumps."""
    identify_feet: bool = False
    """Whether the softness of the feet is identified for the simulated jumps: what kicks and unseen ground do depends
    on it. Off: the simulated robot has the feet of the nominal one."""

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Make the training jumps, and fit the model of the landing to them."""
        settings = rig.settings
        bench, config = rig.bench, settings.practice
        planner = JumpPlanner(planar_robot(rig.robot), settings.schedule, settings.limits)
        draws = PracticeDraws(bench, config, np.random.default_rng([bench.seed, 7]), folder=f"practice_{name}")
        identified = identify_robot(draws, AimingMethod(rig.robot, bench.references, planner=planner))
        print(f"{bench.hardware}: found {json.dumps(to_config(identified.effects))}", flush=True)
        simulated, shifts = self._simulated(bench, identified, draws.folder)
        prior = learn_feedback(simulated, shifts, self.model)
        method = GoalShiftMethod(
            rig.robot, bench.references, planner=identified.planner, config=self.mpc, draws=self.first_shifts
        )
        made: list[ShiftedJumps] = []
        for number, jumps in enumerate((config.random_jumps, *config.rounds)):
            offsets = config.later_beyond if number else config.random_beyond
            results = bench.runner.results(draws.trials(f"round_{number}", jumps, method, offsets))
            made += [result.shifted for result in results if result.shifted is not None]
            model = learn_feedback(ShiftedJumps.join(made), shifts, self.model, prior)
            method = replace(method, feedback=model, draws=self.later_shifts)
        return replace(method, draws=None)

    def _simulated(self, bench: Bench, identified: IdentifiedRobot, folder: str) -> tuple[ShiftedJumps, Authority]:
        """Jumps of the identified robot in simulation and what shifts do to it, from the cache where they are there."""
        effects = identified.effects
        if self.identify_feet:
            effects = identify_contact_effects(bench, identified.logs, folder)
            print(f"{bench.hardware}: simulated with {json.dumps(to_config(effects))}", flush=True)
        sensing = bench.world.sensing
        period = bench.level.info.sample_period_s
        simulator = ShiftSimulator(
            planner=identified.planner,
            robot=bench.robot,
            effects=(*effects, *DATA_SHEET),
            level=bench.level,
            grid=ShiftGrid(identified.planner.schedule, self.mpc.period_s),
            average_rows=max(1, round(self.mpc.average_s / period)),
            late_rows=round(sensing.base_delay_s / period),
            noise=sensing.noise,
        )
        place = f"{bench.hardware}/{folder}/simulated"
        found = bench.runner.value(place, simulate, simulator, self.simulated, bench.seed)
        return ShiftedJumps.from_json(found["jumps"]), Authority(*(np.array(part) for part in found["authority"]))


def simulate(simulator: ShiftSimulator, config: SimulatedShiftsConfig, seed: int) -> Mapping[str, Any]:
    """The simulated jumps and the authority of shifts, in a form that a JSON file can hold."""
    shifts = simulator.authority(config)
    jumps = simulator.run(config, np.random.default_rng([seed, 11]))
    return {"jumps": jumps.to_json(), "authority": [shifts.mean.tolist(), shifts.variance.tolist()]}
