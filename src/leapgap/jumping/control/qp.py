"""Quadratic programs, solutions that compute their own residuals, and two solvers by name.

qp = Qp(hessian, gradient, lower, upper, rows, row_upper)
solution = solver(QpConfig("daqp")).solve(qp)
solution.x, solution.primal_residual, solution.dual_residual
"""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import daqp
import numpy as np

from leapgap.errors import InputError

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
    """Section ``qp``: the solver and its tolerances; values for the other solver are ignored."""

    backend: str = "daqp"
    primal_tolerance: float = 1e-6  # Constraint tolerance of ``daqp``, in the units of x
    max_iterations: int = 20_000
    eps: float = 1e-6  # Absolute and relative tolerance of ``osqp``
    rho: float = 1e-3  # First step size of ``osqp``


class QpSolver(ABC):
    """Solves quadratic programs. Every solve starts cold, so that equal problems give equal solutions."""

    @abstractmethod
    def solve(self, qp: Qp) -> QpSolution:
        """Solve a problem; one that cannot be solved gives a solution with another status, and no exception."""


@dataclass(frozen=True)
class Daqp(QpSolver):
    """Dual active-set method (Arnström, Bemporad, Axehill 2022): exact, and fast where few constraints are active."""

    config: QpConfig
    STATUS: ClassVar = {1: SOLVED, 2: FAILED, -1: INFEASIBLE}

    def solve(self, qp: Qp) -> QpSolution:
        """Solve a problem with this method; see ``QpSolver``."""
        start = time.perf_counter()
        defect = qp.defect()
        if defect is not None:
            return failed_solution(qp, defect, start)
        upper = np.concatenate([qp.upper, qp.row_upper])
        lower = np.concatenate([qp.lower, np.full(len(qp.row_upper), -1e30)])
        x, _, flag, info = daqp.solve(
            qp.hessian,
            qp.gradient,
            qp.rows,
            upper,
            lower,
            primal_tol=self.config.primal_tolerance,
            iter_limit=self.config.max_iterations,
        )
        seconds = time.perf_counter() - start
        return QpSolution(qp, np.asarray(x), np.asarray(info["lam"]), self.STATUS.get(flag, FAILED), seconds)


@dataclass(frozen=True)
class Osqp(QpSolver):
    """Operator splitting (Stellato and others 2020), on the problem in coordinates y = Lᵀ x, H = L Lᵀ.

    Late forces of a horizon cost little and early ones much. ADMM therefore stops 5 to 10 N off at a tolerance of 1e-6.
    In y the quadratic form is the identity, and the same tolerance leaves an error of 0.05 N.
    """

    config: QpConfig
    STATUS: ClassVar = {1: SOLVED, 3: INFEASIBLE, 4: INFEASIBLE}

    def solve(self, qp: Qp) -> QpSolution:
        """Solve a problem with this method; see ``QpSolver``."""
        import osqp  # before the clock starts; few choose this solver, and the import takes 0.3 s

        start = time.perf_counter()
        defect = qp.defect()
        if defect is not None:
            return failed_solution(qp, defect, start)
        try:
            to_x = np.linalg.inv(np.linalg.cholesky(qp.hessian)).T
        except np.linalg.LinAlgError:
            return failed_solution(qp, FAILED, start)
        if not all(np.isfinite(part).all() for part in (to_x, to_x.T @ qp.gradient, qp.rows @ to_x)):
            return failed_solution(qp, FAILED, start)  # so badly scaled that its coordinates overflow
        try:
            return self._split(qp, to_x, start)
        except (osqp.OSQPException, ValueError):  # what its own checks refuse
            return failed_solution(qp, FAILED, start)

    def _split(self, qp: Qp, to_x: np.ndarray, start: float) -> QpSolution:
        """Solve in the coordinates y, x = to_x · y."""
        import osqp
        from scipy import sparse

        bounded = np.isfinite(qp.lower) | np.isfinite(qp.upper)
        splitting = osqp.OSQP()
        splitting.setup(
            sparse.identity(len(to_x), format="csc"),
            to_x.T @ qp.gradient,
            sparse.csc_matrix(np.concatenate([to_x[bounded], qp.rows @ to_x])),
            np.maximum(np.concatenate([qp.lower[bounded], np.full(len(qp.row_upper), -np.inf)]), -1e30),
            np.minimum(np.concatenate([qp.upper[bounded], qp.row_upper]), 1e30),
            verbose=False,
            rho=self.config.rho,
            eps_abs=self.config.eps,
            eps_rel=self.config.eps,
            max_iter=self.config.max_iterations,
            check_termination=5,
            adaptive_rho_interval=25,  # the default follows the clock, and with it the answer's last digits
        )
        found = splitting.solve(raise_error=False)
        status = self.STATUS.get(found.info.status_val, FAILED)
        if status != SOLVED:
            return failed_solution(qp, status, start)
        dual = np.zeros(len(to_x) + len(qp.row_upper))
        dual[np.concatenate([bounded, np.ones(len(qp.row_upper), bool)])] = found.y
        one_sided = np.concatenate([qp.lower == -np.inf, np.ones(len(qp.row_upper), bool)])
        dual[one_sided] = np.maximum(dual[one_sided], 0.0)  # rounding leaves −1e−17 where no lower bound is
        return QpSolution(qp, to_x @ found.x, dual, status, time.perf_counter() - start)


def failed_solution(qp: Qp, status: str, start: float) -> QpSolution:
    """A solution with this status whose values are all NaN."""
    nan = np.full(len(qp.gradient) + len(qp.row_upper), np.nan)
    return QpSolution(qp, nan[: len(qp.gradient)], nan, status, time.perf_counter() - start)


BACKENDS: dict[str, type[Daqp] | type[Osqp]] = {"daqp": Daqp, "osqp": Osqp}


def solver(config: QpConfig) -> QpSolver:
    """The solver that the configuration names."""
    if config.backend not in BACKENDS:
        raise InputError("qp.backend", config.backend, f"one of {', '.join(BACKENDS)}", "choose one of them")
    return BACKENDS[config.backend](config)


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


def guarded_solve(qp: Qp | None, solver: QpSolver, demands: SolutionRequirements) -> GuardedSolution:
    """Solve a problem, and judge the solution; the problem is None where a measurement is not finite."""
    if qp is None or not qp.is_finite:
        return GuardedSolution(None, NOT_FINITE)
    solution = solver.solve(qp)
    fault = solution.fault(demands.primal_tolerance_n, demands.relative_dual_tolerance)
    return GuardedSolution(None, fault, solution) if fault else GuardedSolution(solution.x, solution=solution)
