"""A run of a task: what lands where, what it asked of the robot, and jumps in a row."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.control.mpc import MpcConfig
from leapgap.jumping.experiments.goal_directed_jump import OTHER_PLAN, GoalDirectedJump, JumpPlanner, target_pose
from leapgap.jumping.experiments.method import AimingMethod, JointPdMethod, JumpTask, MpcMethod
from leapgap.jumping.experiments.rig import Bench
from leapgap.jumping.experiments.trial import TrialOutcome, attempt_task, landing_pose, landing_samples
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBodyModel
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.logs.pair_force import per_pair
from tests.conftest import A1_BODY

TASK = JumpTask("jump_50", 0.5)


def outcome(
    bench: Bench, method: JointPdMethod | AimingMethod | MpcMethod, task: JumpTask = TASK, **changed: tuple
) -> TrialOutcome:
    found = changed.get("effects", ())
    return attempt_task(task, method, bench.level, found, bench.world, np.random.default_rng(0))


def test_a_planned_jump_of_the_robot_itself_lands_where_it_is_planned(bench: Bench, joint_pd: JointPdMethod) -> None:
    (landed,) = outcome(bench, joint_pd).landings
    assert landed.success
    assert abs(landed.error_cm) < 6  # what the planner's planar robot and the joint PD leave
    weak = (effects.effect("torque_gain", scale=0.7),)
    assert outcome(bench, joint_pd, effects=weak).landings[0].error_cm > landed.error_cm + 4


def test_the_mpc_solves_all_of_a_jump_of_a_weak_robot(bench: Bench) -> None:
    weak = (effects.effect("torque_gain", scale=0.9),)
    method = MpcMethod(bench.robot, bench.references, model=RigidBodyModel(A1_BODY), config=MpcConfig())
    assert not outcome(bench, method, effects=weak).fallbacks


def test_jumps_in_a_row_are_each_judged_from_their_own_take_off(bench: Bench, joint_pd: JointPdMethod) -> None:
    found = outcome(bench, joint_pd, JumpTask("two", 0.5, jumps=2))
    assert len(found.landings) == 2
    assert all(one.success for one in found.landings)
    x = found.run.truth.qpos[:, 0]
    first, second = found.starts
    assert found.landings[1].error_cm == pytest.approx(100 * (0.5 - x[second + 1200] + x[second]), abs=0.1)
    assert found.total_error_cm == pytest.approx(100 * (1.0 - x[second + 1200] + x[first]), abs=0.1)
    assert abs(x[second] - x[first + 1200]) > 0.005  # it slides and settles between the jumps: the total knows


def test_conduct_is_judged_by_true_forces(bench: Bench, joint_pd: JointPdMethod) -> None:
    found = outcome(bench, joint_pd)
    force = per_pair(bench.robot, found.run.ground_force)
    assert 200 < found.metrics.force_n < 400  # planned: 236 N at the rear
    assert force[:400].mean(axis=0)[[1, 3]].sum() == pytest.approx(12.453 * 9.81, rel=0.1)  # it hardly rises yet
    assert 0.1 < found.metrics.friction < 0.8  # friction of the ground
    assert 0.001 < found.metrics.tracking_rad < 0.05
    slow = outcome(bench, joint_pd, effects=(effects.effect("joint_damping", damping=1.0),)).metrics
    assert slow.tracking_rad > 1.5 * found.metrics.tracking_rad
    assert slow.torque_nm > found.metrics.torque_nm


def test_an_aimed_jump_stands_measures_its_stance_and_plans(bench: Bench) -> None:
    planner = JumpPlanner(planar_robot(bench.robot))
    method = AimingMethod(bench.robot, bench.references, planner=planner)
    found = outcome(bench, method, JumpTask("jump_50", 0.5, block_m=(0.05, 0.05)))
    (jump,) = found.controllers
    assert isinstance(jump, GoalDirectedJump)
    assert jump.stance_pitch == pytest.approx(-np.arctan2(0.05, 0.366), abs=0.02)
    assert found.starts[0] == 60  # ms of standing
    assert jump.goal == pytest.approx([0.5, 0.0, 0.0])
    assert not found.substituted
    assert len(landing_samples(found)) == 1
    assert abs(found.landings[0].error_cm) < 8  # a plan for level ground falls 20 cm short from here


@pytest.mark.long
def test_a_goal_without_a_plan_becomes_a_nearer_one_and_says_so(bench: Bench) -> None:
    planner = JumpPlanner(planar_robot(bench.robot))
    method = AimingMethod(bench.robot, bench.references, planner=planner, goal_offset=np.array([0.0, 0.9, 0.0]))
    found = outcome(bench, method)
    (jump,) = found.controllers
    assert isinstance(jump, GoalDirectedJump) and jump.goal is not None
    assert 0 <= jump.goal[1] < 0.9
    assert found.substituted == ((0.06, OTHER_PLAN),)
    assert found.fallbacks == {OTHER_PLAN: 1}


def test_what_the_robot_cannot_do_is_planned_for_a_nimbler_one(bench: Bench) -> None:
    able = planar_robot(bench.robot)
    weak = replace(able, torque_limit=tuple(0.1 * torque for torque in able.torque_limit))
    goal = target_pose(Target(0.5))
    assert JumpPlanner(weak).plan_nearest(Target(0.5), goal, 0.0) is None
    found = JumpPlanner(weak, fallback_robots=(weak, able)).plan_nearest(Target(0.5), goal, 0.0)
    assert found is not None
    to, solution = found
    assert to == pytest.approx(goal)
    assert solution.problem.robot == able


def test_a_flight_that_the_ground_cuts_short_is_continued_as_a_free_one(bench: Bench, joint_pd: JointPdMethod) -> None:
    """The same jump, judged at its scheduled end and as if it was to fly on for 60 ms more: it has touched by then."""
    found = outcome(bench, joint_pd)
    height = bench.level["base_pos_z"][0]
    on_time = landing_pose(found, 0, ContactSchedule(), height)
    late = landing_pose(found, 0, ContactSchedule(flight_s=0.46), height)
    row = np.flatnonzero(found.run.touching[900:].any(axis=1))[0] + 900
    assert 1150 < row < 1260
    position, velocity = found.run.truth.qpos[row - 1], found.run.truth.qvel[row - 1]
    left = 1.26 - 0.001 * (row - 1)
    assert late[0] == pytest.approx(position[0] - found.run.truth.qpos[0, 0] + left * velocity[0], abs=0.005)
    assert late[1] == pytest.approx(position[2] + left * velocity[2] - 9.81 / 2 * left**2 - height, abs=0.005)
    assert late[1] < on_time[1] < 0.1


def test_a_slope_tilts_robot_and_stance(bench: Bench) -> None:
    method = AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))
    found = outcome(bench, method, JumpTask("jump_50", 0.5, slope_rad=(0.04, 0.04)))
    (jump,) = found.controllers
    assert isinstance(jump, GoalDirectedJump)
    assert jump.stance_pitch == pytest.approx(0.04, abs=0.004)
    assert found.run.log.pitch[0] == pytest.approx(0.04, abs=0.01)


def test_ground_that_is_not_seen_is_planned_for_as_level(bench: Bench) -> None:
    method = AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))
    task = JumpTask("late_block", 0.5, block_m=(0.05, 0.05), rear_block_m=(0.03, 0.03), stance_is_seen=False)
    found = outcome(bench, method, task)
    (jump,) = found.controllers
    assert isinstance(jump, GoalDirectedJump)
    assert jump.stance_pitch == 0.0
    assert found.run.log.pitch[0] == pytest.approx(-np.arctan2(0.02, 0.366), abs=0.015)
    boxes = found.run.log.info.terrain
    assert sorted(box.top_m for box in boxes) == [0.03, 0.05]
    assert found.run.log["base_pos_z"][0] - bench.level["base_pos_z"][0] == pytest.approx(0.04, abs=0.006)


def test_a_kick_counts_from_the_start_of_the_jump_not_of_the_stand(bench: Bench) -> None:
    method = AimingMethod(bench.robot, bench.references, planner=JumpPlanner(planar_robot(bench.robot)))
    kicked = outcome(bench, method, JumpTask("jump_50", 0.5, kick_m_s=0.2, disturbed_at_s=(0.3,)))
    (first,) = kicked.starts
    assert first == 60
    changes = np.abs(np.diff(kicked.run.truth.base_velocity[first : first + 450, 0]))
    assert np.argmax(changes) == 300  # in the step that follows the row at 0.3 s
    assert changes[300] == pytest.approx(0.2, abs=0.03)
    assert np.sort(changes)[-2] < 0.05
