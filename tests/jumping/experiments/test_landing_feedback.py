"""The model of the landing in flight: it recovers a known linear law, and knows what it does not know."""

from dataclasses import fields, replace

import numpy as np
import pytest

from leapgap.jumping.experiments.landing_feedback import (
    Authority,
    FeedbackConfig,
    HeldShifts,
    LandingFeedback,
    ShiftedJumps,
    learn_feedback,
)
from leapgap.jumping.experiments.landing_model import AimConfig, LandingModel, LandingSamples

UPDATES = 16
AUTHORITY = 2 * (1 - np.arange(UPDATES) / UPDATES) / (UPDATES + 1)
"""Share of a shift that each update adds to the landing; 1 in all, as of a shift from the start on."""
SHIFTS = Authority(AUTHORITY[None, :, None, None] * np.eye(3), np.zeros((1, UPDATES, 3, 3)))
GAIN_S = 0.4
"""Landing per forward velocity, m/(m/s): the time of the flight."""


def law(rng: np.random.Generator, jumps: int, short_m: float = 0.0, gain_s: float = GAIN_S) -> ShiftedJumps:
    """Robots that land where they are told, ``short_m`` short, and fly on by their excess velocity for ``gain_s``.

    A shift that comes late adds less. What earlier shifts have not done yet shows in the velocity. Every second jump is
    kicked before one of its updates.
    """
    goal = rng.uniform([0.4, 0.0, -0.1], [0.7, 0.1, 0.1], (jumps, 3))
    shift = np.cumsum(rng.uniform(-1, 1, (jumps, UPDATES, 3)) * [0.01, 0.01, 0.05], axis=1)
    landing = goal + np.einsum("t,ntj->nj", AUTHORITY, shift) - [short_m, 0, 0]
    deviation = 1e-4 * rng.standard_normal((jumps, UPDATES, 10))
    for update in range(UPDATES):
        before = shift[:, update - 1] if update else np.zeros((jumps, 3))
        behind = np.einsum("t,ntj->nj", AUTHORITY[:update], shift[:, :update] - before[:, None])
        deviation[:, update, [3, 4, 5]] += behind / gain_s
    for jump in range(1, jumps, 2):
        kick, at = rng.uniform(-0.2, 0.2), rng.integers(1, UPDATES)
        deviation[jump, at:, 3] += kick
        deviation[jump, :at] = np.nan
        landing[jump, 0] += gain_s * kick
    return ShiftedJumps(goal, rng.uniform(-0.1, 0, jumps), landing, shift, deviation, np.arange(jumps) % 2)


@pytest.fixture(scope="module")
def learned() -> LandingFeedback:
    return learn_feedback(law(np.random.default_rng(0), 160), SHIFTS, FeedbackConfig())


@pytest.mark.parametrize("update", [0, 5, 15])
def test_what_earlier_shifts_have_not_done_yet_is_seen(learned: LandingFeedback, update: int) -> None:
    """Jumps that were never seen: goal, measured deviation and shifts to come give the landing to a few millimetres."""
    fresh = law(np.random.default_rng(9), 40)
    errors = []
    for jump in np.flatnonzero(fresh.undisturbed):
        before = fresh.shift_before(update)[jump]
        later = np.einsum("t,tj->j", AUTHORITY[update:], fresh.shift[jump, update:] - before)
        now = fresh.goal_at(update)[jump], fresh.stance_pitch[jump], fresh.deviation[jump, update]
        errors.append(fresh.landing[jump] - learned.predict(update, *now) - later)
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(np.zeros(3), abs=0.006)


@pytest.mark.parametrize("update", [2, 8, 15])
def test_a_kick_is_seen_in_the_predicted_landing(learned: LandingFeedback, update: int) -> None:
    goal, deviation = np.array([0.55, 0.05, 0.0]), np.zeros(10)
    calm = learned.predict(update, goal, -0.05, deviation)
    np.testing.assert_allclose(calm, goal, atol=0.003)
    deviation[3] = 0.15
    np.testing.assert_allclose(learned.predict(update, goal, -0.05, deviation) - calm, [0.06, 0, 0], atol=0.004)


def test_of_a_similar_robot_few_jumps_are_enough(learned: LandingFeedback) -> None:
    """Six jumps of a robot that lands 2 cm shorter, with and without what is known of the other robot."""
    own = law(np.random.default_rng(1), 6, short_m=0.02)
    goal, deviation = np.array([0.5, 0.05, 0.05]), np.zeros(10)
    deviation[3] = 0.15
    expected = goal + np.array([0.4 * 0.15 - 0.02, 0, 0])
    informed, alone = (learn_feedback(own, SHIFTS, FeedbackConfig(), prior) for prior in (learned, None))
    off, off_alone = (np.abs(m.predict(8, goal, -0.05, deviation) - expected).max() for m in (informed, alone))
    assert off < 0.006
    assert off < 0.5 * off_alone


def test_data_correct_a_wrong_prior() -> None:
    rng = np.random.default_rng(2)
    wrong = learn_feedback(law(rng, 160, gain_s=0.2), SHIFTS, FeedbackConfig())
    right = learn_feedback(law(rng, 80), SHIFTS, FeedbackConfig(change=1.0), wrong)
    deviation = np.zeros(10)
    deviation[3] = 0.15
    goal = np.array([0.55, 0.05, 0.0])
    for model, gain in ((wrong, 0.2), (right, GAIN_S)):
        moved = model.predict(12, goal, 0.0, deviation) - model.predict(12, goal, 0.0, np.zeros(10))
        assert moved[0] == pytest.approx(0.15 * gain, abs=0.006)


def test_undisturbed_jumps_are_expected_where_the_landing_model_says(learned: LandingFeedback) -> None:
    """A robot that always is 0.1 m/s faster than planned, by which another one would fly 4 cm farther."""
    own = law(np.random.default_rng(5), 40)
    calm = own.undisturbed
    own = ShiftedJumps(*(getattr(own, one.name)[calm] for one in fields(own)))
    bent = own.goal + np.stack([0.1 * (own.goal[:, 0] - 0.55) ** 2 - 0.02, 0 * own.goal[:, 0], 0 * own.goal[:, 0]], 1)
    faster = 1e-3 * np.random.default_rng(7).standard_normal(own.deviation.shape) + 0.1 * np.eye(10)[3]
    own = replace(own, landing=bent, shift=0 * own.shift, deviation=faster)
    landing = LandingModel(LandingSamples(own.goal, own.stance_pitch, own.landing), AimConfig())
    model = learn_feedback(own, SHIFTS, FeedbackConfig(), learned, landing)
    assert model.landing is landing
    off = [
        model.predict(8, own.goal[i], own.stance_pitch[i], own.deviation[i, 8])
        - model.expect(own.goal[i], own.stance_pitch[i])
        for i in range(len(own))
    ]
    assert np.abs(off).max(axis=0) == pytest.approx(np.zeros(3), abs=0.004)


def test_what_a_shift_does_is_that_of_the_planned_distance() -> None:
    near, far = np.full((1, UPDATES, 3, 3), 0.1), np.full((1, UPDATES, 3, 3), 0.3)
    shifts = Authority(np.concatenate([near, far]), near, np.array([0.4, 0.6]))
    np.testing.assert_allclose(shifts.at(np.array([0.2, 0.4, 0.45, 0.9]))[:, 0, 0, 0], [0.1, 0.1, 0.15, 0.3])
    model = learn_feedback(law(np.random.default_rng(6), 40), shifts, FeedbackConfig())
    assert model.planned_to(np.array([0.5, 0.0, 0.0])).authority[3, 1, 2] == pytest.approx(0.2)


def test_doubt_grows_with_the_distance_from_what_was_seen(learned: LandingFeedback) -> None:
    goal = np.array([0.55, 0.05, 0.0])
    usual, unseen = np.zeros(10), np.zeros(10)
    usual[3], unseen[1] = 0.1, 0.05  # no jump was ever 5 cm too high
    assert learned.doubt(8, goal, -0.05, usual) < 0.5
    assert learned.doubt(8, goal, -0.05, unseen) > 4 * learned.doubt(8, goal, -0.05, usual)


def test_jumps_survive_a_json_file_with_what_is_not_known_of_them() -> None:
    jumps = law(np.random.default_rng(3), 4)
    again = ShiftedJumps.from_json(jumps.to_json())
    for name in ("goal", "stance_pitch", "landing", "shift", "deviation", "disturbed"):
        np.testing.assert_array_equal(getattr(again, name), getattr(jumps, name))
    assert jumps.undisturbed.tolist() == [True, False, True, False]
    twice = ShiftedJumps.join([jumps, again])
    assert len(twice) == 8


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
