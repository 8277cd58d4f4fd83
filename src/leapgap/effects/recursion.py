"""First-order recursions along the rows of commands."""

import numpy as np

NOTHING = 1e-17
"""Weight from which on earlier rows do not count."""


def first_order(values: np.ndarray, kept: float, before: np.ndarray) -> np.ndarray:
    """Recursion y(n) = kept y(n − 1) + (1 − kept) x(n) along the rows of x, ``values``, from y(−1) = ``before``.

    By doubling (Hillis and Steele, Comm. ACM 29, 1986): each pass adds what stands twice as many rows before.
    """
    found, step, weight = (1 - kept) * values, 1, kept
    found[:1] += kept * before
    while step < len(found) and weight > NOTHING:
        found[step:] += weight * found[:-step].copy()
        step, weight = 2 * step, weight**2
    return found
