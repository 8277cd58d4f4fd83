"""Quadratic programs, and their solutions by DAQP, which compute their own residuals.

qp = Qp(hessian, gradient, lower, upper, rows, row_upper)
solution = solve_qp(qp, QpConfig())
solution.x, solution.primal_residual, solution.dual_residual
"""

import time
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import daqp
import numpy as np

SOLVED, INFEASIBLE, FAILED = "solved", "infeasible", "failed"


@dataclass(frozen=True)
class Qp:
    """min ½ xᵀ H x + fᵀ x with lower ≤ x ≤ upper and A x ≤ row_upper; H positive definite."""

    hessian: np.ndarray  # H, (n, n)
    gradient: np.ndarray  # f, (n,)
    lower: np.ndarray
    upper: np.ndarray  # (n,) each; infinite where there is none
    rows: np.ndarray  # A, (m, n)
    row_upper: np.ndarray  # (m,)

    @cached_property
    def is_finite(self) -> bool:
        """Whether all of H and f is finite; several checks of one tick ask for it."""
        return bool(np.isfinite(self.hessian).all() and np.isfinite(self.gradient).all())

    def defect(self) -> str | None:
        """Status of a problem that no solver may be given (``FAILED``, ``INFEASIBLE``), or None."""
        n, m = len(self.gradient), len(self.row_upper)
        if self.hessian.shape != (n, n) or self.rows.shape != (m, n) or {self.lower.shape, self.upper.shape} != {(n,)}:
            return FAILED
        if not (self.is_finite and np.isfinite(self.rows).all()):
            return FAILED
        if any(np.isnan(part).any() for part in (self.lower, self.upper, self.row_upper)):
            return FAILED
        impossible = (self.lower > self.upper).any() or (self.lower == np.inf).any() or (self.upper == -np.inf).any()
        return INFEASIBLE if impossible or (self.row_upper == -np.inf).any() else None


@dataclass(frozen=True)
class QpSolution:
    """A solver's answer to a problem, and its residuals computed from the problem rather than taken from the solver."""

    problem: Qp
    x: np.ndarray  # Solution, (n,); not finite where none was found
    dual: np.ndarray  # Multipliers of the n bounds, then of the m rows: positive at an upper bound, negative at a lower
    status: str
    seconds: float  # Wall time inside the solver and its call

    @cached_property
    def primal_residual(self) -> float:
        """Largest violation of a bound or row, in the units of x."""
        qp, x = self.problem, self.x
        beyond = (x - qp.upper, qp.lower - x, qp.rows @ x - qp.row_upper)
        worst = max(float(each.max(initial=0.0)) for each in beyond)
        return worst if np.isfinite(x).all() else np.inf

    @cached_property
    def dual_residual(self) -> float:
        """Largest entry of the stationarity condition H x + f + (bound multipliers) + Aᵀ (row multipliers)."""
        qp, bounds = self.problem, len(self.x)
        residual = qp.hessian @ self.x + qp.gradient + self.dual[:bounds] + self.dual[bounds:] @ qp.rows
        return float(np.abs(residual).max(initial=0.0)) if np.isfinite(residual).all() else np.inf

    def fault(self, primal_tolerance: float, relative_dual_tolerance: float) -> str | None:
        """Why this solution must not be used, or None: the solver's status, non-finite values, or large residuals."""
        if self.status != SOLVED:
            return self.status
        size = 1.0 + float(np.abs(self.problem.gradient).max(initial=0.0))
        if self.primal_residual <= primal_tolerance and self.dual_residual <= relative_dual_tolerance * size:
            return None
        return "inaccurate" if np.isfinite(self.x).all() else "not finite"


@dataclass(frozen=True)
class QpConfig:
    """Section ``qp``: settings of the solver."""

    primal_tolerance: float = 1e-6  # Largest violation of a constraint, in the units of x
    max_iterations: int = 20_000


STATUS = {1: SOLVED, 2: FAILED, -1: INFEASIBLE}  # By the exit flag of DAQP; any other one is a failure


def solve_qp(qp: Qp, config: QpConfig) -> QpSolution:
    """Solve a problem by DAQP, a dual active-set method (Arnström, Bemporad, Axehill 2022): exact to rounding.

    Every solve starts cold, so that equal problems give equal solutions. A problem that cannot be solved gives a
    solution with another status whose values are NaN, and no exception.
    """
    start = time.perf_counter()
    defect = qp.defect()
    if defect is not None:
        nan = np.full(len(qp.gradient) + len(qp.row_upper), np.nan)
        return QpSolution(qp, nan[: len(qp.gradient)], nan, defect, time.perf_counter() - start)
    x, _, flag, info = daqp.solve(
        qp.hessian,
        qp.gradient,
        qp.rows,
        np.concatenate([qp.upper, qp.row_upper]),
        np.concatenate([qp.lower, np.full(len(qp.row_upper), -1e30)]),
        primal_tol=config.primal_tolerance,
        iter_limit=config.max_iterations,
    )
    seconds = time.perf_counter() - start
    return QpSolution(qp, np.asarray(x), np.asarray(info["lam"]), STATUS.get(flag, FAILED), seconds)


NOT_FINITE = "not finite"


@dataclass(frozen=True)
class SolutionRequirements:
    """Requirements that a solution must meet before it is sent to a robot."""

    primal_tolerance_n: float = 0.1  # Largest violation of a limit, N
    relative_dual_tolerance: float = 1e-4
    """Largest dual residual, relative to the problem's gradient; a badly conditioned problem fails here."""

    def __post_init__(self) -> None:
        if not (self.primal_tolerance_n > 0 and self.relative_dual_tolerance > 0):
            raise ValueError("primal_tolerance_n and relative_dual_tolerance above 0")


class GuardedSolution(NamedTuple):
    """Variables that may be used, or None with the reason; and the solver's solution, where it gives one."""

    x: np.ndarray | None
    fault: str = ""
    solution: QpSolution | None = None


def guarded_solve(qp: Qp | None, config: QpConfig, demands: SolutionRequirements) -> GuardedSolution:
    """Solve a problem, and judge the solution; the problem is None where a measurement is not finite."""
    if qp is None or not qp.is_finite:
        return GuardedSolution(None, NOT_FINITE)
    solution = solve_qp(qp, config)
    fault = solution.fault(demands.primal_tolerance_n, demands.relative_dual_tolerance)
    return GuardedSolution(None, fault, solution) if fault else GuardedSolution(solution.x, solution=solution)
