"""What goal-shift MPC learns: known laws come back, of calm motion, of kicks and of held shifts."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.control.goal_shift_mpc import ChangeRule
from leapgap.jumping.experiments.goal_directed_jump import AimConfig, LandingModel, LandingSamples
from leapgap.jumping.experiments.goal_shift_jump import (
    SCALE,
    Authority,
    FeedbackConfig,
    HeldShifts,
    KickedJumps,
    LandingFeedback,
    ShiftedJumps,
    learn_calm,
    learn_change,
)

UPDATES, PERIOD_S = 16, 0.025
AUTHORITY = 2 * (1 - np.arange(UPDATES) / UPDATES) / (UPDATES + 1)
"""Share of a shift that each update adds to the landing; 1 in all, as of a shift from the start on."""
SHIFTS = Authority(AUTHORITY[None, :, None, None] * np.eye(3), np.zeros((1, UPDATES, 3, 3)))
EMPTY = LandingModel(LandingSamples(), AimConfig())


def swinging(jumps: int, rng: np.random.Generator, noise: float = 0.03) -> np.ndarray:
    """Deviations (jumps, updates, 10) in which velocities move what they are the rates of, and fade; feet stay."""
    law = np.eye(10)
    for place in range(3):
        law[3 + place, place] = 0.025 * SCALE[3 + place] / SCALE[place]
        law[3 + place, 3 + place] = 0.8
    found = np.zeros((jumps, UPDATES, 10))
    found[:, 0] = rng.standard_normal((jumps, 10))
    for update in range(1, UPDATES):
        found[:, update] = found[:, update - 1] @ law + 0.1 + noise * rng.standard_normal((jumps, 10))
    return found * SCALE


@pytest.mark.parametrize(("jumps", "largest"), [(36, 2.0), (200, 1.2)])
def test_a_calm_motion_is_known_from_jumps(jumps: int, largest: float) -> None:
    """Of jumps that were never seen, what is expected is off by the noise; of few jumps that is not known well."""
    calm, fresh = learn_calm(swinging(jumps, np.random.default_rng(0)), FeedbackConfig()), np.random.default_rng(1)
    surprises = []
    for jump in swinging(60, fresh):
        left = {update: jump[update] - calm.carried(update, jump[update - 1]) for update in range(1, UPDATES)}
        surprises += [calm.surprise(update, one) for update, one in left.items()]
    assert 0.7 < np.mean(surprises) < largest
    assert max(surprises) < ChangeRule().least_surprise


def test_without_jumps_a_deviation_stays() -> None:
    calm = learn_calm(np.zeros((0, UPDATES, 10)), FeedbackConfig(calm_noise=0.1))
    now = 0.5 * SCALE
    np.testing.assert_allclose(calm.carried(3, now), now)
    left = 0.2 * SCALE * np.eye(10)[4]
    assert calm.surprise(3, left) == pytest.approx((0.2 / 0.1) ** 2 / 10)


def test_updates_that_did_not_come_are_not_learned_from() -> None:
    found = swinging(60, np.random.default_rng(2))
    whole = learn_calm(found[:50], FeedbackConfig())
    found[50:, 4] = np.nan
    again = learn_calm(found, FeedbackConfig())
    for update in (4, 5):
        np.testing.assert_allclose(again.carry[update], whole.carry[update], atol=1e-9)
    assert not np.allclose(again.carry[8], whole.carry[8])


def kicked(jumps: int, rng: np.random.Generator) -> KickedJumps:
    """Kicks whose added velocity flies on for 0.4 s; at the first update after it a foot shows as much more."""
    kicked_s = rng.uniform(0.05, 0.35, jumps)
    speed = rng.uniform(-0.3, 0.3, jumps)
    times = PERIOD_S * np.arange(UPDATES)
    since = 1e-4 * rng.standard_normal((jumps, UPDATES, 10))
    since[:, :, 3] += speed[:, None]
    first = (times >= kicked_s[:, None]) & (times < kicked_s[:, None] + PERIOD_S)
    since[:, :, 6] += 0.02 * speed[:, None] * first
    since[:, :, 3] *= np.where(first, 0.5, 1.0)
    since[times < kicked_s[:, None]] = np.nan
    return KickedJumps(since, np.outer(speed, [0.4, 0.0, 0.1]))


def test_what_a_kick_does_is_known_at_its_first_update_and_later() -> None:
    by_change = learn_change(kicked(1500, np.random.default_rng(3)), FeedbackConfig())
    model = LandingFeedback(EMPTY, SHIFTS, learn_calm(np.zeros((0, UPDATES, 10)), FeedbackConfig()), by_change)
    at_first, second, later = np.zeros((3, 20))
    at_first[[3, 6]], second[[3, 13, 16]], later[[3, 13]] = [0.1, 0.004], [0.2, 0.1, 0.004], 0.2
    for age, since in ((1, at_first), (2, second), (5, later)):
        np.testing.assert_allclose(model.change(9, age, since), [0.08, 0.0, 0.02], atol=0.004, err_msg=str(age))


def test_without_enough_kicks_just_before_an_update_the_later_model_holds_there() -> None:
    by_change = learn_change(kicked(60, np.random.default_rng(4)), FeedbackConfig())
    np.testing.assert_array_equal(by_change[9, 0], by_change[9, 1])


def test_what_a_shift_does_is_that_of_the_planned_distance() -> None:
    near, far = np.full((1, UPDATES, 3, 3), 0.1), np.full((1, UPDATES, 3, 3), 0.3)
    shifts = Authority(np.concatenate([near, far]), near, np.array([0.4, 0.6]))
    np.testing.assert_allclose(shifts.at(np.array([0.2, 0.4, 0.45, 0.9]))[:, 0, 0, 0], [0.1, 0.1, 0.15, 0.3])
    calm = learn_calm(np.zeros((0, UPDATES, 10)), FeedbackConfig())
    model = LandingFeedback(EMPTY, shifts, calm, np.zeros((UPDATES, 2, 20, 3)))
    assert model.planned_to(np.array([0.5, 0.0, 0.0])).authority[3, 1, 2] == pytest.approx(0.2)


def test_jumps_survive_a_json_file_with_what_is_not_known_of_them() -> None:
    found = kicked(4, np.random.default_rng(5))
    again = KickedJumps.from_json(found.to_json())
    for name in ("since", "landing"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    jumps = ShiftedJumps(*(np.ones((2, *shape)) for shape in ((3,), (), (3,), (UPDATES, 3), (UPDATES, 10))))
    jumps.deviation[1, 3:] = np.nan
    back = ShiftedJumps.from_json(jumps.to_json())
    np.testing.assert_array_equal(back.deviation, jumps.deviation)
    assert len(ShiftedJumps.join([jumps, back])) == 4


def test_what_was_measured_of_held_shifts_takes_the_place_of_what_was_simulated() -> None:
    """Held from update 12 on, x does the opposite on the robot; all other held shifts do what they did."""
    effect = np.array([[[-1.0, 0.5, 0.0]], [[-1.0, 0.5, 0.0]]])
    held = HeldShifts(np.array([0.4, 0.6]), np.array([12]), np.array([0]), effect, 0.1)
    shifts = replace(SHIFTS, error=0.3 * SHIFTS.mean)
    found = shifts.measured(held)
    for g in (0, 1):
        for update in range(UPDATES):
            of_held = found.mean[g, update:].sum(axis=0)
            expected = AUTHORITY[update:].sum() * np.eye(3)
            if update == 12:
                expected[:, 0] = [-1.0, 0.5, 0.0]
            np.testing.assert_allclose(of_held, expected, atol=1e-12, err_msg=str(update))
    spread = np.sqrt((found.error[:, 12:].sum(axis=1) ** 2).sum(axis=0))
    np.testing.assert_allclose(spread[:, 0], 0.1, atol=1e-12)
    # Along z nothing was measured: it may be as wrong as x was found to be.
    late = AUTHORITY[12:].sum()
    np.testing.assert_allclose(spread[:, 1], [1.0 + late, np.hypot(0.3 * late, 0.5), 0], atol=1e-12)


def test_between_goals_with_different_effects_the_measured_one_is_uncertain() -> None:
    effect = np.array([[[1.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0]]])
    found = SHIFTS.measured(HeldShifts(np.array([0.4, 0.6]), np.array([3]), np.array([0]), effect, 0.0))
    assert found.at(np.array([0.5]))[0, 3:].sum(axis=0)[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt((found.error[:, 3:].sum(axis=1) ** 2).sum(axis=0))[0, 0] == pytest.approx(1.0)


def test_jumps_that_fell_leave_what_was_simulated() -> None:
    fallen = HeldShifts(np.array([0.4, 0.6]), np.array([3]), np.array([0]), np.full((2, 1, 3), np.nan), 0.1)
    np.testing.assert_allclose(SHIFTS.measured(fallen).mean, SHIFTS.at(fallen.x_m), atol=1e-12)
    nothing = HeldShifts(np.zeros(0), np.array([3]), np.array([0]), np.zeros((0, 1, 3)), 0.1)
    assert SHIFTS.measured(nothing) is SHIFTS
