"""Feet in the air keep off the floor and clear of boxes, for robots whose published plans would not."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.models.planar import PlanarRobot, planar_robot_with
from leapgap.jumping.planning.dynamics import legs
from leapgap.jumping.planning.nlp import ROUNDED_M, SWING_RISE_M
from leapgap.jumping.planning.problem import Aim, Limits, Problem, start_feet, terrain
from leapgap.jumping.planning.solve import Solution, planner_of, solve
from leapgap.jumping.task import Target
from leapgap.robot.model import Robot

FREE = Limits(friction=0.6, knee_clearance_m=0.04)
CLEAR = replace(FREE, swing_clearance_m=0.02)
BOX = Target(0.6, 0.2)


@pytest.fixture(scope="module")
def stiff(robot: Robot) -> PlanarRobot:
    found = [effects.effect("joint_damping", damping=1.9941), effects.effect("armature", inertia=0.010512)]
    return planar_robot_with(robot, found)


def feet(solution: Solution) -> np.ndarray:
    """Centres against those of level feet at the start, (knots, pairs, x z); x against the trunk's start."""
    floor = start_feet(solution.problem.robot)[0][1]
    return np.array(
        [[[float(leg.foot.x), float(leg.foot.z) - floor] for leg in legs(solution.problem.robot, q)]
         for q in solution.trajectory.q]
    )  # fmt: skip


def test_swinging_feet_leave_the_floor(stiff: PlanarRobot) -> None:
    problem = Problem(Target(0.7), robot=stiff, limits=FREE, stance_pitch_rad=0.002, aim=Aim(0.029, -0.004, 0.027))
    free, clear = solve(problem), solve(replace(problem, limits=CLEAR))
    assert free.solved and clear.solved
    assert feet(free)[50:80, 0, 1].min() < -0.01, "as published, 1 cm below the floor"
    rise = np.minimum(0.02, SWING_RISE_M * np.arange(30))
    height = feet(clear)[50:80, 0, 1] - feet(clear)[0, 0, 1]
    assert (height >= rise - 1e-3).all()  # the foot's centre, where the limit is on the foot less its rolling


def test_a_plan_that_is_clear_of_the_box_stays_as_it_is(robot: Robot) -> None:
    slow = planar_robot_with(robot, [effects.effect("joint_damping", damping=0.5)])
    free = solve(Problem(BOX, robot=slow, limits=FREE))
    clear = solve(Problem(BOX, robot=slow, limits=CLEAR))
    assert clear.solved
    np.testing.assert_allclose(clear.trajectory.q, free.trajectory.q, atol=1e-6)


@pytest.mark.long
def test_feet_do_not_sweep_through_the_box(robot: Robot) -> None:
    found = [effects.effect("joint_damping", damping=1.5487), effects.effect("armature", inertia=0.0045)]
    problem = Problem(BOX, robot=planar_robot_with(robot, found), limits=CLEAR, aim=Aim(0.004, -0.022, 0.066))
    through, clear = planner_of(problem).solve(problem), solve(problem)
    assert through.solved and clear.solved
    assert within(through) > 0.05
    assert within(clear) < ROUNDED_M / 2


def within(solution: Solution) -> float:
    """How deep a foot that still flies is in the box, m; negative is outside."""
    (box,) = terrain(solution.problem.robot, solution.problem.target)
    edge = box.x_m - box.size_m[0] / 2 - solution.problem.robot.foot_radius
    x, z = np.moveaxis(feet(solution)[50:-12], 2, 0)
    return float(np.minimum(x - edge, box.top_m - z).max())
