import os
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import scipy.io

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.dynamics import CROUCH, JOINT, X, Z, legs
from leapgap.jumping.planning.problem import Aim, Grid, Problem
from leapgap.jumping.planning.solve import planner_of, solve, solve_all
from leapgap.jumping.task import ContactSchedule, Target
from tests.jumping.planning.centre_of_mass import centre_of_mass
from tests.jumping.planning.conftest import PUBLISHED_COST, target_of
from tests.jumping.planning.lagrangian import residual

NAMES = sorted(PUBLISHED_COST)


@pytest.mark.parametrize("name", NAMES)
def test_cost_is_the_published_one(solutions, name):
    solution = solutions[name]
    assert solution.solved, solution.status
    assert solution.max_violation <= 1e-6
    assert solution.cost == pytest.approx(PUBLISHED_COST[name], abs=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_trajectory_obeys_the_published_discretisation(solutions, name):
    plan, dt = solutions[name].trajectory, 0.01
    balance = residual(PlanarRobot())
    for k in range(len(plan.torque)):
        a = (plan.v[k + 1] - plan.v[k]) / dt
        assert np.abs(np.array(balance(plan.q[k], plan.v[k], a, plan.torque[k], plan.force[k]))).max() < 1e-6
    np.testing.assert_allclose(np.diff(plan.q, axis=0), dt * plan.v[1:], atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_jump_starts_at_rest_and_lands_on_the_target_in_the_crouch(solutions, name):
    solution = solutions[name]
    plan, target, crouch = solution.trajectory, solution.problem.target, CROUCH
    np.testing.assert_allclose(plan.q[0], [0, 0, 0, *crouch], atol=1e-8)
    np.testing.assert_allclose(plan.v[0], 0, atol=1e-8)
    np.testing.assert_allclose(plan.q[-1], [target.x_m, target.z_m, 0, *crouch], atol=1e-7)
    np.testing.assert_allclose(plan.q[-11:, JOINT], np.tile(crouch, (11, 1)), atol=1e-7)


def test_torques_of_weaker_motors_stay_within_their_limit(solutions):
    """The limits of the motors are constraints of the plan: half of a pair's torque is that of one motor."""
    strong = np.abs(solutions["h20_d60"].trajectory.torque).max() / 2
    weak = 0.9 * strong
    assert 15 < strong < 33.5
    solution = solve(Problem(target_of("h20_d60"), robot=PlanarRobot(torque_limit=(weak, weak))))
    assert solution.solved, solution.status
    assert np.abs(solution.trajectory.torque).max() / 2 == pytest.approx(weak, abs=1e-6)
    assert solution.cost > solutions["h20_d60"].cost


@pytest.mark.parametrize("name", NAMES)
def test_forces_stay_in_the_friction_cone_and_end_with_the_phases(solutions, name):
    force = solutions[name].trajectory.force  # on the ground
    front, rear = force[:49], force[:79, 2:]
    assert (front[:, 1] <= -30 + 1e-6).all() and (rear[:, 1] <= -50 + 1e-6).all()
    assert (np.abs(front[:, 0]) <= -0.4 * front[:, 1] + 1e-6).all()
    assert (np.abs(rear[:, 0]) <= -0.4 * rear[:, 1] + 1e-6).all()
    assert not force[49:, :2].any() and not force[79:].any()


@pytest.mark.parametrize("name", NAMES)
def test_motors_stay_within_torque_and_voltage(solutions, name):
    plan = solutions[name].trajectory
    assert (np.abs(0.34602 * plan.torque / 2 + plan.v[:-1, JOINT]) <= 21.5 + 1e-6).all()
    assert np.abs(plan.torque[:50]).max() <= 67 + 1e-6
    assert np.abs(plan.torque[50:80, :2]).max() <= 20 + 1e-6
    assert np.abs(plan.torque[80:]).max() <= 30 + 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_standing_feet_do_not_move(solutions, name):
    q = solutions[name].trajectory.q
    for pair, stands in enumerate((50, 80)):
        at = [legs(PlanarRobot(), row)[pair].foot for row in q[:stands]]
        feet = np.array([[float(foot.x), float(foot.z)] for foot in at])
        np.testing.assert_allclose(feet, np.tile(feet[0], (stands, 1)), atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_flight_is_ballistic_and_keeps_angular_momentum(solutions, name):
    plan, robot, dt = solutions[name].trajectory, PlanarRobot(), 0.01
    com = np.array([centre_of_mass(robot, q) for q in plan.q[79:]])
    acceleration = np.diff(com, n=2, axis=0) / dt**2
    # Of first order in dt: the error shows while the legs still swing, not once they are still.
    np.testing.assert_allclose(acceleration[-9:], np.tile([0, -9.81], (9, 1)), atol=1e-4)
    np.testing.assert_allclose(acceleration.mean(axis=0), [0, -9.81], atol=0.05)
    states = zip(plan.q[79:], plan.v[79:], strict=True)
    momentum = np.array([angular_momentum(robot, *state) for state in states])
    assert np.ptp(momentum[-10:]) < 1e-9
    assert np.ptp(momentum) < 0.05 * np.abs(momentum).max()


def angular_momentum(robot: PlanarRobot, q: np.ndarray, v: np.ndarray) -> float:
    """About the centre of mass, kg·m²/s; motors do not count, they turn with their joints only."""

    def parts(t: ca.SX) -> ca.SX:
        at = [q[i] + t * v[i] for i in range(7)]
        rows = [(robot.trunk_mass, robot.trunk_inertia, at[X], at[Z], at[2])]
        for leg, of, i in zip(legs(robot, at), robot.legs, (3, 5), strict=True):
            thigh = at[2] - at[i]
            mid = leg.hip + leg.hip_to_thigh_com
            rows.append((2 * of.thigh.mass, 2 * of.thigh.inertia, mid.x, mid.z, thigh))
            mid = leg.knee + leg.knee_to_calf_com
            rows.append((2 * of.calf.mass, 2 * of.calf.inertia, mid.x, mid.z, thigh - at[i + 1]))
        return ca.vertcat(*[ca.horzcat(*row) for row in rows])

    t = ca.SX.sym("t")
    table = parts(t)
    evaluate = ca.Function("rates", [t], [table, ca.jacobian(table[:, 2:], t)])
    now, rates = (np.array(each) for each in evaluate(0))
    rates = rates.reshape(3, -1).T
    mass, inertia = now[:, 0], now[:, 1]
    centre, drift = (mass @ now[:, 2:4]) / mass.sum(), (mass @ rates[:, :2]) / mass.sum()
    arm, speed = now[:, 2:4] - centre, rates[:, :2] - drift
    return float((inertia * rates[:, 2] + mass * (arm[:, 1] * speed[:, 0] - arm[:, 0] * speed[:, 1])).sum())


def test_published_trajectories(solutions):
    folder = os.environ.get("LEAPGAP_REFERENCES")
    if not folder or not Path(folder).is_dir():
        pytest.skip("LEAPGAP_REFERENCES names no folder of the published references")
    for name, solution in solutions.items():
        file = scipy.io.loadmat(Path(folder) / f"jumpingFull_A1_1ms_{name}_interp.mat")
        plan = solution.trajectory
        pad = np.full((1, 4), 2.0)  # the published files keep the first guess in the last knot
        for key, ours, tolerance in (
            ("Q", np.hstack([plan.q, plan.v]), 3e-5),
            ("tau", np.vstack([plan.torque, pad]), 3e-4),
            ("F", np.vstack([plan.force, 0 * pad]), 1e-3),
        ):
            # 120 knots were stretched linearly over 1200 samples.
            stretched = [np.interp(np.arange(1200) * 119 / 1199, np.arange(120), each) for each in ours.T]
            np.testing.assert_allclose(file[key], stretched, atol=tolerance, err_msg=f"{name} {key}")


def test_near_solution_changes_the_way_and_not_the_result(solutions):
    target = Problem(Target(0.61))
    cold, warm = solve(target), solve(target, near=solutions["h00_d60"])
    assert warm.iterations < cold.iterations
    assert warm.cost == pytest.approx(cold.cost, abs=1e-4)
    np.testing.assert_allclose(warm.trajectory.q, cold.trajectory.q, atol=1e-6)


def test_order_of_targets_does_not_change_the_plans():
    problems = [Problem(Target(x)) for x in (0.5, 0.52, 0.6)]
    forwards, backwards = list(solve_all(problems)), list(solve_all(problems[::-1]))
    for one, other in zip(forwards, backwards[::-1], strict=True):
        assert one.problem.target == other.problem.target
        np.testing.assert_allclose(one.trajectory.torque, other.trajectory.torque, atol=1e-4)


def test_another_schedule_moves_the_phases():
    problem = Problem(Target(0.5), Grid(ContactSchedule(0.4, 0.35, 0.38)))
    solution = solve(problem)
    assert solution.solved, solution.status
    assert solution.trajectory.q.shape == (113, 7)
    loaded = solution.trajectory.force != 0
    assert loaded[:39].all() and not loaded[39:, :2].any()
    assert loaded[:74, 2:].all() and not loaded[74:].any()
    assert problem.grid.knot_times[-1] == pytest.approx(1.13)


def test_what_stands_in_the_way_of_a_high_jump_is_named():
    problem = Problem(Target(0.6, 0.4))
    obstacle = str(planner_of(problem).obstacle(problem))
    assert re.fullmatch(r"torque-speed limit, rear_calf, knot 7\d, by 9\.\d+ rad/s", obstacle)


def test_a_jump_of_three_metres_is_refused_with_target_and_limit():
    message = (
        r"jump target x 3 m, z 0 m: found no feasible jump \(.*\); with motors as strong as it takes, "
        r"broken most: "
        r"(torque-speed limit|torque bounds|joint speed), \w+, knot \d+, by [\d.]+ (rad/s|N·m); expected"
    )
    with pytest.raises(InputError, match=message):
        list(solve_all([Problem(Target(3.0))]))


def test_a_phase_that_is_no_whole_number_of_steps_is_refused():
    message = (
        "contact schedule, flight_s: found 0.405 s; expected a whole number of 0.01 s steps, one or more; "
        "the nearest lengths are 0.4 s and 0.41 s"
    )
    with pytest.raises(InputError) as error:
        Grid(ContactSchedule(flight_s=0.405))
    assert str(error.value) == message


@pytest.mark.parametrize("target", [Target(float("nan")), Target(9.0), Target(0.5, -0.1), Target(0.5, float("inf"))])
def test_a_target_that_is_no_jump_is_refused(target):
    with pytest.raises(InputError, match="jump target"):
        Problem(target)


def test_a_plan_from_a_block_starts_pitched_and_still_lands_level_on_target() -> None:
    robot = PlanarRobot()
    pitch = -np.arcsin(0.05 / robot.wheelbase)
    solution = solve(Problem(Target(0.5, 0.0), stance_pitch_rad=float(pitch)))
    assert solution.solved
    q = solution.trajectory.q
    assert q[0, :3] == pytest.approx([0, 0, pitch])
    start, later = (np.array([(leg.foot.x, leg.foot.z) for leg in legs(robot, q[k])], float) for k in (0, 40))
    assert later == pytest.approx(start, abs=1e-6)  # all feet stay where they stood
    assert start[0, 1] - start[1, 1] == pytest.approx(0.05, abs=1e-4)
    level = -float(legs(robot, np.array([0, 0, 0, *CROUCH]))[1].foot.z)
    assert q[-1, 0] == pytest.approx(0.5)
    assert q[-1, 1] - start[1, 1] == pytest.approx(level)  # at standing height over the floor the rear feet stood on
    assert q[-1, 2] == pytest.approx(0)


def test_an_aim_beyond_the_target_moves_the_plan_and_not_the_target() -> None:
    solution = solve(Problem(Target(0.5, 0.0), aim=Aim(0.04, 0.02, 0.1)))
    assert solution.solved
    assert solution.trajectory.q[-1, :3] == pytest.approx([0.54, 0.02, 0.1])
    assert solution.problem.target == Target(0.5, 0.0)
