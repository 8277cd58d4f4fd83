"""What counts as a sudden change: kicks and pushes do; a crouch far from the planned one, noise and gaps do not."""

import numpy as np
import pytest

from leapgap.jumping.control.goal_shift_mpc import CalmMotion, ChangeRule, ChangeWatch

UPDATES, DECAY, NOISE = 24, 0.8, 0.01
CALM = CalmMotion(
    np.tile(np.vstack([np.zeros(10), DECAY * np.eye(10)]), (UPDATES, 1, 1)),
    np.tile(np.eye(10) / NOISE**2, (UPDATES, 1, 1)),
)
KICK_AT = 12


def deviations(first: float, kick: float, rng: np.random.Generator, lasts: int = 1) -> np.ndarray:
    """Deviations (updates, 10) that fade with noise; the first one is large, or a kick adds to the fourth number."""
    found = np.zeros((UPDATES, 10))
    found[0] = first
    for update in range(1, UPDATES):
        found[update] = DECAY * found[update - 1] + NOISE * rng.standard_normal(10)
        found[update, 3] += kick * (KICK_AT <= update < KICK_AT + lasts)
    return found


def watched(found: np.ndarray) -> tuple[ChangeWatch, list[np.ndarray | None]]:
    watch = ChangeWatch(CALM, ChangeRule())
    return watch, [watch.since(update, deviation) for update, deviation in enumerate(found)]


@pytest.mark.parametrize("first", [0.0, 1.0])
def test_a_kick_is_told_from_what_was_there_before(first: float) -> None:
    rng = np.random.default_rng(0)
    watch, since = watched(deviations(first, 0.3, rng))
    assert [one is not None for one in since] == [update >= KICK_AT for update in range(UPDATES)]
    assert watch.age == UPDATES - KICK_AT
    for update in range(KICK_AT, UPDATES):
        own = since[update]
        assert own is not None
        expected = np.zeros(10)
        expected[3] = 0.3 * DECAY ** (update - KICK_AT)
        assert np.abs(own[:10] - expected).max() < 6 * NOISE


def test_a_push_adds_up() -> None:
    _, since = watched(deviations(0.0, 0.2, np.random.default_rng(1), lasts=3))
    own = since[KICK_AT + 2]
    assert own is not None
    assert own[3] == pytest.approx(0.2 * (1 + DECAY + DECAY**2), abs=4 * NOISE)


def test_a_push_that_begins_just_before_an_update_shows_at_the_next_one() -> None:
    """Its first part is too small to count, and must not hide the rest."""
    found = deviations(0.0, 0.2, np.random.default_rng(5), lasts=4)
    found[KICK_AT - 1, 3] += 0.1
    found[KICK_AT:, 3] += 0.1 * DECAY ** np.arange(1, UPDATES - KICK_AT + 1)
    _, since = watched(found)
    assert since[KICK_AT - 1] is None and since[KICK_AT] is not None


def test_noise_is_no_change() -> None:
    rng = np.random.default_rng(2)
    assert not any(watched(deviations(0.0, 0.0, rng))[0].age for _ in range(300))


def test_a_wrong_start_that_goes_on_in_its_own_way_is_no_change() -> None:
    """It fades slower than the law says, so that each update surprises, the first ones most."""
    slow = 0.5 * 0.95 ** np.arange(UPDATES)[:, None] * np.ones(10)
    watch, since = watched(slow)
    assert CALM.surprise(8, slow[8] - CALM.carried(8, slow[7])) > ChangeRule().least_surprise
    assert not watch.age and not any(one is not None for one in since)


def test_updates_that_are_missing_or_not_finite_are_gone_over() -> None:
    found = deviations(0.0, 0.3, np.random.default_rng(3))
    found[KICK_AT + 2] = np.nan
    watch = ChangeWatch(CALM, ChangeRule())
    since = {update: watch.since(update, found[update]) for update in range(UPDATES) if update != KICK_AT + 5}
    assert since[KICK_AT + 2] is None and watch.age == UPDATES - KICK_AT
    for update in (KICK_AT + 3, KICK_AT + 6):
        own = since[update]
        assert own is not None
        assert own[3] == pytest.approx(0.3 * DECAY ** (update - KICK_AT), abs=6 * NOISE)


def test_a_kick_in_a_gap_is_not_taken_for_a_large_noise() -> None:
    """The update of the kick is missing: what comes after it fades as the law says, and nothing is sudden."""
    found = deviations(0.0, 0.3, np.random.default_rng(4))
    watch = ChangeWatch(CALM, ChangeRule())
    assert not any(
        watch.since(update, found[update]) is not None for update in range(UPDATES) if update not in (KICK_AT,)
    )
