"""What the exported learned MPC knows of each update beforehand: its cost for every measured state, and its limits."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.condensed_qp import STATES, PreparedQp
from leapgap.jumping.control.mpc import ForcePlanner
from leapgap.jumping.control.qp import SOLVED


@dataclass(frozen=True)
class DualTables:
    """One update's problem: n forces, m of them later than the first step, c limits; x₁ is the state after that."""

    cost_to_go: np.ndarray  # V, curvature of the cost by x₁ where the later forces are at their best, (6, 6)
    slope_to_go: np.ndarray  # v, (6,)
    later: np.ndarray  # U_c, later forces without limits, (m,), N
    later_by_state: np.ndarray  # Fᵀ, their change by x₁, (6, m)
    rows: np.ndarray  # Limits as A x ≤ b: A, (c, n)
    bounds: np.ndarray  # b, (c,), N
    start: np.ndarray  # Rows that are active at the reference, where the search for today's begins, int


def dual_tables(planner: ForcePlanner, time_s: float, ready: PreparedQp) -> DualTables:
    """The tables of one update."""
    # All limits as rows ≤ bounds; F_z ≥ 0 is left out, since the friction cone implies it.
    eye, above = np.eye(len(ready.lower)), np.isfinite(ready.upper)
    below = np.isfinite(ready.lower) & (ready.lower != 0)
    states, later = slice(0, STATES), slice(STATES, None)
    factor = np.linalg.inv(np.linalg.cholesky(ready.quadratic[later, later]))
    inverse = factor.T @ factor
    by_state, constant = -inverse @ ready.quadratic[later, states], -inverse @ ready.linear[later]
    return DualTables(
        cost_to_go=ready.quadratic[states, states] + ready.quadratic[states, later] @ by_state,
        slope_to_go=ready.linear[states] + ready.quadratic[states, later] @ constant,
        later=constant,
        later_by_state=by_state.T,
        rows=np.concatenate([ready.rows, eye[above], -eye[below]]),
        bounds=np.concatenate([ready.row_upper, ready.upper[above], -ready.lower[below]]),
        start=active_at_reference(planner, time_s, ready, above, below),
    )


def active_at_reference(
    planner: ForcePlanner, time_s: float, ready: PreparedQp, above: np.ndarray, below: np.ndarray
) -> np.ndarray:
    """Numbers of the limits that act in the update of the reference itself; none where it has no solution."""
    reference, row = planner.reference, planner.reference.row(time_s)
    problem = planner.problem(time_s, ready, reference.state[row], reference.foot[row])
    solution = None if problem is None else planner.solver.solve(problem)
    if solution is None or solution.status != SOLVED:
        return np.zeros(0, np.int64)
    of_bounds, of_rows = np.split(solution.dual, [len(ready.lower)])
    return np.flatnonzero(np.concatenate([of_rows, of_bounds[above], -of_bounds[below]]) > 0)
