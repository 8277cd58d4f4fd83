"""Solves a QP before a deadline, and reports why a solution must not be used."""

from collections.abc import Callable
from dataclasses import dataclass

from leapgap.jumping.control.qp import OUT_OF_TIME, Qp, QpSolution, QpSolver

NOT_FINITE = "not finite"


@dataclass(frozen=True)
class SolutionRequirements:
    """Requirements that a solution must meet before it is sent to a robot."""

    deadline_s: float | None = None
    """Time to build and solve a problem; None: no limit, so that runs repeat bit for bit."""
    primal_tolerance_n: float = 0.1
    """Largest violation of a limit, N."""
    relative_dual_tolerance: float = 1e-4
    """Largest dual residual, relative to the problem's gradient; a badly conditioned problem fails here."""

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        if not (self.deadline_s is None or self.deadline_s >= 0):
            raise ValueError("deadline_s not below 0, or none")
        if not (self.primal_tolerance_n > 0 and self.relative_dual_tolerance > 0):
            raise ValueError("primal_tolerance_n and relative_dual_tolerance above 0")


@dataclass(frozen=True)
class GuardedSolution:
    """A solution (None where there is none), and the reason why it must not be used (None where it may)."""

    solution: QpSolution | None
    fault: str | None


def guarded_solve(
    problem: Callable[[], Qp | None], solver: QpSolver, demands: SolutionRequirements, clock: Callable[[], float]
) -> GuardedSolution:
    """Build a problem and solve it before the deadline; ``problem`` returns None where a measurement is not finite."""
    began = clock()

    def remaining_s() -> float | None:
        return None if demands.deadline_s is None else demands.deadline_s - (clock() - began)

    qp = problem()
    if qp is None or not qp.is_finite:
        return GuardedSolution(None, NOT_FINITE)
    time_limit_s = remaining_s()
    if time_limit_s is not None and time_limit_s <= 0:
        return GuardedSolution(None, OUT_OF_TIME)
    solution = solver.solve(qp, time_limit_s)
    time_left_s = remaining_s()
    if time_left_s is not None and time_left_s < 0:
        return GuardedSolution(solution, OUT_OF_TIME)
    return GuardedSolution(solution, solution.fault(demands.primal_tolerance_n, demands.relative_dual_tolerance))
