"""The MPC's condensed QP by its dual, with everything that needs no measurement computed before the jump.

With x₁ = free + E u₀ (``condensed_qp``) the cost is a quadratic function of (x₁, U) with constant P and p, under rows
A₀ u₀ + A U ≤ b. Minimised over U it leaves a quadratic cost-to-go of x₁, and U becomes affine in x₁:

    V = P_xx − P_xU P_UU⁻¹ P_Ux        v = p_x − P_xU P_UU⁻¹ p_U        U = U_c + F x₁ − P_UU⁻¹ Aᵀ λ

for multipliers λ of the rows. Only u₀ is left to be solved for online, with the Hessian S = Eᵀ V E + 2 w I = L Lᵀ of four
variables. The matrix of the dual problem is a constant one and a correction of rank four, exact for every E:

    A_all H⁻¹ A_allᵀ = A P_UU⁻¹ Aᵀ + Y S⁻¹ Yᵀ,        Y = A₀ + A F E

The dual problem is solved by the active-set method of Goldfarb and Idnani (1983), from a set that was prepared too: the
rows that are active at the reference. The limits of the forces are never linearly dependent where they meet, so a step
along the multipliers always exists.
"""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.compiler import compiled
from leapgap.jumping.control.condensed_qp import STATES, PreparedQp

SOLVED, NOT_FINITE, INACCURATE, FAILED = 0, 1, 2, 3
"""What ``solve_update`` returns."""
VIOLATION_N = 1e-7
"""Violation of a limit that counts as none, N."""
INDEPENDENT = 1e-12
"""Share of a row that must not depend on the active ones."""


@dataclass(frozen=True)
class DualTables:
    """One update's problem for every measured state; m₀ forces in the first step, m later ones, c rows."""

    cost_to_go: np.ndarray
    """V, (6, 6)."""
    slope_to_go: np.ndarray
    """v, (6,)."""
    later: np.ndarray
    """U_c, (m,), N."""
    later_by_state: np.ndarray
    """F, (m, 6)."""
    later_by_row: np.ndarray
    """P_UU⁻¹ Aᵀ by row, (c, m)."""
    gram: np.ndarray
    """A P_UU⁻¹ Aᵀ, (c, c)."""
    rows_by_state: np.ndarray
    """A F, (c, 6)."""
    excess: np.ndarray
    """A U_c − b, (c,), N."""
    first_rows: np.ndarray
    """A₀, (c, m₀)."""
    later_rows: np.ndarray
    """A, (c, m)."""
    bounds: np.ndarray
    """b, (c,), N."""
    start: np.ndarray
    """Rows that are active at first, int."""
    quadratic: np.ndarray
    linear: np.ndarray
    """P and p of (x₁, U)."""
    first: np.ndarray
    """Which of the four forces are variables in the first step, int, (m₀,)."""
    push_s: np.ndarray
    """Time for which each of them pushes in it, s, (m₀,)."""
    first_force: np.ndarray
    """Their reference, N, (m₀,)."""
    numbers: np.ndarray
    """Length of the first step, s; curvature; weight of a force; tolerances of fault, N and relative, (5,)."""

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """All of it, in the order in which ``solve_update`` takes it."""
        return tuple(getattr(self, name) for name in self.__dataclass_fields__)


def limits_as_rows(ready: PreparedQp) -> tuple[np.ndarray, np.ndarray]:
    """All limits as rows ≤ bounds, (c, n) and (c,); F_z ≥ 0 is left out, since the friction cone implies it."""
    eye = np.eye(len(ready.lower))
    above, below = np.isfinite(ready.upper), ready.lower > 0
    rows = np.concatenate([ready.rows, eye[above], -eye[below]])
    return rows, np.concatenate([ready.row_upper, ready.upper[above], -ready.lower[below]])


def dual_tables(ready: PreparedQp, tolerance_n: float, relative_tolerance: float) -> DualTables:
    """The tables of one update, with no row active at first."""
    rows, bounds = limits_as_rows(ready)
    m0 = len(ready.first)
    first_rows, later_rows = rows[:, :m0], rows[:, m0:]
    states, later = slice(0, STATES), slice(STATES, None)
    factor = np.linalg.inv(np.linalg.cholesky(ready.quadratic[later, later]))
    inverse = factor.T @ factor
    by_state, constant = -inverse @ ready.quadratic[later, states], -inverse @ ready.linear[later]
    by_row = later_rows @ inverse
    numbers = [ready.step_s, ready.curvature, ready.force_weight, tolerance_n, relative_tolerance]
    tables = DualTables(
        cost_to_go=ready.quadratic[states, states] + ready.quadratic[states, later] @ by_state,
        slope_to_go=ready.linear[states] + ready.quadratic[states, later] @ constant,
        later=constant,
        later_by_state=by_state,
        later_by_row=by_row,
        gram=by_row @ later_rows.T,
        rows_by_state=later_rows @ by_state,
        excess=later_rows @ constant - bounds,
        first_rows=first_rows,
        later_rows=later_rows,
        bounds=bounds,
        start=np.zeros(0, np.int64),
        quadratic=ready.quadratic,
        linear=ready.linear,
        first=ready.first,
        push_s=ready.first_push_s,
        first_force=ready.first_force,
        numbers=np.array(numbers),
    )
    return DualTables(*(np.ascontiguousarray(part) for part in tables.arguments))


@compiled
def extend_factor(factor, columns, active, begin, end):  # type: ignore[no-untyped-def]
    """Rows begin…end of the Cholesky factor of the active rows' matrix, columns[i, active[j]]; false if singular."""
    for i in range(begin, end):
        for j in range(i + 1):
            total = columns[i, active[j]]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if j < i:
                factor[i, j] = total / factor[j, j]
        if not total > INDEPENDENT * columns[i, active[i]]:
            return False
        factor[i, i] = np.sqrt(total)
    return True


@compiled
def solve_factored(factor, right, size):  # type: ignore[no-untyped-def]
    """y with factor factorᵀ y = right, and |factor⁻¹ right|²."""
    y, squared = right.copy(), 0.0
    for i in range(size):
        for k in range(i):
            y[i] -= factor[i, k] * y[k]
        y[i] /= factor[i, i]
        squared += y[i] ** 2
    for i in range(size - 1, -1, -1):
        y[i] /= factor[i, i]
        for k in range(i):
            y[k] -= factor[i, k] * y[i]
    return y, squared


@compiled
def remove_row(active, multipliers, columns, factor, size, leaves):  # type: ignore[no-untyped-def]
    """Take one of ``size`` active rows out, in place."""
    for i in range(leaves, size - 1):
        active[i], multipliers[i] = active[i + 1], multipliers[i + 1]
        columns[i] = columns[i + 1]
    extend_factor(factor, columns, active, leaves, size - 1)


@compiled
def solve_dual(gram, correction, excess, start, largest, iterations):  # type: ignore[no-untyped-def]
    """Minimise ½ λᵀ G λ − excessᵀ λ over λ ≥ 0, where G = gram + correction correctionᵀ.

    Returns the active rows and their multipliers, their number, and whether it is the minimum; at most ``largest`` rows
    are active.
    """
    active, multipliers = np.zeros(largest + 1, np.int64), np.zeros(largest + 1)
    columns, factor = np.empty((largest + 1, len(excess))), np.empty((largest + 1, largest + 1))
    size = len(start)
    for i in range(size):
        active[i] = start[i]
        columns[i] = gram[start[i]] + correction @ correction[start[i]]
    sound = extend_factor(factor, columns, active, 0, size)
    while sound and size > 0:  # the prepared rows whose multipliers are negative today are not active
        multipliers[:size], _ = solve_factored(factor, excess[active[:size]], size)
        least = int(np.argmin(multipliers[:size]))
        if multipliers[least] >= 0.0:
            break
        remove_row(active, multipliers, columns, factor, size, least)
        size -= 1
    for _ in range(iterations if sound else 0):
        left = excess.copy()
        for i in range(size):
            left -= multipliers[i] * columns[i]
        row = int(np.argmax(left))
        if not left[row] > VIOLATION_N:
            return active, multipliers, size, left[row] <= VIOLATION_N
        column, added, violation = gram[row] + correction @ correction[row], 0.0, left[row]
        while True:
            by_active, squared = solve_factored(factor, column[active[:size]], size)
            along = column[row] - squared
            independent = size < largest and along > INDEPENDENT * column[row]
            step, leaves = violation / along if independent else np.inf, -1
            for i in range(size):
                if by_active[i] > 0.0 and multipliers[i] < step * by_active[i]:
                    step, leaves = multipliers[i] / by_active[i], i
            if not step < np.inf:
                return active, multipliers, size, False
            multipliers[:size] -= step * by_active
            added, violation = added + step, violation - step * along
            if leaves < 0:
                break
            remove_row(active, multipliers, columns, factor, size, leaves)
            size -= 1
        active[size], multipliers[size], columns[size] = row, added, column
        size += 1
        if not extend_factor(factor, columns, active, size - 1, size):
            break
    return active, multipliers, size, False


@compiled
def solve_update(  # type: ignore[no-untyped-def]
    state,
    foot,
    model,
    iterations,
    cost_to_go,
    slope_to_go,
    later,
    later_by_state,
    later_by_row,
    gram,
    rows_by_state,
    excess,
    first_rows,
    later_rows,
    bounds,
    start,
    quadratic,
    linear,
    first,
    push_s,
    first_force,
    numbers,
):
    """Forces of one update from a state (6,), feet (4,) and the model there (15,), with the fields of ``DualTables``.

    Returns the status, the forces (n,), the active rows, and how many they are.
    """
    step_s, curvature, weight, tolerance_n, relative_tolerance = numbers
    m0, m = len(first), len(later)
    free, enters = np.empty(6), np.empty((6, m0))
    for i in range(3):
        gained = step_s * model[i]
        free[i] = state[i] + step_s * (state[3 + i] + curvature * gained)
        free[3 + i] = state[3 + i] + gained
        for j in range(m0):
            enters[3 + i, j] = model[3 + 4 * i + first[j]] * push_s[j]
            enters[i, j] = curvature * step_s * enters[3 + i, j]
    x = np.zeros(m0 + m)
    active, size = np.zeros(1, np.int64), 0
    if not np.isfinite(free.sum() + enters.sum() + foot.sum()):
        return NOT_FINITE, x, active, size
    # The four forces of the first step, without limits.
    hessian = enters.T @ (cost_to_go @ enters)
    for j in range(m0):
        hessian[j, j] += 2.0 * weight
    gradient = enters.T @ (cost_to_go @ free + slope_to_go) - 2.0 * weight * first_force
    factor = np.empty((m0, m0))
    if not extend_factor(factor, hessian, np.arange(m0), 0, m0):
        return FAILED, x, active, size
    u, _ = solve_factored(factor, -gradient, m0)
    # What they and the later forces exceed the limits by, and how multipliers of the limits change that.
    by_first = first_rows + rows_by_state @ enters
    inverse_root = np.empty((m0, m0))
    for j in range(m0):
        inverse_root[j] = 0.0
        for i in range(j, m0):
            inverse_root[j, i] = 1.0 if i == j else 0.0
            for k in range(j, i):
                inverse_root[j, i] -= factor[i, k] * inverse_root[j, k]
            inverse_root[j, i] /= factor[i, i]
    correction = by_first @ inverse_root
    unlimited = excess + by_first @ u + rows_by_state @ free
    active, multipliers, size, found = solve_dual(gram, correction, unlimited, start, m0 + m, iterations)
    if not found:
        return FAILED, x, active, size
    # The forces, and whether they meet the conditions of a minimum.
    by_row = np.zeros(len(excess))
    for i in range(size):
        by_row[active[i]] = multipliers[i]
    change, _ = solve_factored(factor, by_row @ by_first, m0)
    x[:m0] = u - change
    z = np.empty(6 + m)
    z[:6] = free + enters @ x[:m0]
    x[m0:] = later + later_by_state @ z[:6]
    for i in range(size):
        x[m0:] -= multipliers[i] * later_by_row[active[i]]
    z[6:] = x[m0:]
    slope = quadratic @ z + linear
    at_rest = free @ quadratic[:6] + linear
    left = np.abs(slope[:6] @ enters + 2.0 * weight * (x[:m0] - first_force) + by_row @ first_rows).max()
    largest = np.abs(at_rest[:6] @ enters - 2.0 * weight * first_force).max()
    if m > 0:
        left = max(left, np.abs(slope[6:] + by_row @ later_rows).max())
        largest = max(largest, np.abs(at_rest[6:]).max())
    beyond = (first_rows @ x[:m0] + later_rows @ x[m0:] - bounds).max()
    sound = beyond <= tolerance_n and left <= relative_tolerance * (1.0 + largest)
    return SOLVED if sound else INACCURATE, x, active, size
