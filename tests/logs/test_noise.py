"""Noise read off smooth motions with known white noise on them, at the rates robots log at."""

import numpy as np
import pytest

from leapgap.logs.noise import noise_of


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
