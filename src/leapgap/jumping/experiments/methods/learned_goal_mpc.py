"""Goal-directed jumps whose goal is shifted on the way by an MPC with a learned model of the landing."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leapgap.effects import to_config
from leapgap.jumping.control.deviation_recorder import Observation
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.held_shifts import HeldShiftsConfig, measure_held_shifts
from leapgap.jumping.experiments.landing_feedback import (
    Authority,
    FeedbackConfig,
    KickedJumps,
    LandingFeedback,
    learn_calm,
    learn_change,
)
from leapgap.jumping.experiments.landing_model import LandingModel
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.aiming import AimingMethod
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.methods.goal_shift import GoalShiftMethod
from leapgap.jumping.experiments.rig import Rig
from leapgap.jumping.experiments.simulated_shifts import ShiftSimulator, SimulatedShiftsConfig
from leapgap.jumping.experiments.training_jumps import (
    DATA_SHEET,
    SHARED,
    PracticeResult,
    identify_contact_effects,
    run_practice,
)
from leapgap.jumping.models.planar import planar_robot


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
        planner = JumpPlanner(planar_robot(rig.robot), settings.schedule, settings.limits)
        start = AimingMethod(rig.robot, bench.references, planner=planner, observation=observation)
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
        return KickedJumps.from_json(found["kicked"]), Authority.from_json(found["authority"])


def simulate(simulator: ShiftSimulator, config: SimulatedShiftsConfig, seed: int) -> Mapping[str, Any]:
    """The kicked jumps and the authority of shifts, in a form that a JSON file can hold."""
    shifts = simulator.authority(config)
    kicked = simulator.kicked(config, np.random.default_rng([seed, 11]))
    return {"kicked": kicked.to_json(), "authority": shifts.to_json()}
