"""The MPC in deviations from its plan: on a system that is written out here."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.mpc import ForcePlanner, MpcConfig, StateWeights
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import AffineModel, DeviationModel, NominalDeviation, PlannedSteps
from leapgap.logs.pair_force import per_axis
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import rigid_reference
from tests.jumping.control.test_qp import by_least_distance

REFERENCE = rigid_reference(A1_BODY)
WEIGHTS = StateWeights(50.0, 100.0, 5.0, 10.0, 10.0, 1.0)
CONFIG = MpcConfig(
    weights=WEIGHTS,
    landing_weights=StateWeights(5000.0, 500.0, 50.0, 0.0, 0.0, 5.0),
    force_weight=1e-6,
    limits=ForceLimits(from_plan_n=60.0),
)


class Springy(DeviationModel):
    """Joint PD that pulls back, a drift late in the push, and forces of which 90 % act."""

    def __init__(self, drift: float = 1.0) -> None:
        self.body, self.drift = A1_BODY, drift

    def terms(self, time_s: float, foot: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """h, C and G at one step, written out."""
        slope = np.zeros((3, 6))
        slope[0, [0, 3]], slope[1, [1, 4]], slope[2, [2, 5]] = (-30, -3), (-40, -3), (-20, -2)
        rows = np.array([[1, 0, 1, 0], [0, 1, 0, 1], [0, 0, 0, 0]]) / A1_BODY.mass_kg
        rows[2] = np.array([foot[1], -foot[0], foot[3], -foot[2]]) / A1_BODY.pitch_inertia_kgm2
        return self.drift * np.array([4.0, 0.0, 0.0]) * (time_s > 0.74), slope, -0.1 * rows

    def residual(self, steps: PlannedSteps) -> AffineModel:
        h, slope, by_force = (
            np.array(part)
            for part in zip(*(self.terms(t, f) for t, f in zip(steps.time_s, steps.foot, strict=True)), strict=True)
        )
        flies = ~steps.pushing.any(axis=1)
        return AffineModel(np.where(flies[:, None], 0, h), by_force, np.where(flies[:, None, None], 0, slope))

    def arrays(self) -> dict[str, np.ndarray]:
        return {}


def test_on_the_plan_a_robot_without_residual_follows_it() -> None:
    planner = ForcePlanner(REFERENCE, NominalDeviation(A1_BODY), CONFIG)
    for time_s in np.arange(0, 0.8, 0.025):
        row = REFERENCE.row(time_s)
        plan = planner.plan(time_s, REFERENCE.state[row], REFERENCE.foot[row])
        assert plan.fallback is None
        assert plan.force == pytest.approx(REFERENCE.mean_force(plan.horizon.time_s), abs=1e-3)


def landed(planner: ForcePlanner | None, model: Springy, off: np.ndarray, kick: np.ndarray | None = None) -> np.ndarray:
    """Deviation at the landing of a robot that is as the model says, stepped by hand, from one at the start, (6,).

    Without a planner it goes by the planned forces; a kick, (6,), comes at 0.7 s.
    """
    e, times = off, [*np.arange(0, 0.8, 0.025), 0.8, 0.9, 1.0, 1.1]
    for time_s, dt in zip(times, [0.025] * 32 + [0.1] * 4, strict=True):
        row, a = REFERENCE.row(time_s), np.zeros(3)
        if kick is not None and abs(time_s - 0.7) < 1e-9:
            e = e + kick
        if time_s < 0.8 - 1e-9:
            force = REFERENCE.force[row]
            if planner is not None:
                force = planner.plan(time_s, REFERENCE.state[row] + e, REFERENCE.foot[row]).force[0]
            du = force - REFERENCE.force[row]
            assert np.abs(du).max() <= 60 + 1e-6
            h, slope, by_force = model.terms(time_s, REFERENCE.foot[row])
            pushes = np.repeat([time_s < 0.5 - 1e-9, True], 2)
            a = h + slope @ e + 0.9 * by_force @ (du * pushes) / -0.1
        e = np.concatenate([e[:3] + dt * e[3:] + dt * dt / 2 * a, e[3:] + dt * a])
    return e


@pytest.mark.parametrize("off", [np.zeros(6), np.array([0.01, -0.01, 0.05, 0.1, -0.1, 0.3])])
def test_a_drift_that_the_model_knows_is_met_before_it_comes(off: np.ndarray) -> None:
    model = Springy()
    nominal = ForcePlanner(REFERENCE, NominalDeviation(A1_BODY), CONFIG)
    surprised = abs(landed(nominal, model, off)[0])
    assert abs(landed(ForcePlanner(REFERENCE, model, CONFIG), model, off)[0]) < surprised / 2


def test_what_is_expected_of_the_plan_is_left_alone_and_what_is_not_is_corrected() -> None:
    """The goal was chosen for the drift: with it alone the planned forces are sent, a kicked robot is brought back."""
    model, start, kick = Springy(), np.zeros(6), np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    expected, kicked = landed(None, model, start), landed(None, model, start, kick)
    assert abs(expected[0]) > 0.01, "a drift that shows"
    planner = ForcePlanner(REFERENCE, model, replace(CONFIG, to_expected=True))
    assert landed(planner, model, start) == pytest.approx(expected, abs=1e-3)
    assert abs((landed(planner, model, start, kick) - expected)[0]) < abs((kicked - expected)[0]) / 2
    planner = ForcePlanner(REFERENCE, model, CONFIG)
    assert abs(landed(planner, model, start)[0]) < abs(expected[0]) / 2, "the plan itself is aimed at"


def test_what_the_landing_weighs_shows_only_where_the_horizon_sees_it() -> None:
    """Fixed steps of 25 ms see no landing before take-off: the same forces with and without its weights."""
    state = REFERENCE.state[REFERENCE.row(0.7)] + [0.01, 0, 0, 0.1, 0, 0]
    for grid, differs in ((TimeGrid(), True), (TimeGrid(0.025, 0.025, 10), False)):
        with_it, without = (
            ForcePlanner(REFERENCE, Springy(), replace(CONFIG, grid=grid, landing_weights=weights))
            for weights in (CONFIG.landing_weights, None)
        )
        forces = [one.plan(0.7, state, REFERENCE.foot[700]).force for one in (with_it, without)]
        assert (np.abs(forces[0] - forces[1]).max() > 1.0) == differs


@pytest.mark.parametrize("time_s", [0.0, 0.3, 0.475, 0.6, 0.7, 0.775, 0.111])
def test_forces_are_the_exact_ones(time_s: float) -> None:
    """By non-negative least squares, also between updates and where limits act."""
    rng, row = np.random.default_rng(5), REFERENCE.row(time_s)
    state = REFERENCE.state[row] + rng.normal(size=6) * [0.03, 0.03, 0.1, 0.3, 0.3, 1.0]
    planner = ForcePlanner(REFERENCE, Springy(), CONFIG)
    ready = planner.prepared.get(round(1e6 * time_s)) or planner.formulation.prepare(time_s)
    problem = planner.problem(time_s, ready, state, REFERENCE.foot[row])
    assert problem is not None
    expected = ready.forces(by_least_distance(problem))
    off = np.abs(expected - REFERENCE.mean_force(ready.horizon.time_s))[per_axis(ready.horizon.share > 0)]
    assert np.isclose(off, 60, atol=1e-6).any(), "no limit acts: tests little"
    plan = planner.plan(time_s, state, REFERENCE.foot[row])
    assert plan.fallback is None
    assert plan.force == pytest.approx(expected, abs=1e-3)
