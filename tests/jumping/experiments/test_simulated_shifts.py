"""Shifted jumps: what is simulated from commands alone is what the controller does in closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control.shifted_plan import ShiftGrid
from leapgap.jumping.control.tracking import JointPd
from leapgap.jumping.experiments.goal_directed_jump import (
    AIMING_LIMITS,
    AimConfig,
    JumpPlanner,
    LandingModel,
    LandingSamples,
    best_goal,
)
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump, GoalShiftMethod, shifted_plan
from leapgap.jumping.experiments.method import AimingMethod, JumpTask, Method
from leapgap.jumping.experiments.methods.learned_goal_mpc import HeldShiftsConfig, measure_held_shifts
from leapgap.jumping.experiments.rig import Bench
from leapgap.jumping.experiments.simulated_shifts import (
    Kick,
    ShiftDraws,
    ShiftSimulator,
    SimulatedJump,
    SimulatedShiftsConfig,
    bends,
    draw_push,
    shift_at,
)
from leapgap.jumping.experiments.trial import TrialOutcome, attempt_task, shifted_jumps
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.task import ContactSchedule
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.controller import StateEstimate
from leapgap.simulation.open_loop import Course, MotionPlan, prepare
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from tests.jumping.control.simple_models import unchanging

GRID = ShiftGrid(ContactSchedule())
SILENT = SensorNoise(0, 0, 0, 0, 0, 0)
TASK = JumpTask("jump_50", 0.5)


@pytest.fixture
def method(bench: Bench) -> GoalShiftMethod:
    planner = JumpPlanner(planar_robot(bench.robot), limits=AIMING_LIMITS)
    return GoalShiftMethod(bench.robot, bench.references, planner=planner)


def outcome(bench: Bench, method: Method) -> TrialOutcome:
    world = replace(bench.world, sensing=Sensing(SILENT, base_delay_s=0.0))
    return attempt_task(TASK, method, bench.level, (), world, np.random.default_rng(0))


def jump_of(found: TrialOutcome) -> GoalShiftJump:
    (jump,) = found.controllers
    assert isinstance(jump, GoalShiftJump)
    return jump


def test_simulated_and_closed_loop_jumps_agree(bench: Bench, method: GoalShiftMethod) -> None:
    shift = ShiftDraws((0.05, 0.03, 0.06)).draw(GRID.updates, GRID.period_s, np.random.default_rng(4))
    found = outcome(bench, replace(method, exploration=shift))
    measured = shifted_jumps(found)
    assert measured is not None
    np.testing.assert_allclose(measured.shift[0], shift, atol=1e-12)

    jump = jump_of(found)
    assert jump.goal is not None and method.planner is not None
    solution = method.planner.plan(TASK.target, jump.goal, jump.stance_pitch)
    assert solution is not None
    plan = shifted_plan(method.planner, solution, jump.reference, bench.robot)
    assert plan is not None
    simulator = ShiftSimulator(method.planner, bench.robot, (), bench.level, GRID, 10, 0, SILENT)
    replayer = Replayer(bench.robot, threads=1)
    (start,) = prepare([MotionPlan("level", bench.level)], replayer, (), Course())
    simulated = SimulatedJump(start, plan, shift)
    (motion,) = replayer.true_motions([simulator._rollout(simulated)])
    apart = np.abs(simulator._landing(motion) - measured.landing[0])
    assert (apart < [0.004, 0.004, 0.015]).all(), apart
    deviations = simulator._deviations(simulated, motion)
    typical = np.array([0.01, 0.01, 0.04, 0.1, 0.1, 0.4, 0.01, 0.01, 0.01, 0.01])
    off = np.abs(deviations - measured.deviation[0])[2:] / typical  # the first 50 ms still differ by the stand before
    assert np.median(off) < 0.05, np.median(off, axis=0)
    assert off.max() < 0.6, off.max(axis=0)


def test_a_shift_of_the_whole_jump_is_a_jump_to_another_goal(bench: Bench, method: GoalShiftMethod) -> None:
    moved = np.tile([0.03, 0.0, 0.0], (GRID.updates, 1))
    plain, shifted, planned = (
        outcome(bench, one).landings[0].error_cm
        for one in (
            method,
            replace(method, exploration=moved),
            replace(method, goal_offset=np.array([0.03, 0.0, 0.0])),
        )
    )
    assert plain - planned == pytest.approx(3.0, abs=0.7)
    assert shifted == pytest.approx(planned, abs=0.5)


def test_without_shifts_the_commands_are_those_of_joint_pd(bench: Bench, method: GoalShiftMethod) -> None:
    found = outcome(bench, method)
    jump = jump_of(found)
    own = JointPd(jump.reference, bench.robot, method.gains)
    log, first = found.run.log, found.starts[0]
    for row in (0, 13, 300, 512, 799, 1000, 1190):
        estimate = StateEstimate(
            row / 1000, np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3), np.zeros(12), np.zeros(12),
            np.ones(4, bool),
        )  # fmt: skip
        expected = own.command(estimate)
        for name, values in (
            ("cmd_tau", expected.torque),
            ("cmd_pos", expected.position),
            ("cmd_vel", expected.velocity),
        ):
            np.testing.assert_allclose(log.per_joint(name, bench.robot.joints)[first + row], values, atol=1e-9)


def test_a_jump_without_shifts_measures_what_joint_pd_measures(bench: Bench, method: GoalShiftMethod) -> None:
    """Practice jumps of ``ours`` teach the goal-shift MPC: same plan, same motion, same deviations."""
    aiming = AimingMethod(bench.robot, bench.references, planner=method.planner)
    own, shifted = (shifted_jumps(outcome(bench, one)) for one in (aiming, method))
    assert own is not None and shifted is not None
    assert not own.shift.any() and np.isfinite(own.deviation).all()
    np.testing.assert_allclose(own.deviation, shifted.deviation, atol=1e-9)
    np.testing.assert_array_equal(own.landing, shifted.landing)


def kicks(**changed: object) -> SimulatedShiftsConfig:
    """One goal on flat ground, without shifts."""
    plain = SimulatedShiftsConfig(goals=1, x_m=(0.5, 0.5), z_m=(0.0, 0.0), pitch_rad=(0.0, 0.0), share=(0.0, 0.0))
    return replace(plain, **changed)  # type: ignore[arg-type]


def test_jumps_that_fall_are_not_learned_from(bench: Bench, method: GoalShiftMethod) -> None:
    """Kicked head over heels, of some kicks forward and some back: none that fell is there."""
    assert method.planner is not None
    simulator = ShiftSimulator(method.planner, bench.robot, (), bench.level, GRID, 10, 0, SILENT)
    found = simulator.kicked(kicks(kicks=6, kick=(0.0, 0.0, 12.0)), np.random.default_rng(1))
    assert len(found.landing) < 12
    assert np.abs(found.landing[:, 2]).max() < 1.0
    with pytest.raises(InputError, match="no simulated jump that lands"):
        simulator.kicked(kicks(goals=0), np.random.default_rng(1))


@pytest.mark.parametrize(
    ("kicks_in_flight", "rest_s"),
    [
        ([Kick(1000, np.array([0.2, 0.1, 0.0]))], 0.2),
        ([Kick(row, np.array([0.04, 0.02, 0.0])) for row in (910, 930, 950, 970, 990)], 0.25),
    ],
)
def test_a_kick_or_push_in_flight_moves_the_landing_by_its_velocity_times_the_rest_of_the_flight(
    bench: Bench, method: GoalShiftMethod, kicks_in_flight: list[Kick], rest_s: float
) -> None:
    """Nothing acts in flight but gravity; the landing is 1.2 s after the start."""
    assert method.planner is not None
    simulator = ShiftSimulator(method.planner, bench.robot, (), bench.level, GRID, 10, 0, SILENT)
    replayer = Replayer(bench.robot, threads=1)
    jump = simulator._draw(0, replayer, kicks(), np.random.default_rng(2))[0]
    (calm,) = replayer.true_motions([simulator._rollout(jump)])
    kicked = simulator._kicked(calm, kicks_in_flight, simulator._rollout(jump), replayer)
    moved = simulator._landing(kicked) - simulator._landing(calm)
    np.testing.assert_allclose(moved, [0.2 * rest_s, 0.1 * rest_s, 0.0], atol=1e-3)


def test_a_push_is_spread_evenly_over_its_time() -> None:
    config = SimulatedShiftsConfig(push=(0.6, 0.2, 0.0), push_s=(0.12, 0.12), kick_between_s=(0.3, 0.3))
    push = draw_push(config, 0.001, np.random.default_rng(0))
    assert [kick.row for kick in push] == [310, 330, 350, 370, 390, 410]
    assert len({tuple(kick.change) for kick in push}) == 1
    assert (np.abs(6 * push[0].change) <= config.push).all() and push[0].change[0] != 0


def test_what_a_kick_adds_is_counted_from_the_jump_without_it(bench: Bench, method: GoalShiftMethod) -> None:
    """A faster trunk while four feet stand shows at the next update, and not before."""
    assert method.planner is not None
    simulator = ShiftSimulator(method.planner, bench.robot, (), bench.level, GRID, 5, 0, SILENT)
    config = kicks(kicks=3, kick=(0.3, 0.0, 0.0), push=(0.9, 0.0, 0.0), push_s=(0.06, 0.06), kick_between_s=(0.3, 0.3))
    found = simulator.kicked(config, np.random.default_rng(3))
    assert np.isnan(found.since[:, :13]).all() and np.isfinite(found.since[:, 13:]).all()
    assert (np.sign(found.since[:, 13, 3]) == np.sign(found.since[:, 13, 0])).all()
    assert np.abs(found.since[:, 13, 3]).max() > 0.02


def test_held_shifts_move_the_landing_as_far_as_practice_finds(bench: Bench, method: GoalShiftMethod) -> None:
    """A shift of x that is held from 150 ms on is one of the whole jump; one of nothing is not made."""
    landing = LandingModel(LandingSamples(), AimConfig())
    config = HeldShiftsConfig(distances_m=(0.5,), last_updates=1, shift=(0.03, 0.0, 0.0))
    early = ShiftGrid(ContactSchedule(0.175, 0.625, 0.4), on_rear_feet=False)
    found = measure_held_shifts(bench, method, landing, early, config, "practice")
    assert found.update.tolist() == [6] and found.axis.tolist() == [0]
    assert found.effect[0, 0] == pytest.approx([1.0, 0.0, 0.0], abs=0.35)
    goal = best_goal(landing, TASK.target, 0.0)
    assert found.x_m == pytest.approx([goal[0]])


class Pessimist:
    """Expects, and predicts at every update, to land 6 cm short of any goal."""

    landing = LandingModel(LandingSamples(), AimConfig())
    authority = np.tile(np.eye(3) / GRID.updates, (GRID.updates, 1, 1))
    authority_error = np.zeros((1, GRID.updates, 3, 3))

    def planned_to(self, goal: np.ndarray) -> "Pessimist":
        return self

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        return goal - np.array([0.06, 0.0, 0.0])

    calm = unchanging(GRID.updates, share=1e-4)

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        return np.zeros(3)


def test_what_was_known_before_the_jump_is_not_corrected_in_it(bench: Bench, method: GoalShiftMethod) -> None:
    """The goal was chosen with the same model: where it lands short all the same, a shift must not stretch it."""
    jump = jump_of(outcome(bench, replace(method, feedback=Pessimist())))  # type: ignore[arg-type]
    assert jump.shift_tracker is not None and not jump.fallbacks
    assert np.abs(jump.shifts).max() < 1e-9


def test_one_sided_effects_and_bends_between_goals_are_errors_of_the_authority() -> None:
    """On a line between the goals nothing bends; where the middle one is off by 0.3, that is the error."""
    line = np.arange(3.0)[:, None, None, None] * np.ones((3, GRID.updates, 3, 3))
    assert np.abs(bends(line)).max() == 0
    line[1] += 0.3
    np.testing.assert_allclose(bends(line), np.full((1, GRID.updates, 3, 3), 0.3))
    assert len(bends(line[:2])) == 0


def test_shifts_are_reached_linearly_and_then_held() -> None:
    shift = np.zeros((GRID.updates, 3))
    shift[4:] = [0.02, 0.0, 0.0]
    value, rate = shift_at(shift, GRID, np.array([0.1, 0.1125, 0.125, 0.5, 1.1]))
    np.testing.assert_allclose(value[:, 0], [0, 0.01, 0.02, 0.02, 0.02])
    np.testing.assert_allclose(rate[:, 0], [0.8, 0.8, 0, 0, 0], atol=1e-9)


def test_random_shifts_begin_at_none_and_stay_in_their_range() -> None:
    rng = np.random.default_rng(0)
    drawn = np.array([ShiftDraws((0.05, 0.03, 0.1), 0.15).draw(32, 0.025, rng) for _ in range(200)])
    assert (np.abs(drawn).max(axis=(0, 1)) <= [0.05, 0.03, 0.1]).all()
    assert np.abs(drawn).max(axis=(0, 1)) == pytest.approx([0.05, 0.03, 0.1], rel=0.05)
    assert (np.abs(drawn[:, 0]) <= np.array([0.05, 0.03, 0.1]) / 6 + 1e-12).all()  # a sixth of 150 ms
