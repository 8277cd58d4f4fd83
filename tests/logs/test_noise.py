"""Noise read off smooth motions with known white noise on them, at the rates robots log at."""

import numpy as np
import pytest

from leapgap.logs.noise import noise_in_rows, noise_of


@pytest.mark.parametrize("rate_hz", [1000, 500, 200, 100])
def test_noise_is_found_beside_a_robots_motion_at_every_rate(rate_hz: int) -> None:
    """A joint that swings by 0.5 rad at 1.5 Hz, known to half a milliradian; 4 s of it."""
    time = np.arange(0, 4, 1 / rate_hz)
    swing = 0.5 * np.sin(2 * np.pi * 1.5 * time)
    logged = swing + 5e-4 * np.random.default_rng(0).standard_normal(len(time))
    (found,) = noise_of(np.diff(logged)[:, None], 1 / rate_hz)
    assert found == pytest.approx(5e-4, rel=0.25)


def test_two_differences_would_take_the_motion_for_noise_at_100_hz() -> None:
    """Why the order grows with the period: the second differences of the swing alone."""
    time = np.arange(0, 4, 0.01)
    steps = np.diff(0.5 * np.sin(2 * np.pi * 1.5 * time))[:, None]
    (found,) = noise_of(steps, 0.01)
    assert found < 5e-5
    assert np.median(np.abs(np.diff(steps, axis=0))) / 0.6745 / np.sqrt(6) > 1e-3


def test_an_impact_is_no_noise() -> None:
    logged = np.random.default_rng(1).standard_normal(2000) * 0.01
    logged[1000:] += 5.0
    (found,) = noise_of(np.diff(logged)[:, None], 0.001)
    assert found == pytest.approx(0.01, rel=0.1)


def test_ticks_are_seen_through_decimals() -> None:
    """A slow sine in ticks of 4096 a turn, written with seven decimals: most differences are 0, and none is exact."""
    tick, time = 2 * np.pi / 4096, np.arange(0, 8, 0.01)
    logged = np.round(np.round(0.035 * np.sin(2.2 * time) / tick) * tick, 7)
    (found,) = noise_of(np.diff(logged)[:, None], 0.01)
    assert 0.95 < found / (tick / np.sqrt(12)) < 2


def test_samples_off_in_time_are_off_by_their_speed() -> None:
    """A swing whose samples are taken up to 2 ms late or early, beside one whose samples are not."""
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.004, 0.006, 1500))
    taken = time + rng.uniform(-0.002, 0.002, len(time))
    true, white = 0.8 * np.sin(4 * time), 1e-4 * rng.standard_normal(len(time))
    logged = np.stack([0.8 * np.sin(4 * taken) + white, true + white], axis=1)
    found = noise_in_rows(time, logged, np.array([1e-4, 1e-4]))
    fast, slow = np.abs(np.cos(4 * time)) > 0.9, np.abs(np.cos(4 * time)) < 0.1
    off = np.abs(logged[:, 0] - true)
    assert np.sqrt(np.mean(off[fast] ** 2)) == pytest.approx(found[fast, 0].mean(), rel=0.3)
    assert found[slow, 0].mean() < 0.2 * found[fast, 0].mean()
    assert found[:, 1].max() < 2e-4
