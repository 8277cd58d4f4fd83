"""A family of plans: smooth in the goal, the same whatever was planned before, and locally what cold plans are."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS, JumpPlanner
from leapgap.jumping.models.planar import PlanarRobot, planar_robot, planar_robot_with
from leapgap.jumping.planning.dynamics import JOINT
from leapgap.jumping.planning.problem import Aim, Grid, Problem
from leapgap.jumping.planning.solve import FamilyConfig, PlanFamily, solve, toward_origin
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.model import Robot

GRID = Grid(ContactSchedule())


def family_of(robot: PlanarRobot) -> PlanFamily:
    return PlanFamily(robot, GRID, AIMING_LIMITS, FamilyConfig())


@pytest.fixture(scope="module")
def worn(robot: Robot) -> PlanarRobot:
    """A robot whose cold plans to 50 and to 52 cm crouch differently: joints 0.3 rad and forces 35 N apart."""
    found = (effects.effect("joint_damping", damping=0.26567), effects.effect("armature", inertia=0.0179))
    return planar_robot_with(robot, found)


@pytest.fixture(scope="module")
def family(worn: PlanarRobot) -> PlanFamily:
    return family_of(worn)


def test_neighbouring_goals_have_neighbouring_plans(worn: PlanarRobot) -> None:
    planner = JumpPlanner(worn, limits=AIMING_LIMITS)
    plans = []
    for x in np.arange(0.44, 0.561, 0.02):
        plan = planner.plan(Target(0.5), np.array([x, 0.0, 0.0]), 0.0)
        assert plan is not None
        plans.append(plan.trajectory)
    joints = np.array([plan.q[:, JOINT] for plan in plans])
    forces = np.array([plan.force for plan in plans])
    assert np.abs(np.diff(joints, axis=0)).max() < 0.06  # rad per 2 cm
    assert np.abs(np.diff(forces, axis=0)).max() < 8  # N


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slopes_are_those_of_cold_plans(robot: Robot, axis: int) -> None:
    """Differences of the family's plans, against those of plans that know nothing of a family."""
    planar = planar_robot(robot)
    target, goal, step = Target(0.42), np.array([0.42, 0.01, 0.0]), 0.01 * np.eye(3)[axis]
    own = family_of(planar)

    def cold(to: np.ndarray) -> np.ndarray:
        aim = Aim(*(float(v) for v in to - [target.x_m, 0.0, 0.0]))
        return solve(Problem(target, GRID, planar, limits=AIMING_LIMITS, aim=aim)).trajectory.q

    slope = own.plan(target, goal + step, 0.0).trajectory.q - own.plan(target, goal - step, 0.0).trajectory.q
    expected = cold(goal + step) - cold(goal - step)
    assert np.abs(expected).max() > 0.005
    np.testing.assert_allclose(slope, expected, atol=0.02 * np.abs(expected).max())


def test_a_plan_does_not_depend_on_what_was_planned_before(worn: PlanarRobot, family: PlanFamily) -> None:
    goal, target = np.array([0.57, 0.02, -0.03]), Target(0.57)
    family.plan(target, np.array([0.7, 0.0, 0.05]), -0.1)
    after_others = family.plan(target, goal, 0.0)
    alone = family_of(worn).plan(target, goal, 0.0)
    assert np.array_equal(after_others.iterate.w, alone.iterate.w)


def test_a_plan_starts_from_the_stance_and_ends_at_its_goal(family: PlanFamily) -> None:
    plan = family.plan(Target(0.6), np.array([0.55, 0.03, -0.05]), -0.1)
    assert plan.solved
    q = plan.trajectory.q
    assert q[0, 2] == pytest.approx(-0.1, abs=1e-8)
    assert q[-1, [0, 2]] == pytest.approx([0.55, -0.05], abs=1e-7)


def test_on_a_box_too_the_plans_are_neighbours(family: PlanFamily) -> None:
    box = Target(0.6, 0.2)
    near, far = (family.plan(box, np.array([x, 0.21, 0.0]), 0.0) for x in (0.6, 0.61))
    assert near.solved and far.solved
    assert np.abs(near.trajectory.q - far.trajectory.q).max() < 0.05


def test_a_robot_that_cannot_jump_has_no_plans(worn: PlanarRobot) -> None:
    weak = replace(worn, torque_limit=(2.0, 2.0))
    assert not family_of(weak).plan(Target(0.5), np.array([0.5, 0.0, 0.0]), 0.0).solved


def test_the_way_to_every_node_leads_from_the_canonical_jump() -> None:
    index, way = (2, -1, 0, 3), []
    while any(index):
        index = toward_origin(index)
        way.append(index)
    assert way == [(2, -1, 0, 2), (1, -1, 0, 2), (1, -1, 0, 1), (0, -1, 0, 1), (0, 0, 0, 1), (0, 0, 0, 0)]
