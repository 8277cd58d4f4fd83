"""The model of the landing in flight: it recovers a known linear law, and knows what it does not know."""

import numpy as np
import pytest

from leapgap.jumping.experiments.landing_feedback import (
    FeedbackConfig,
    LandingFeedback,
    ShiftedJumps,
    hats,
    learn_feedback,
)

UPDATES = 16
TIMES_S = 0.05 * np.arange(UPDATES)
AUTHORITY = 2 * (1 - np.arange(UPDATES) / UPDATES) / (UPDATES + 1)
"""Share of a shift that each update adds to the landing; 1 in all, as of a shift from the start on."""
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
    return learn_feedback(law(np.random.default_rng(0), 160), TIMES_S, FeedbackConfig())


def test_what_a_shift_does_from_each_update_on(learned: LandingFeedback) -> None:
    for update in range(0, UPDATES, 3):
        expected = np.eye(3) * AUTHORITY[update:].sum()
        np.testing.assert_allclose(learned.authority[update:].sum(axis=0), expected, atol=0.05)


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
    informed, alone = (learn_feedback(own, TIMES_S, FeedbackConfig(), prior) for prior in (learned, None))
    off, off_alone = (np.abs(m.predict(8, goal, -0.05, deviation) - expected).max() for m in (informed, alone))
    assert off < 0.006
    assert off < 0.5 * off_alone


def test_data_correct_a_wrong_prior() -> None:
    rng = np.random.default_rng(2)
    wrong = learn_feedback(law(rng, 160, gain_s=0.2), TIMES_S, FeedbackConfig())
    right = learn_feedback(law(rng, 80), TIMES_S, FeedbackConfig(), wrong)
    deviation = np.zeros(10)
    deviation[3] = 0.15
    goal = np.array([0.55, 0.05, 0.0])
    for model, gain in ((wrong, 0.2), (right, GAIN_S)):
        moved = model.predict(12, goal, 0.0, deviation) - model.predict(12, goal, 0.0, np.zeros(10))
        assert moved[0] == pytest.approx(0.15 * gain, abs=0.006)


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


def test_hats_interpolate() -> None:
    weights = hats(np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.25, 0.9]))
    np.testing.assert_allclose(weights, [[1, 0, 0], [0.5, 0.5, 0], [0, 0.2, 0.8]])
