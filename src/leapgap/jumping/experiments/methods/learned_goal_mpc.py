"""Goal-directed jumps whose goal is shifted on the way by an MPC with a learned model of the landing."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leapgap.effects import to_config
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.shifted_plan import GOAL_AXES, Observation, ShiftGrid
from leapgap.jumping.experiments.goal_directed_jump import LandingModel, best_goal, target_pose
from leapgap.jumping.experiments.goal_shift_jump import (
    Authority,
    FeedbackConfig,
    GoalShiftMethod,
    HeldShifts,
    KickedJumps,
    LandingFeedback,
    learn_calm,
    learn_change,
)
from leapgap.jumping.experiments.identification import CONTACT_PARAMETERS
from leapgap.jumping.experiments.method import AimingMethod, JumpTask, Method
from leapgap.jumping.experiments.rig import Bench, MethodSettings, Rig
from leapgap.jumping.experiments.simulated_shifts import ShiftSimulator, SimulatedShiftsConfig
from leapgap.jumping.experiments.training_jumps import DATA_SHEET, SHARED, PracticeResult, identify_on, run_practice
from leapgap.jumping.experiments.trial import TrialSpec


@dataclass(frozen=True)
class HeldShiftsConfig:
    """Which shifts are held; one jump each, and one without a shift for each distance."""

    distances_m: tuple[float, ...] = (0.45, 0.55, 0.65)
    """Distances of the targets, rising; on flat ground. What a late shift does may turn within 5 cm of distance."""
    last_updates: int = 4  # Number of last updates at which a shift may change. Before them the simulation is right.
    shift: tuple[float, float, float] = (0.03, 0.0, 0.06)
    """Shift along each axis, m, m, rad; 0: none is held along it. Its sign changes from update to update."""
    error: float = 0.15  # Standard deviation of a measured effect, m/m and the like: noise and scatter of two landings


def measure_held_shifts(
    bench: Bench, method: GoalShiftMethod, landing: LandingModel, grid: ShiftGrid, config: HeldShiftsConfig, folder: str
) -> HeldShifts:
    """Make the jumps, and compare their landings with those without a shift; those that fall are left out.

    ``method`` has no model, and ``landing`` chooses its goals. ``folder`` is that of the method's practice.
    """
    last = range(max(grid.free_updates - config.last_updates, 0), grid.free_updates)
    held = [(update, axis) for update in last for axis in range(GOAL_AXES) if config.shift[axis]]
    # Both signs in turn, so that the mean effect of both sides counts.
    steps = np.array([(1.0 if update % 2 else -1.0) * config.shift[axis] for update, axis in held])
    shifts = np.zeros((len(held) + 1, grid.updates, GOAL_AXES))  # the first jump is not shifted
    for shift, (update, axis), step in zip(shifts[1:], held, steps, strict=True):
        shift[update:, axis] = step
    rng = np.random.default_rng([bench.seed, 17])
    goals, effects = [], []
    for x_m in sorted(config.distances_m):
        task = JumpTask("held", x_m)
        offset = best_goal(landing, task.target, 0.0) - target_pose(task.target)
        aimed = replace(method, references={task.target: bench.level}, goal_offset=offset)
        trials = [
            TrialSpec(
                f"{bench.hardware}/{folder}/held_{round(1000 * x_m)}_{number:02d}",
                task,
                replace(aimed, exploration=shift),
                bench.level,
                bench.effects,
                bench.world,
                int(rng.integers(2**31)),
            )
            for number, shift in enumerate(shifts)
        ]
        fell = np.full(GOAL_AXES, np.nan)
        shifted = [result.shifted for result in bench.runner.results(trials)]
        landings = [fell if one is None else one.landing[0] for one in shifted]
        if np.isfinite(landings[0]).all():
            goals.append(float(best_goal(landing, task.target, 0.0)[0]))
            effects.append((np.array(landings[1:]) - landings[0]) / steps[:, None])
    return HeldShifts(
        x_m=np.array(goals),
        update=np.array([update for update, _ in held], dtype=int),
        axis=np.array([axis for _, axis in held], dtype=int),
        effect=np.array(effects).reshape(len(goals), len(held), GOAL_AXES),
        error=config.error,
    )


@dataclass(frozen=True)
class LearnedGoalMpcSettings(MethodSettings):
    """Makes the training jumps that ``ours`` makes and a few with late shifts, and simulates shifted jumps of the
    identified robot."""

    name = "learned_goal_mpc"

    mpc: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    model: FeedbackConfig = field(default_factory=FeedbackConfig)
    simulated: SimulatedShiftsConfig = field(default_factory=SimulatedShiftsConfig)
    held: HeldShiftsConfig = field(default_factory=HeldShiftsConfig)

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Make the training jumps, and fit the model of the landing to them."""
        settings = rig.settings
        bench, observation = rig.bench, Observation(self.mpc.period_s, self.mpc.average_s)
        start = AimingMethod(rig.robot, bench.references, planner=rig.planner, observation=observation)
        own = f"practice_{name}"
        learned = run_practice(bench, start, settings.practice, SHARED if observation == Observation() else own)
        print(f"{bench.hardware}: found {json.dumps(to_config(learned.effects))}", flush=True)
        method = GoalShiftMethod(rig.robot, bench.references, planner=learned.planner, config=self.mpc)
        if learned.jumps is None:
            return method
        landing = LandingModel(learned.samples, settings.practice.aim)
        kicked, shifts = self._simulated(bench, learned, own)
        grid = ShiftGrid(learned.planner.schedule, self.mpc.period_s, on_rear_feet=self.mpc.on_rear_feet)
        shifts = shifts.measured(measure_held_shifts(bench, method, landing, grid, self.held, own))
        calm = learn_calm(learned.jumps.deviation, self.model)
        by_change = learn_change(kicked, self.model)
        return replace(method, feedback=LandingFeedback(landing, shifts, calm, by_change))

    def _simulated(self, bench: Bench, identified: PracticeResult, folder: str) -> tuple[KickedJumps, Authority]:
        """Kicked jumps of the identified robot and what shifts do to it, from the cache where they are there."""
        effects = identify_on(bench, identified.logs, folder, CONTACT_PARAMETERS)
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
        return KickedJumps.from_json(found["kicked"]), Authority.from_json(found["authority"])


def simulate(simulator: ShiftSimulator, config: SimulatedShiftsConfig, seed: int) -> Mapping[str, Any]:
    """The kicked jumps and the authority of shifts, in a form that a JSON file can hold."""
    shifts = simulator.authority(config)
    kicked = simulator.kicked(config, np.random.default_rng([seed, 11]))
    return {"kicked": kicked.to_json(), "authority": shifts.to_json()}
