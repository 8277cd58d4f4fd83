"""Plans from measured states: exact models, signs, and every way to fail."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.control.mpc import ForcePlanner, MpcConfig
from leapgap.jumping.control.qp import (
    INFEASIBLE,
    NOT_FINITE,
    Qp,
    QpConfig,
    QpSolution,
    QpSolver,
    solver,
)
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import (
    PITCH,
    PITCH_RATE,
    VX,
    VZ,
    AffineModel,
    PredictionModel,
    RigidBodyModel,
    Situation,
    X,
    Z,
)
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import Counting, rigid_reference
from tests.jumping.rigid_motion import acceleration, step

BODY = A1_BODY
REFERENCE = rigid_reference(BODY)
MODEL = RigidBodyModel(BODY)


def planner(model: PredictionModel = MODEL, **changed: object) -> ForcePlanner:
    return ForcePlanner(REFERENCE, model, replace(MpcConfig(), **changed))  # type: ignore[arg-type]


def test_with_an_exact_model_the_plan_is_the_reference() -> None:
    """On a jump the model makes exactly, at every update of it, whatever the weights."""
    mpc = planner()
    for time_s in np.arange(0, 0.8, 0.025):
        row = REFERENCE.row(time_s)
        plan = mpc.plan(time_s, REFERENCE.state[row], REFERENCE.foot[row])
        expected = REFERENCE.force[REFERENCE.rows(plan.horizon.time_s[:-1])]
        assert plan.fallback is None
        assert plan.force == pytest.approx(expected, abs=0.01)


def test_in_closed_loop_on_the_exact_model_a_disturbed_body_returns_to_the_reference() -> None:
    mpc = planner(force_weight=1e-8)
    state = REFERENCE.state[0] + [0.005, 0.003, 0.01, 0.1, -0.05, 0.1]
    for time_s in np.arange(0, 0.5, 0.025):
        row = REFERENCE.row(time_s)
        force = mpc.plan(time_s, state, REFERENCE.foot[row]).force[0]
        state = step(BODY, state, REFERENCE.foot[row], force, 0.025)
    assert state == pytest.approx(REFERENCE.state[500], abs=0.01)


@pytest.mark.parametrize("time_s", [0.1, 0.6])
@pytest.mark.parametrize(("component", "off"), [(VX, 0.2), (X, 0.03), (VZ, 0.5), (Z, 0.1)])
def test_forces_push_against_a_deviation(time_s: float, component: int, off: float) -> None:
    row = REFERENCE.row(time_s)
    axis = FORCE_X if component in (VX, X) else FORCE_Z
    for sign in (1, -1):
        state = REFERENCE.state[row].copy()
        state[component] += sign * off
        change = planner().plan(time_s, state, REFERENCE.foot[row]).force[0] - REFERENCE.force[row]
        assert -sign * change[axis].sum() > 1.0


@pytest.mark.parametrize(("component", "off"), [(PITCH, 0.1), (PITCH_RATE, 0.5)])
def test_a_body_too_far_nose_down_is_turned_nose_up(component: int, off: float) -> None:
    row = REFERENCE.row(0.1)
    state = REFERENCE.state[row].copy()
    state[component] += off
    force = planner().plan(0.1, state, REFERENCE.foot[row]).force[0]
    turned, planned = (acceleration(BODY, REFERENCE.foot[row], each) for each in (force, REFERENCE.force[row]))
    assert turned[2] < planned[2] - 0.5


def test_the_model_is_asked_about_one_moment_online() -> None:
    counted = Counting(MODEL)
    mpc = planner(counted)
    assert sum(counted.asked) > 200, "the reference's moments are asked ahead of time"
    counted.asked.clear()
    for time_s in (0.0, 0.3, 0.775):
        row = REFERENCE.row(time_s)
        mpc.plan(time_s, REFERENCE.state[row], REFERENCE.foot[row])
    assert counted.asked == [1, 1, 1]


def test_between_updates_of_the_grid_a_plan_is_made_all_the_same() -> None:
    """Against a planner whose updates fall on that very time: the same problem, prepared or not."""
    mpc, row = planner(), REFERENCE.row(0.112)
    plan = mpc.plan(0.112, REFERENCE.state[row], REFERENCE.foot[row])
    assert plan.fallback is None
    prepared = planner(period_s=0.112).plan(0.112, REFERENCE.state[row], REFERENCE.foot[row])
    assert np.array_equal(plan.force, prepared.force)


@pytest.mark.parametrize("grid", [TimeGrid(0.025, 0.025, 10), TimeGrid(0.05, 0.05, 10), TimeGrid(0.025, 0.08, 22)])
def test_other_grids_and_solvers_and_schedules_plan(grid: TimeGrid) -> None:
    reference = rigid_reference(BODY, 0.05, ContactSchedule(0.45, 0.3, 0.4))
    forces = []
    for backend in ("daqp", "osqp"):
        mpc = ForcePlanner(reference, MODEL, MpcConfig(grid, qp=QpConfig(backend)))
        for time_s in (0.0, 0.3, 0.7, 0.75, 1.0):
            row = reference.row(time_s)
            forces.append(mpc.plan(time_s, reference.state[row] + 0.01, reference.foot[row]).force)
        assert not mpc.fallbacks
    for exact, split in zip(forces[:5], forces[5:], strict=True):
        assert split == pytest.approx(exact, abs=1.0)


def test_nothing_is_planned_in_flight() -> None:
    plan = planner().plan(0.8, REFERENCE.state[800], REFERENCE.foot[800])
    assert plan.force.size == 0
    assert (plan.at(0.8) == 0).all()


# What goes wrong, and what is sent then.


class Contradicting(QpSolver):
    """Adds two rows that no force satisfies, so that the solver finds the problem infeasible."""

    def solve(self, qp: Qp) -> QpSolution:
        rows = np.zeros((2, len(qp.gradient)))
        rows[0, 0], rows[1, 0] = 1.0, -1.0
        both = replace(qp, rows=np.vstack([qp.rows, rows]), row_upper=np.append(qp.row_upper, [-1.0, -1.0]))
        return solver(QpConfig()).solve(both)


class Distorted(PredictionModel):
    """The nominal model, its answers for a single moment (those online) multiplied."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        said = MODEL.affine(situation, contact)
        return AffineModel(said.bias, said.by_force * self.factor) if len(contact) == 1 else said


def infeasible() -> ForcePlanner:
    return ForcePlanner(REFERENCE, MODEL, MpcConfig(), qp_solver=Contradicting())


def model_says_nan() -> ForcePlanner:
    return planner(Distorted(np.nan))


def badly_conditioned() -> ForcePlanner:
    return planner(Distorted(1e9))


@pytest.mark.parametrize(
    ("make", "reasons"),
    [
        (infeasible, {INFEASIBLE}),
        (model_says_nan, {NOT_FINITE}),
        (badly_conditioned, {"inaccurate", "failed", INFEASIBLE}),
    ],
)
def test_without_a_solution_the_reference_is_sent_and_the_reason_counted(
    make: Callable[[], ForcePlanner], reasons: set[str]
) -> None:
    mpc, row = make(), REFERENCE.row(0.2)
    plan = mpc.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    assert plan.fallback in reasons
    assert mpc.fallbacks == {plan.fallback: 1}
    assert plan.force[0] == pytest.approx(REFERENCE.force[row])


@pytest.mark.parametrize("where", ["state", "foot"])
def test_a_measurement_that_is_no_number_goes_on_with_the_last_plan_shifted(where: str) -> None:
    mpc = planner()
    row = REFERENCE.row(0.2)
    good = mpc.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    bad = {"state": REFERENCE.state[row].copy(), "foot": REFERENCE.foot[row].copy()}
    bad[where][2] = np.nan
    plan = mpc.plan(0.225, **bad)
    assert plan.fallback == NOT_FINITE
    assert plan.force[0] == pytest.approx(good.force[1])
    assert not np.allclose(plan.force[0], REFERENCE.force[row], atol=1.0), "the two substitutes cannot be told apart"
    later = mpc.plan(0.325, **bad)
    assert later.force[0] == pytest.approx(REFERENCE.force[REFERENCE.row(0.325)]), "a plan of 125 ms ago is stale"
    assert mpc.fallbacks == {NOT_FINITE: 2}
    again = mpc.plan(0.35, REFERENCE.state[350], REFERENCE.foot[350])
    assert again.fallback is None


class Footless(PredictionModel):
    """A model that does not depend on the feet."""

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        return MODEL.affine(replace(situation, foot=np.tile(REFERENCE.foot[0], (len(contact), 1))), contact)


def test_feet_that_are_no_numbers_count_for_a_model_without_feet_too() -> None:
    """What was not measured decides no force."""
    row = REFERENCE.row(0.2)
    plan = planner(Footless()).plan(0.2, REFERENCE.state[row], REFERENCE.foot[row] * np.nan)
    assert plan.fallback == NOT_FINITE


def test_a_shifted_plan_does_not_push_with_feet_that_have_left() -> None:
    mpc = planner()
    mpc.plan(0.475, REFERENCE.state[475], REFERENCE.foot[475])
    plan = mpc.plan(0.5, REFERENCE.state[500] * np.nan, REFERENCE.foot[500])
    assert (plan.force[:, :2] == 0).all()
    assert plan.force[0, 3] > 0


def test_settings_that_mean_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="period_s"):
        MpcConfig(period_s=0.0)
