import numpy as np
import pytest
from scipy.optimize import lsq_linear

from leapgap.diagnosis.robust_least_squares import Products, losses, solve_within

PIECES, VALUES = 12, 50


@pytest.fixture
def columns() -> np.ndarray:
    """Two columns, errors that are 3 × the first and noise: (pieces, values, 3)."""
    rng = np.random.default_rng(0)
    found = rng.standard_normal((PIECES, VALUES, 3))
    found[:, :, 0] += -3 * found[:, :, 1]
    return found


def test_products_give_the_chi_square_of_the_errors_themselves(columns: np.ndarray) -> None:
    weights = np.array([1.0, 2.5, -0.5])
    expected = ((columns @ weights) ** 2).sum(axis=1)
    assert Products.of(columns).chi2(weights) == pytest.approx(expected)


def test_loss_is_half_of_chi_square_near_noise_and_logarithmic_beyond() -> None:
    m, step = 100, 1e-3
    slope = (losses(np.array([m + step]), m) - losses(np.array([m]), m)) / step
    assert slope == pytest.approx(0.5, rel=1e-3)
    assert losses(np.array([m]), m) == pytest.approx(0)
    far = losses(np.array([1e6, 1e7]), m)
    assert far[1] - far[0] == pytest.approx(m * np.log(10), rel=0.01)


def test_weights_are_recovered_and_one_broken_piece_does_not_move_them(columns: np.ndarray) -> None:
    found = Products.of(columns).fit(np.zeros(2))
    assert found == pytest.approx([1.0, 3.0, 0.0], abs=0.15)
    broken = columns.copy()
    broken[0, :, 0] = 200 * columns[0, :, 1] + 50
    robust = Products.of(broken).fit(np.zeros(2))
    assert robust == pytest.approx(found, abs=0.15)


def test_a_prior_holds_what_the_data_do_not_need(columns: np.ndarray) -> None:
    tight = Products.of(columns).fit(np.array([1e8, 0.0]))
    assert abs(tight[1]) < 1e-3


@pytest.mark.parametrize("seed", range(8))
def test_numbers_held_at_their_ends_leave_the_others_at_the_least_squares_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, wanted = rng.standard_normal((30, 4)), 5 * rng.standard_normal(4)
    errors = matrix @ wanted + rng.standard_normal(30)
    most = np.array([np.inf, 1.0, 3.0, np.inf])
    expected = lsq_linear(matrix, errors, (-most, most), tol=1e-12).x
    assert solve_within(matrix.T @ matrix, matrix.T @ errors, most) == pytest.approx(expected, abs=1e-5)


def test_a_tolerance_explains_no_more_than_its_furthest_and_a_free_number_all(columns: np.ndarray) -> None:
    products = Products.of(columns)
    within = products.fit(np.array([16.0, 0.0]), furthest=6.0)
    assert within[1] == pytest.approx(6.0 / 4.0) and products.fit(np.array([16.0, 0.0]))[1] > 2.5
    assert losses(products.chi2(within), products.values).sum() > 10 * PIECES
    assert products.fit(np.zeros(2), furthest=6.0)[1] == pytest.approx(3.0, abs=0.15)
