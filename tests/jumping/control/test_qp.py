"""Solutions of the MPC's problems against an independent method, and solutions that judge themselves."""

from dataclasses import replace

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.optimize import nnls

from leapgap.errors import InputError
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.mpc import ForcePlanner, MpcConfig
from leapgap.jumping.control.qp import FAILED, INFEASIBLE, SOLVED, Qp, QpConfig, QpSolution, solver
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import RigidBodyModel
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from stages.common import CONF, read_config
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import cost, duality_gap

BACKENDS = ("daqp", "osqp")
TOLERANCE_N = {"daqp": 0.01, "osqp": 1.0}


def by_least_distance(qp: Qp) -> np.ndarray:
    """The same problem by Lawson and Hanson's least distance programming and non-negative least squares (ch. 23).

    With H = L Lᵀ and z = Lᵀ x + L⁻¹ f the problem is min ‖z‖ with G z ≥ h; its answer is −r / r_last of the
    residual r of min ‖E u − e_last‖, u ≥ 0, E = [G h]ᵀ.
    """
    finite_lower, finite_upper = np.isfinite(qp.lower), np.isfinite(qp.upper)
    eye = np.eye(len(qp.gradient))
    rows = np.concatenate([-qp.rows, -eye[finite_upper], eye[finite_lower]])
    least = np.concatenate([-qp.row_upper, -qp.upper[finite_upper], qp.lower[finite_lower]])
    factor = np.linalg.cholesky(qp.hessian)
    centre = np.linalg.solve(factor, qp.gradient)
    in_z = np.linalg.solve(factor, rows.T).T
    at_least = least + in_z @ centre
    scale = np.linalg.norm(np.column_stack([in_z, at_least]), axis=1)
    system = np.column_stack([in_z, at_least]).T / scale
    wanted = np.zeros(len(system))
    wanted[-1] = 1.0
    multipliers, _ = nnls(system, wanted, maxiter=10_000)
    residual = system @ multipliers - wanted
    return np.linalg.solve(factor.T, -residual[:-1] / residual[-1] - centre)


def problems(reference: Log, robot: Robot, steps: int) -> list[Qp]:
    """Of a planned jump whose measured states are off by what robots are off by: limits act in most of them."""
    followed, rng = Reference.of(reference, robot), np.random.default_rng(5)
    planner = ForcePlanner(followed, RigidBodyModel(A1_BODY), MpcConfig(grid=TimeGrid(0.025, 0.1, steps)))
    made = []
    for time_s in np.arange(0, 0.8, 0.025):
        row = followed.row(time_s)
        off = rng.normal(size=6) * [0.02, 0.02, 0.05, 0.15, 0.15, 0.4]
        prepared = planner.prepared[round(1e6 * time_s)]
        problem = planner.problem(float(time_s), prepared, followed.state[row] + off, followed.foot[row])
        assert problem is not None
        made.append(problem)
    return made


@pytest.mark.parametrize("steps", [10, 22])
@pytest.mark.parametrize("backend", BACKENDS)
def test_forces_agree_with_an_independent_method(reference: Log, robot: Robot, backend: str, steps: int) -> None:
    chosen, limited = solver(QpConfig(backend)), 0
    for qp in problems(reference, robot, steps):
        solution, expected = chosen.solve(qp), by_least_distance(qp)
        assert solution.status == SOLVED
        assert solution.x == pytest.approx(expected, abs=TOLERANCE_N[backend])
        limited += bool((np.abs(solution.dual) > 1e-6).any())
    assert limited > 5, "problems without an active limit test little"


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_solution_judges_itself(reference: Log, robot: Robot, backend: str) -> None:
    qp = max(problems(reference, robot, 10), key=lambda qp: np.abs(solver(QpConfig()).solve(qp).dual).max())
    before = [part.copy() for part in (qp.hessian, qp.gradient, qp.lower, qp.upper, qp.rows, qp.row_upper)]
    good = solver(QpConfig(backend)).solve(qp)
    after = (qp.hessian, qp.gradient, qp.lower, qp.upper, qp.rows, qp.row_upper)
    assert all(np.array_equal(*pair) for pair in zip(before, after, strict=True)), "a solver changed its problem"
    size = np.abs(qp.gradient).max()
    assert good.primal_residual < 1e-3
    assert good.dual_residual < 1e-6 * size
    assert duality_gap(good) < 1e-3 * abs(cost(qp, good.x))
    assert good.fault(0.1, 1e-4) is None
    off = replace(good, x=good.x + np.eye(len(good.x))[1] * 400.0)  # far beyond the largest force
    assert off.primal_residual == pytest.approx(400.0 + good.x[1] - qp.upper[1])
    assert off.dual_residual > 1e-3 * size
    assert off.fault(0.1, 1e-4) == "inaccurate"
    assert duality_gap(replace(good, x=1.01 * good.x)) > 10 * duality_gap(good)


def test_residuals_of_a_problem_done_by_hand() -> None:
    """min ½ x² − 3 x with x ≤ 1: x = 1 with multiplier 2; wrong multipliers and points have known residuals."""
    one = np.ones(1)
    qp = Qp(np.eye(1), -3 * one, 0 * one, one, np.zeros((0, 1)), np.zeros(0))
    right = QpSolution(qp, one, 2 * one, SOLVED, 0.0)
    assert (right.primal_residual, right.dual_residual, duality_gap(right)) == pytest.approx((0, 0, 0))
    assert duality_gap(replace(right, dual=one)) == pytest.approx(1.0)
    assert replace(right, dual=one).dual_residual == pytest.approx(1.0)
    assert replace(right, x=-0.5 * one).primal_residual == pytest.approx(0.5)
    assert replace(right, x=np.nan * one).fault(0.1, 1e-4) == "not finite"
    assert replace(right, status=FAILED).fault(0.1, 1e-4) == FAILED


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_answer_repeats_bit_for_bit(reference: Log, robot: Robot, backend: str) -> None:
    qp = problems(reference, robot, 10)[4]
    assert np.array_equal(*(solver(QpConfig(backend)).solve(qp).x for _ in range(2)))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", ["contradiction", "no number", "not convex"])
def test_a_bad_problem_is_a_solution_with_a_reason(backend: str, kind: str) -> None:
    unbounded = np.full(2, np.inf)
    qp = Qp(np.eye(2), np.ones(2), -unbounded, unbounded, np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, -2.0]))
    if kind == "no number":
        qp = replace(qp, hessian=qp.hessian * np.nan)
    if kind == "not convex":
        qp = replace(qp, hessian=-qp.hessian)
    fault = solver(QpConfig(backend)).solve(qp).fault(0.1, 1e-4)
    assert fault in {"contradiction": {INFEASIBLE}, "no number": {FAILED, "not finite", INFEASIBLE}}.get(kind, {FAILED})


def test_an_unknown_solver_is_refused() -> None:
    with pytest.raises(InputError, match=r"qp\.backend: found simplex; expected one of daqp, osqp"):
        solver(QpConfig("simplex"))


@pytest.mark.parametrize("backend", BACKENDS)
def test_configuration_names_the_solver_and_the_defaults(backend: str) -> None:
    read = read_config(QpConfig, OmegaConf.load(CONF / "evaluate" / "qp" / f"{backend}.yaml"), "evaluate.qp")
    assert read == QpConfig(backend)


def test_limits_that_contradict_themselves_are_refused() -> None:
    with pytest.raises(ValueError, match="smallest_n < largest_n"):
        ForceLimits(smallest_n=400.0)
