"""Ground of tasks: drawn, where feet land, and the same for the same draw."""

import numpy as np
import pytest

from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.experiments.method import BLOCK_EDGES_M, JumpTask
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


def test_blocks_between_jumps_lie_under_one_pair_of_feet(robot: Robot, reference: Log) -> None:
    task, planned = JumpTask("uneven", 0.6, jumps=4, uneven_m=(0.02, 0.04)), Reference.of(reference, robot)
    rng, under = np.random.default_rng(0), set()
    for _ in range(20):
        boxes = task.ground(planned, rng)
        assert len(boxes) == 3
        for number, box in enumerate(boxes, start=1):
            apart = np.array([box.x_m - 0.6 * number - planned.foot[0, pair] for pair in (0, 2)])
            assert np.abs(apart).min() <= 0.03 + 1e-3 < BLOCK_EDGES_M[0] / 2
            under.add(int(np.abs(apart).argmin()))
            assert 0.02 <= box.top_m <= 0.04
            assert box.size_m[2] == box.top_m
    assert under == {0, 1}


def test_flat_level_ground_is_nothing_and_draws_nothing(robot: Robot, reference: Log) -> None:
    task, rng = JumpTask("flat", 0.6), np.random.default_rng(0)
    assert task.ground(Reference.of(reference, robot), rng) == ()
    assert task.tilt(rng) == ()
    assert task.start_block(rng) == 0.0


def test_slopes_are_drawn_within_their_range() -> None:
    task, rng = JumpTask("sloping", 0.6, slope_rad=(-0.005, 0.005)), np.random.default_rng(0)
    slopes = [effect.values["pitch_rad"] for _ in range(200) for effect in task.tilt(rng)]
    assert min(slopes) == pytest.approx(-0.005, abs=3e-4)
    assert max(slopes) == pytest.approx(0.005, abs=3e-4)
    assert abs(np.mean(slopes)) < 0.001


def test_a_kick_or_a_push_is_drawn_once_a_jump_in_both_directions() -> None:
    task, rng = JumpTask("push", 0.6, kick_m_s=0.2, kick_rad_s=1.0, push_n=(30.0, 60.0)), np.random.default_rng(0)
    drawn = [task.disturbances(rng) for _ in range(300)]
    assert all(len(one) == 1 for one in drawn)
    assert {one.begin_s for (one,) in drawn} == {0.3, 0.4}
    assert {one.velocity for (one,) in drawn if not any(one.force_n)} == {
        (0.2, 0.0, 0.0),
        (-0.2, 0.0, 0.0),
        (0.0, 0.0, 1.0),
        (0.0, 0.0, -1.0),
    }
    pushes = np.array([one.force_n[0] for (one,) in drawn if any(one.force_n)])
    assert 60 < len(pushes) < 140
    assert 30 <= np.abs(pushes).min() < 33 and 57 < np.abs(pushes).max() <= 60
    assert 0.3 < (pushes > 0).mean() < 0.7
    assert {one.duration_s for (one,) in drawn if any(one.force_n)} == {0.1}


def test_a_task_without_disturbances_draws_nothing(robot: Robot) -> None:
    task, rng = JumpTask("calm", 0.6), np.random.default_rng(0)
    before = rng.bit_generator.state
    assert task.disturbances(rng) == ()
    assert task.crouch_error(robot, rng) == ()
    assert task.rear_start_block(rng) == 0.0
    assert rng.bit_generator.state == before


def test_a_wrong_crouch_is_equal_left_and_right_and_spares_the_abduction(robot: Robot) -> None:
    error = np.array(JumpTask("crouch", 0.6, crouch_error_rad=0.1).crouch_error(robot, np.random.default_rng(0)))
    of = dict(zip(robot.joints, error, strict=True))
    for right, left in (("FR", "FL"), ("RR", "RL")):
        assert of[f"{right}_hip"] == of[f"{left}_hip"] == 0
        for joint in ("thigh", "calf"):
            assert of[f"{right}_{joint}"] == of[f"{left}_{joint}"]
            assert 0 < abs(of[f"{right}_{joint}"]) <= 0.1
    assert len({abs(value) for value in error}) == 5
