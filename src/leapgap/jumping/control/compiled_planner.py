"""The force planner with compiled updates: the same plans, from tables of every update (``dual_qp``)."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control import qp
from leapgap.jumping.control.compiler import compiled, require_compiler
from leapgap.jumping.control.condensed_qp import STATES, PreparedQp
from leapgap.jumping.control.mpc import ForcePlanner, MpcConfig, microseconds
from leapgap.jumping.control.qp import GuardedSolution
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.models.rigid_body import DeviationModel, PredictionModel

SOLVED, NOT_FINITE, INACCURATE, FAILED = 0, 1, 2, 3  # What ``solve_update`` returns
VIOLATION_N = 1e-7  # Violation of a limit that counts as none, N
INDEPENDENT = 1e-12  # Share of a row that must not depend on the active ones


@dataclass(frozen=True)
class DualTables:
    """One update's problem for every measured state; m₀ forces in the first step, m later ones, c rows."""

    cost_to_go: np.ndarray  # V, (6, 6)
    slope_to_go: np.ndarray  # v, (6,)
    later: np.ndarray  # U_c, (m,), N
    later_by_state: np.ndarray  # Fᵀ, (6, m)
    later_by_row: np.ndarray  # P_UU⁻¹ Aᵀ by row, (c, m)
    gram: np.ndarray  # A P_UU⁻¹ Aᵀ, (c, c)
    rows_by_state: np.ndarray  # (A F)ᵀ, (6, c)
    excess: np.ndarray  # A U_c − b, (c,), N
    rows: np.ndarray  # A₀ and A side by side, (c, n)
    by_force: np.ndarray  # The same, transposed, (n, c)
    bounds: np.ndarray  # b, (c,), N
    start: np.ndarray  # Rows that are active at first, int
    quadratic: np.ndarray
    linear: np.ndarray  # P and p of (x₁, U)
    first: np.ndarray  # Which of the four forces are variables in the first step, int, (m₀,)
    push_s: np.ndarray  # Time for which each of them pushes in it, s, (m₀,)
    first_force: np.ndarray  # Their reference, N, (m₀,)
    numbers: np.ndarray  # Length of the first step, s; curvature; weight of a force; tolerances of fault: N, relative

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        """All of it, in the order in which ``solve_update`` takes it."""
        return tuple(getattr(self, name) for name in self.__dataclass_fields__)


def dual_tables(ready: PreparedQp, tolerance_n: float, relative_tolerance: float) -> DualTables:
    """The tables of one update, with no row active at first."""
    # All limits as rows ≤ bounds; F_z ≥ 0 is left out, since the friction cone implies it.
    eye, above = np.eye(len(ready.lower)), np.isfinite(ready.upper)
    below = np.isfinite(ready.lower) & (ready.lower != 0)
    rows = np.concatenate([ready.rows, eye[above], -eye[below]])
    bounds = np.concatenate([ready.row_upper, ready.upper[above], -ready.lower[below]])
    later_rows = rows[:, len(ready.first) :]
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
        later_by_state=by_state.T,
        later_by_row=by_row,
        gram=by_row @ later_rows.T,
        rows_by_state=(later_rows @ by_state).T,
        excess=later_rows @ constant - bounds,
        rows=rows,
        by_force=rows.T,
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
def add_rows(total, weights, rows):  # type: ignore[no-untyped-def]
    """total += weights · rows, in place."""
    for i in range(len(weights)):
        for j in range(len(total)):
            total[j] += weights[i] * rows[i, j]


@compiled
def dual_column(gram, correction, row):  # type: ignore[no-untyped-def]
    """Column of the matrix gram + correctionᵀ correction, (c,)."""
    column = gram[row].copy()
    add_rows(column, correction[:, row], correction)
    return column


@compiled
def solve_dual(gram, correction, excess, start, largest, iterations):  # type: ignore[no-untyped-def]
    """Minimise ½ λᵀ G λ − excessᵀ λ over λ ≥ 0, where G = gram + correctionᵀ correction.

    Returns the active rows and their multipliers, their number, and whether it is the minimum; at most ``largest`` rows
    are active.
    """
    active, multipliers = np.zeros(largest + 1, np.int64), np.zeros(largest + 1)
    columns, factor = np.empty((largest + 1, len(excess))), np.empty((largest + 1, largest + 1))
    size = len(start)
    for i in range(size):
        active[i] = start[i]
        columns[i] = dual_column(gram, correction, start[i])
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
        add_rows(left, -multipliers[:size], columns)
        row = int(np.argmax(left))
        if not left[row] > VIOLATION_N:
            return active, multipliers, size, left[row] <= VIOLATION_N
        column, added, violation = dual_column(gram, correction, row), 0.0, left[row]
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
def first_state(state, model, first, push_s, numbers):  # type: ignore[no-untyped-def]
    """x₁ without forces, (6,), and Eᵀ, its change by each of the first forces, (m₀, 6)."""
    step_s, curvature = numbers[0], numbers[1]
    free, enters = np.empty(6), np.empty((len(first), 6))
    for i in range(3):
        gained = step_s * model[i]
        free[i] = state[i] + step_s * (state[3 + i] + curvature * gained)
        free[3 + i] = state[3 + i] + gained
        for j in range(len(first)):
            enters[j, 3 + i] = model[3 + 4 * i + first[j]] * push_s[j]
            enters[j, i] = curvature * step_s * enters[j, 3 + i]
    return free, enters


@compiled
def unlimited_forces(free, enters, cost_to_go, slope_to_go, weight, first_force):  # type: ignore[no-untyped-def]
    """The first forces without limits, (m₀,), and L⁻¹ of their Hessian S, (m₀, m₀)."""
    m0 = len(first_force)
    slope, curved = slope_to_go.copy(), np.zeros((m0, 6))
    add_rows(slope, free, cost_to_go)
    hessian, factor, inverse, u = np.zeros((m0, m0)), np.zeros((m0, m0)), np.zeros((m0, m0)), np.zeros(m0)
    for j in range(m0):
        add_rows(curved[j], enters[j], cost_to_go)
        for k in range(6):
            u[j] -= enters[j, k] * slope[k]
            for i in range(m0):
                hessian[j, i] += curved[j, k] * enters[i, k]
        u[j] += 2.0 * weight * first_force[j]
        hessian[j, j] += 2.0 * weight
        inverse[j, j] = 1.0
    sound = extend_factor(factor, hessian, np.arange(m0), 0, m0)
    u, _ = solve_factored(factor, u, m0)
    for i in range(m0):
        for j in range(i + 1):
            for k in range(j, i):
                inverse[i, j] -= factor[i, k] * inverse[k, j]
            inverse[i, j] /= factor[i, i]
    return u, inverse, sound


@compiled
def is_minimum(  # type: ignore[no-untyped-def]
    x, free, enters, active, multipliers, rows, by_force, bounds, quadratic, linear, first_force, numbers
):
    """Whether forces and multipliers meet the conditions of a minimum of the problem itself, within the tolerances."""
    m0, weight, tolerance_n, relative_tolerance = len(enters), numbers[2], numbers[3], numbers[4]
    at_rest, beyond = linear.copy(), -bounds
    add_rows(at_rest, free, quadratic)
    add_rows(beyond, x, by_force)
    if len(beyond) > 0 and not beyond.max() <= tolerance_n:
        return False
    slope, moved = at_rest.copy(), np.zeros(6)
    add_rows(moved, x[:m0], enters)
    add_rows(slope, moved, quadratic)
    add_rows(slope, x[m0:], quadratic[6:])
    left, largest = np.zeros(len(x)), 0.0
    for i in range(len(active)):
        for j in range(len(x)):
            left[j] += multipliers[i] * rows[active[i], j]
    for j in range(len(x)):
        if j < m0:
            given = -2.0 * weight * first_force[j]
            left[j] += given + 2.0 * weight * x[j]
            for k in range(6):
                left[j] += enters[j, k] * slope[k]
                given += enters[j, k] * at_rest[k]
        else:
            left[j] += slope[6 + j - m0]
            given = at_rest[6 + j - m0]
        largest = max(largest, abs(given))
    return np.abs(left).max() <= relative_tolerance * (1.0 + largest)


@compiled
def solve_update(state, foot, model, iterations, tables):  # type: ignore[no-untyped-def]
    """Forces of one update from a state (6,), feet (4,) and the model there (15,), with the fields of ``DualTables``.

    Returns the status, the forces (n,), the active rows, and how many they are.
    """
    cost_to_go, slope_to_go, later, later_by_state, later_by_row, gram = tables[:6]
    rows_by_state, excess, rows, by_force, bounds, start = tables[6:12]
    quadratic, linear, first, push_s, first_force, numbers = tables[12:]
    m0, x = len(first), np.zeros(len(first) + len(later))
    free, enters = first_state(state, model, first, push_s, numbers)
    if not np.isfinite(free.sum() + enters.sum() + foot.sum()):
        return NOT_FINITE, x, start, 0
    u, inverse, sound = unlimited_forces(free, enters, cost_to_go, slope_to_go, numbers[2], first_force)
    if not sound:
        return FAILED, x, start, 0
    by_first = by_force[:m0].copy()  # Yᵀ
    unlimited, correction = excess.copy(), np.zeros(by_first.shape)
    add_rows(unlimited, free, rows_by_state)
    for j in range(m0):
        add_rows(by_first[j], enters[j], rows_by_state)
    add_rows(unlimited, u, by_first)
    for j in range(m0):
        add_rows(correction[j], inverse[j], by_first)
    active, multipliers, size, found = solve_dual(gram, correction, unlimited, start, len(x), iterations)
    if not found:
        return FAILED, x, active, 0
    x[:m0], x[m0:] = u, later
    for i in range(size):
        for j in range(m0):  # S⁻¹ Yᵀ λ = L⁻ᵀ correction λ
            for k in range(j + 1):
                x[k] -= inverse[j, k] * correction[j, active[i]] * multipliers[i]
        x[m0:] -= multipliers[i] * later_by_row[active[i]]
    first_ends = free.copy()
    add_rows(first_ends, x[:m0], enters)
    add_rows(x[m0:], first_ends, later_by_state)
    sound = is_minimum(
        x, free, enters, active[:size], multipliers, rows, by_force, bounds, quadratic, linear, first_force, numbers
    )
    return SOLVED if sound else INACCURATE, x, active, size


FAULTS = {NOT_FINITE: qp.NOT_FINITE, INACCURATE: "inaccurate", FAILED: qp.FAILED}


class CompiledPlanner(ForcePlanner):
    """Plans as ``ForcePlanner`` with an exact solver does, to rounding; everything is compiled when it is made."""

    compiled = True

    def __init__(self, reference: Reference, model: PredictionModel | DeviationModel, config: MpcConfig) -> None:
        require_compiler("mpc.compiled")
        super().__init__(reference, model, config)
        self._tables = {key: update_tables(self, key / 1e6, ready).arguments for key, ready in self.prepared.items()}

    def _solve(self, time_s: float, prepared: PreparedQp, state: np.ndarray, foot: np.ndarray) -> GuardedSolution:
        """See ``ForcePlanner``."""
        tables = self._tables.get(microseconds(time_s)) or update_tables(self, time_s, prepared).arguments
        state, foot = np.array(self.formulation.start(time_s, state), float), np.array(foot, float)  # as compiled for
        model = self.first_step(state, foot, time_s)
        status, x, _, _ = solve_update(state, foot, model, self.config.qp.max_iterations, tables)
        return GuardedSolution(x if status == SOLVED else None, FAULTS.get(status, ""))


def update_tables(planner: ForcePlanner, time_s: float, prepared: PreparedQp) -> DualTables:
    """What ``solve_update`` needs for one update; at first those rows are active that are so at the reference."""
    demands, reference = planner.config.demands, planner.reference
    row = reference.row(time_s)
    tables = dual_tables(prepared, demands.primal_tolerance_n, demands.relative_dual_tolerance)
    state, foot = planner.formulation.start(time_s, reference.state[row]).copy(), reference.foot[row].copy()
    model = planner.first_step(state, foot, time_s)
    status, _, active, size = solve_update(state, foot, model, planner.config.qp.max_iterations, tables.arguments)
    return replace(tables, start=active[:size].copy()) if status == SOLVED else tables
