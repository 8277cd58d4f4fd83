"""The condensed problem against rolling out the prediction, and against the problem with its states left in."""

import numpy as np
import pytest
from scipy import optimize

from leapgap.jumping.control.condensed_qp import ForceLimits, Horizon, horizon, prepare_qp
from leapgap.jumping.control.qp import QpConfig, solver
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import AffineModel, advance
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import cost as qp_cost

WEIGHTS = np.array([50, 2.5, 50, 10, 0.2, 10.0])
FORCE_WEIGHT = 1e-4
LIMITS = ForceLimits()


class Case:
    """A random problem: horizon, model at each step, state, targets."""

    def __init__(
        self, steps: Horizon, seed: int, curvature: float = 0.0, linearised: bool = False, limits: ForceLimits = LIMITS
    ) -> None:
        self.curvature = curvature
        rng = np.random.default_rng(seed)
        n = len(steps)
        self.steps = steps
        feet = rng.normal(size=(n, 4)) * 0.2
        contact = steps.contact[:, None, None]
        model = AffineModel(rng.normal(size=(n, 3)) * 3, (A1_BODY.force_rows(feet) + rng.normal(size=(n, 3, 4)) * 0.01))
        plain = AffineModel(model.bias, model.by_force * contact)
        self.model = AffineModel(plain.bias, plain.by_force * np.repeat(steps.share, 2, axis=1)[:, None])
        self.state, self.target = rng.normal(size=6), rng.normal(size=(n, 6))
        self.force = rng.normal(size=(n, 4)) * 50
        self.slope = rng.normal(size=(n, 3, 6)) * 2 if linearised else np.zeros((n, 3, 6))
        self.weights = WEIGHTS * (1 + rng.random((n, 1))) if linearised else np.tile(WEIGHTS, (n, 1))
        later = AffineModel(plain.bias[1:], plain.by_force[1:], self.slope[1:] if linearised else None)
        self.rest = prepare_qp(steps, later, self.target, self.force, self.weights, FORCE_WEIGHT, limits, curvature)
        here = plain.bias[:1] + self.slope[0] @ self.state
        self.qp = self.rest.qp(self.state, AffineModel(here, plain.by_force[:1]))

    def cost(self, force: np.ndarray) -> float:
        """By rolling out: Σ ‖x − x*‖²_Q + w ‖u − u*‖² over what pushes."""
        state, total = self.state, 0.0
        for k, step_s in enumerate(self.steps.step_s):
            acceleration = self.model.bias[k] + self.slope[k] @ state + self.model.by_force[k] @ force[k]
            state = advance(state, acceleration, step_s, self.curvature)
            total += (state - self.target[k]) @ (self.weights[k] * (state - self.target[k]))
            pushing = self.rest.pushing[k]
            total += FORCE_WEIGHT * np.sum((force[k] - self.force[k])[pushing] ** 2)
        return total


TIMES = [0.0, 0.33, 0.487, 0.65, 0.775, 0.79]


@pytest.mark.parametrize("time_s", TIMES)
@pytest.mark.parametrize("schedule", [ContactSchedule(), ContactSchedule(0.51, 0.29, 0.37)])
@pytest.mark.parametrize(("curvature", "linearised"), [(0.0, False), (0.5, False), (0.0, True), (0.5, True)])
def test_cost_is_that_of_the_roll_out(
    time_s: float, schedule: ContactSchedule, curvature: float, linearised: bool
) -> None:
    case = Case(horizon(TimeGrid(), schedule, time_s), 1, curvature, linearised)
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(2, len(case.qp.gradient))) * 80
    by_roll_out = case.cost(case.rest.forces(x)) - case.cost(case.rest.forces(y))
    assert qp_cost(case.qp, x) - qp_cost(case.qp, y) == pytest.approx(by_roll_out, rel=1e-9)


def test_gradient_and_curvature_by_finite_differences_of_the_roll_out() -> None:
    case = Case(horizon(TimeGrid(), ContactSchedule(), 0.65), seed=3)
    n = len(case.qp.gradient)

    def cost(x: np.ndarray) -> float:
        return case.cost(case.rest.forces(x))

    eye, here = np.eye(n), np.zeros(n)
    gradient = np.array([(cost(e) - cost(-e)) / 2 for e in eye])  # exact for a quadratic
    assert case.qp.gradient == pytest.approx(gradient, rel=1e-8, abs=1e-8)
    curvature = np.array([cost(e) - 2 * cost(here) + cost(-e) for e in eye])
    assert np.diag(case.qp.hessian) == pytest.approx(curvature, rel=1e-6)
    assert case.qp.hessian == pytest.approx(case.qp.hessian.T, rel=1e-12)


def test_forces_equal_those_of_the_problem_with_states_as_variables() -> None:
    """States and forces as variables, the dynamics as equalities, solved by SciPy: slow, and another way."""
    case = Case(horizon(TimeGrid(0.025, 0.1, 4), ContactSchedule(), 0.75), seed=4)
    n, pushing = len(case.steps), np.repeat(case.steps.share > 0, 2, axis=1)

    def split(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return v[: 6 * n].reshape(n, 6), v[6 * n :].reshape(n, 4) * 100  # N, scaled for the solver

    def cost(v: np.ndarray) -> float:
        x, u = split(v)
        return np.sum(WEIGHTS * (x - case.target) ** 2) + FORCE_WEIGHT * np.sum(((u - case.force) * pushing) ** 2)

    def dynamics(v: np.ndarray) -> np.ndarray:
        x, u = split(v)
        before = np.concatenate([case.state[None], x[:-1]])
        acceleration = case.model.bias + np.einsum("nij,nj->ni", case.model.by_force, u)
        return (x - advance(before, acceleration, case.steps.step_s)).ravel()

    def room(v: np.ndarray) -> np.ndarray:
        _, u = split(v)
        fx, fz = u[:, FORCE_X], u[:, FORCE_Z]
        return np.concatenate([0.6 * fz - fx, 0.6 * fz + fx, 350 - fz], axis=1).ravel() / 100

    def swing(v: np.ndarray) -> np.ndarray:
        return split(v)[1][~pushing] / 100

    constraints = [{"type": "eq", "fun": dynamics}, {"type": "eq", "fun": swing}, {"type": "ineq", "fun": room}]
    found = optimize.minimize(
        cost, np.zeros(10 * n), constraints=constraints, method="SLSQP", options={"ftol": 1e-12, "maxiter": 500}
    )
    # SciPy may end for want of a better step at this tolerance; what counts is that nothing is violated.
    assert max(np.abs(dynamics(found.x)).max(), np.abs(swing(found.x)).max(), -room(found.x).min()) < 1e-6
    condensed = case.rest.forces(solver(QpConfig()).solve(case.qp).x)
    assert case.cost(condensed) == pytest.approx(cost(found.x), rel=1e-6)
    assert condensed == pytest.approx(split(found.x)[1], abs=0.5)
    assert np.isclose(np.abs(condensed[:, FORCE_X]), 0.6 * condensed[:, FORCE_Z]).any(), "no limit acts: tests little"


def test_forces_are_inside_the_cone_and_zero_in_the_air() -> None:
    for time_s in TIMES:
        case = Case(horizon(TimeGrid(), ContactSchedule(), time_s), seed=5)
        force = case.rest.forces(solver(QpConfig()).solve(case.qp).x)
        assert (np.abs(force[:, FORCE_X]) <= 0.6 * force[:, FORCE_Z] + 1e-6).all()
        assert ((force[:, FORCE_Z] >= -1e-6) & (force[:, FORCE_Z] <= 350 + 1e-6)).all()
        assert (force[np.repeat(case.steps.share == 0, 2, axis=1)] == 0).all()


def test_forces_stay_near_the_plan_where_that_is_asked_for() -> None:
    near = ForceLimits(from_plan_n=30.0)
    for time_s in TIMES:
        case = Case(horizon(TimeGrid(), ContactSchedule(), time_s), 5, limits=near)
        force = case.rest.forces(solver(QpConfig()).solve(case.qp).x)
        # The plan here is random: what is near is the force within bounds and cone that is nearest to it.
        meant = case.force.copy()
        meant[:, FORCE_Z] = np.clip(meant[:, FORCE_Z], 0, 350)
        meant[:, FORCE_X] = np.clip(meant[:, FORCE_X], -0.6 * meant[:, FORCE_Z], 0.6 * meant[:, FORCE_Z])
        off = np.abs(force - meant)[np.repeat(case.steps.share > 0, 2, axis=1)]
        assert off.max() <= 30 + 1e-6
        assert (np.abs(force[:, FORCE_X]) <= 0.6 * force[:, FORCE_Z] + 1e-6).all()
    assert np.isclose(off, 30).any(), "the limit does not act: tests little"
