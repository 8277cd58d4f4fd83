"""Practice, shift and adaptation on a robot whose landings are a known law: what is learned, from how many jumps."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.experiments import identification
from leapgap.jumping.experiments.goal_directed_jump import (
    JumpPlanner,
    LandingModel,
    LandingSamples,
    best_goal,
    target_pose,
)
from leapgap.jumping.experiments.method import AimingMethod, JointPdMethod, JumpTask
from leapgap.jumping.experiments.methods.joint_pd import learn_shift
from leapgap.jumping.experiments.methods.ours import adapt_offsets
from leapgap.jumping.experiments.rig import AdaptConfig, Bench, GoalOffsets, PracticeConfig
from leapgap.jumping.experiments.training_jumps import run_practice
from leapgap.jumping.experiments.trial import Landing, RunMetrics, TrialResult, TrialSpec
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.task import Target
from leapgap.logs.log import Log

CONDUCT = RunMetrics(0.4, 200.0, 0.02, 30.0, 0.1)
CONFIG = PracticeConfig(identify_jumps=2, random_jumps=12, rounds=(6,))
HEAVIER_CM = 4.0
"""How much shorter the task `far` lands than any practice tells."""


def law(trial: TrialSpec) -> TrialResult:
    """A robot that lands 5 % short and 3 cm high, and on `far` 4 cm shorter; joint PD 7 cm too far."""
    target = trial.task.target
    if isinstance(trial.method, JointPdMethod):
        x = target.x_m + trial.method.shift_m + 0.07
        tried = LandingSamples()
    else:
        assert isinstance(trial.method, AimingMethod)
        goal = best_goal(trial.method.landing, target, 0.0, trial.method.offset.get(trial.task.name))
        goal = goal + trial.method.goal_offset
        landing = goal * [0.95, 1.0, 1.0] + [0.0, 0.03, 0.0] - [0.01 * HEAVIER_CM * (trial.task.name == "far"), 0, 0]
        x, tried = landing[0], LandingSamples(goal[None], np.zeros(1), landing[None])
    error_cm = 100 * (target.x_m - x)
    landed = Landing(error_cm, None, 0.0, 2.0, True)
    return TrialResult((landed,), error_cm, {}, (), CONDUCT, tried, trial.reference if trial.with_log else None)


@pytest.fixture
def quick(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(TrialSpec, "run", law)
    monkeypatch.setattr(identification, "identify_effects", lambda *_: (effects.effect("joint_damping", damping=0.4),))
    return bench


def start(bench: Bench) -> AimingMethod:
    return AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))


@pytest.mark.long
def test_practice_finds_the_law_and_plans_with_what_was_identified(quick: Bench) -> None:
    learned = run_practice(quick, start(quick), CONFIG)
    assert len(learned.samples) == 18
    assert learned.effects == (effects.effect("joint_damping", damping=0.4),)
    nominal = planar_robot(quick.robot)
    assert learned.planner.robot != nominal
    goal = best_goal(LandingModel(learned.samples, CONFIG.aim), Target(0.6), 0.0)
    assert 0.95 * goal[0] == pytest.approx(0.6, abs=0.005)
    assert goal[1] + 0.03 == pytest.approx(CONFIG.aim.clearance_m, abs=0.01)


def test_all_plans_are_for_the_one_robot_that_reaches_the_ends(quick: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """With all of the identified damping no robot reaches them, nor with three quarters."""
    nominal, full = planar_robot(quick.robot), 0.4 * 2  # two legs a pair

    def reaches(planner: JumpPlanner, goals: list[np.ndarray]) -> bool:
        assert [goal[0] for goal in goals] == pytest.approx([0.32, 0.78, 0.55])
        return planner.robot.damping - nominal.damping < 0.6 * full

    monkeypatch.setattr(JumpPlanner, "reaches", reaches)
    learned = run_practice(quick, start(quick), CONFIG)
    shares = [
        (robot.damping - nominal.damping) / full for robot in (learned.planner.robot, *learned.planner.fallback_robots)
    ]
    assert shares == pytest.approx([0.5, 0.25, 0.0])


def test_later_rounds_stay_nearer_to_the_targets(quick: Bench) -> None:
    learned = run_practice(quick, start(quick), CONFIG)
    high = learned.samples.landing[:, 1]
    assert np.ptp(high[:12]) > 0.1
    assert np.ptp(high[12:]) < 0.1


def test_beyond_is_drawn_from_its_ranges() -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([GoalOffsets((-0.1, 0.1), (0.0, 0.14), (0.2, 0.3)).draw(rng) for _ in range(300)])
    assert (drawn.min(axis=0) >= [-0.1, 0.0, 0.2]).all()
    assert drawn.max(axis=0) == pytest.approx([0.1, 0.14, 0.3], abs=0.01)
    assert not GoalOffsets().draw(rng).any()


def test_adaptation_learns_each_tasks_own_offset(quick: Bench) -> None:
    learned = run_practice(quick, start(quick), CONFIG)
    method = replace(start(quick), planner=learned.planner, landing=LandingModel(learned.samples, CONFIG.aim))
    tasks = [JumpTask("near", 0.5), JumpTask("far", 0.5)]
    found = adapt_offsets(quick, method, tasks, AdaptConfig(jumps=4, rate=0.7))
    assert found.offset["far"][0] == pytest.approx(-0.01 * HEAVIER_CM, abs=0.006)
    assert abs(found.offset["near"][0]) < 0.006
    after = {task.name: law(quick.trial("after", found, task, 0)).landings[0].error_cm for task in tasks}
    before = {task.name: law(quick.trial("before", method, task, 0)).landings[0].error_cm for task in tasks}
    assert abs(before["far"]) > 3
    assert abs(after["far"]) < 0.7


def test_the_best_shift_cancels_the_mean_error(quick: Bench, reference: Log) -> None:
    planned = []

    def plan(target: Target) -> Log:
        planned.append(target)
        return reference

    tasks = [JumpTask("jump_50", 0.5), JumpTask("again", 0.5)]
    method = learn_shift(quick, tasks[:1], tasks, plan)
    assert method.shift_m == pytest.approx(-0.07)
    assert Target(0.43) in method.references
    assert planned == [Target(0.43)]  # a reference that is there is not planned again


def test_without_practice_the_plan_goes_to_the_target(quick: Bench) -> None:
    assert start(quick).landing is None
    done = law(quick.trial("untaught", start(quick), JumpTask("jump_50", 0.5), 0))
    assert done.samples.goal[0] == pytest.approx(target_pose(Target(0.5)))
