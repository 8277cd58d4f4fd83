"""Velocities through uneven positions, against analytic motions and against noise that is drawn."""

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.logs import derivatives
from leapgap.logs.derivatives import velocity_fit


def uneven_time(rows: int = 800, seed: int = 0) -> np.ndarray:
    """Instants with steps between 0.7 and 3.3 ms."""
    return np.cumsum(np.random.default_rng(seed).uniform(0.7e-3, 3.3e-3, rows))


@pytest.mark.parametrize("degree", [2, 3])
def test_a_polynomial_of_that_degree_is_differentiated_exactly_at_uneven_instants(degree: int) -> None:
    time = uneven_time()
    position = np.stack([2 + 3 * time - 4 * time**2, 5 * time**degree], axis=1)
    velocity = np.stack([3 - 8 * time, 5 * degree * time ** (degree - 1)], axis=1)
    assert velocity_fit(time, position, 0.02, degree).velocity == pytest.approx(velocity, abs=1e-9)


def test_a_swing_is_differentiated_to_the_order_of_its_window() -> None:
    """A parabola in a window of ±h leaves h²/10 of the third derivative, and a cubic h⁴ of the fifth."""
    time = uneven_time()
    rate = 2 * np.pi * 3
    position, velocity = np.sin(rate * time), rate * np.cos(rate * time)
    inside = slice(20, -20)
    quadratic = velocity_fit(time, position, 0.02, 2).velocity - velocity
    cubic = velocity_fit(time, position, 0.02, 3).velocity - velocity
    assert np.abs(quadratic[inside]).max() < 2 * rate**3 * 0.01**2 / 10
    assert np.abs(cubic[inside]).max() < 0.02 * rate**3 * 0.01**2 / 10
    assert quadratic.shape == (800,)


def test_noise_of_the_positions_comes_through_as_the_gain_says() -> None:
    time, rng = uneven_time(400), np.random.default_rng(1)
    noise = 1e-3 * rng.standard_normal((400, 600))
    fit = velocity_fit(time, noise, 0.03)
    assert fit.velocity.std(axis=1) == pytest.approx(1e-3 * fit.noise_gain, rel=0.15)
    assert fit.noise_gain[0] > 2 * fit.noise_gain[200]  # one-sided at the ends


def test_a_window_shorter_than_the_steps_takes_the_nearest_rows() -> None:
    time = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.7])
    assert velocity_fit(time, time**2, 0.01).velocity == pytest.approx(2 * time)


def test_a_long_log_is_fitted_in_chunks_that_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    time = uneven_time()
    whole = velocity_fit(time, np.sin(9 * time), 0.02)
    monkeypatch.setattr(derivatives, "CHUNK_VALUES", 1000)
    parts = velocity_fit(time, np.sin(9 * time), 0.02)
    assert parts.velocity == pytest.approx(whole.velocity, abs=1e-12)
    assert parts.noise_gain == pytest.approx(whole.noise_gain, rel=1e-12)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(InputError, match="found 3 rows; expected 4 or more"):
        velocity_fit(np.arange(3.0), np.arange(3.0), 0.1)
