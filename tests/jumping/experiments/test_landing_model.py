"""Where a robot lands, learned from jumps whose landings follow a known law."""

import numpy as np
import pytest

from leapgap.jumping.experiments.goal_directed_jump import (
    AimConfig,
    LandingModel,
    LandingSamples,
    best_goal,
    target_pose,
)
from leapgap.jumping.task import Target

BOX = Target(0.6, 0.2)


def lands(goal: np.ndarray, stance: np.ndarray) -> np.ndarray:
    """A robot that lands 12 % short, a little low, and pitched by its stance: (n, 3) of (n, 3) and (n,)."""
    x = 0.88 * goal[:, 0] - 0.6 * stance + 0.1 * goal[:, 2] ** 2
    return np.column_stack([x, goal[:, 1] - 0.02 - 0.1 * goal[:, 0] ** 2, 0.7 * goal[:, 2] + 1.5 * stance])


def practice(jumps: int, noise_m: float = 0.0) -> LandingSamples:
    rng = np.random.default_rng(0)
    goal = np.column_stack(
        [rng.uniform(0.3, 0.9, jumps), rng.uniform(-0.05, 0.25, jumps), rng.uniform(-0.2, 0.2, jumps)]
    )
    stance = rng.uniform(-0.2, 0.0, jumps)
    return LandingSamples(goal, stance, lands(goal, stance) + noise_m * rng.standard_normal((jumps, 3)))


@pytest.mark.parametrize("stance", [0.0, -0.1])
@pytest.mark.parametrize("target", [Target(0.45), Target(0.7), BOX])
def test_the_chosen_goal_lands_on_the_target(target: Target, stance: float) -> None:
    model = LandingModel(practice(60), AimConfig())
    goal = best_goal(model, target, stance)
    missed = lands(goal[None], np.array([stance]))[0] - target_pose(target)
    unaimed = lands(target_pose(target)[None], np.array([stance]))[0] - target_pose(target)
    assert abs(missed[0]) < 0.01
    assert abs(missed[0]) < 0.25 * abs(unaimed[0])
    assert abs(missed[2]) < 0.06


def test_jumps_that_slipped_do_not_move_the_aim_of_those_that_hold() -> None:
    held = practice(30, 0.002)
    rng = np.random.default_rng(1)
    goal = np.column_stack([rng.uniform(0.6, 0.9, 6), rng.uniform(0.0, 0.1, 6), rng.uniform(-0.2, 0.2, 6)])
    slipped = LandingSamples(goal, np.full(6, -0.1), goal - rng.uniform(0.1, 0.5, (6, 1)) * [1, -0.3, 1.5])
    model = LandingModel(held.extended_by(slipped), AimConfig())
    assert (model.sample_weights[30:] < 0.2).all()
    assert model.sample_weights[:30].mean() > 0.9
    missed = lands(best_goal(model, Target(0.7), -0.1)[None], np.array([-0.1]))[0, 0] - 0.7
    assert abs(missed) < 0.02


def test_without_a_model_the_target_is_the_goal() -> None:
    assert best_goal(None, BOX, 0.1) == pytest.approx([0.6, 0.2, 0.0])


def test_an_offset_moves_the_goal_the_other_way() -> None:
    model = LandingModel(practice(60), AimConfig())
    plain, less = best_goal(model, Target(0.6), 0.0), best_goal(model, Target(0.6), 0.0, np.array([0.03, 0.0, 0.0]))
    assert lands(plain[None], np.zeros(1))[0, 0] - lands(less[None], np.zeros(1))[0, 0] == pytest.approx(
        0.03, abs=0.006
    )


def test_far_from_what_was_tried_nothing_is_known_and_no_goal_leaves_its_bounds() -> None:
    config = AimConfig(largest=(0.05, 0.05, 0.05), caution=0.0)
    model = LandingModel(practice(60), config)
    here, there = (model.deviation(np.array([x, 0.0, 0.0]), -0.1) for x in (0.6, 3.0))
    assert (here < 0.2 * there).all()
    assert there == pytest.approx(model.scatter)
    goal = best_goal(model, Target(0.7), 0.0)  # needs about 10 cm more
    assert goal[0] - 0.7 == pytest.approx(0.05, abs=1e-6)
