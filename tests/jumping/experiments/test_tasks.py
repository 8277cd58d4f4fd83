"""Ground of tasks: drawn, where feet land, and the same for the same draw."""

import numpy as np
import pytest

from leapgap.jumping.control.reference import Reference
from leapgap.jumping.experiments.tasks import BLOCK_EDGES_M, JumpTask
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
