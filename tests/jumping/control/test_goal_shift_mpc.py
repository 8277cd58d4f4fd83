"""Goal-shift MPC: its QP against the written-out problem in scipy, its limits, and what a shifted plan sends."""

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.optimize import minimize

from leapgap.jumping.control.goal_shift_mpc import CalmMotion, GoalShiftConfig, GoalShiftPlanner
from leapgap.jumping.control.qp import QpConfig, solver
from leapgap.jumping.control.shifted_plan import QUANTITIES, ShiftedPlan, ShiftGrid
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

UPDATES = 32
TARGET = np.array([0.5, 0.015, 0.0])
FREE = GoalShiftConfig(
    largest=(1.0, 1.0, 1.0), largest_change=(1.0, 1.0, 1.0), largest_pitch_rad=9.0, below_target_m=9.0, torque_nm=1e3,
    on_rear_feet=True,
)  # fmt: skip


@dataclass
class Law:
    """A landing that follows shifts by known amounts."""

    authority: np.ndarray = field(default_factory=lambda: law_of_shifts())
    authority_error: np.ndarray = field(default_factory=lambda: error_of_shifts())

    def planned_to(self, goal: np.ndarray) -> "Law":
        return self

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        return goal

    @property
    def calm(self) -> CalmMotion:
        raise NotImplementedError  # the QP does not ask for it

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        return np.zeros(3)


def error_of_shifts() -> np.ndarray:
    """Two ways: all updates do as much more, or two in a row do more and less by turns."""
    turns = np.where(np.arange(UPDATES) % 2, 0.05, -0.05)
    return np.stack([np.full((UPDATES, 3, 3), 0.01), np.tile(turns[:, None, None], (1, 3, 3))])


def law_of_shifts() -> np.ndarray:
    across = np.array([[1.0, 0.2, 0.0], [0.1, 0.8, 0.0], [0.4, 0.3, 0.6]])
    return np.linspace(2, 0, UPDATES)[:, None, None] / UPDATES * across


@pytest.fixture(scope="module")
def plan(robot: Robot, reference: Log) -> ShiftedPlan:
    """A real plan whose slopes are small random waves."""
    planned = Reference.of(reference, robot)
    rng, slopes = np.random.default_rng(0), {}
    for name in QUANTITIES:
        rows, columns = getattr(planned, name).shape
        rate, phase = rng.uniform(0.5, 1, 3 * columns), rng.uniform(0, 6, 3 * columns)
        waves = np.sin(np.outer(np.linspace(0, 9, rows), rate) + phase)
        slopes[name] = waves.reshape(rows, 3, columns).transpose(1, 0, 2)
    slopes["force"] = 100 * slopes["force"]
    return ShiftedPlan(planned, slopes)


def best_shifts(plan: ShiftedPlan, config: GoalShiftConfig, update: int, predicted: np.ndarray) -> np.ndarray:
    """First shift (3,) of the problem as it stands in the module's docstring, without limits, by scipy."""
    law, edges = Law(), ShiftGrid(plan.reference.schedule, config.period_s, config.steps).horizon(update)
    spans = [slice(a, b) for a, b in itertools.pairwise(edges)]
    gains = [law.authority[span].sum(axis=0) for span in spans]
    padded = np.concatenate([law.authority[:1], law.authority, law.authority[-1:]])
    later = (padded[2:] - padded[:-2]) / 2
    later[[0, -1]] *= 2  # one-sided differences
    ways = [*law.authority_error, config.authority_doubt * law.authority]
    ways.append(config.timing_doubt_s / config.period_s * later)
    errors = [[way[span].sum(axis=0) for span in spans] for way in ways]
    matters, scale = np.array(config.matters), np.array(config.scale)

    def cost(flat: np.ndarray) -> float:
        shifts = flat.reshape(len(spans), 3)
        landing = predicted + sum(gain @ shift for gain, shift in zip(gains, shifts, strict=True))
        value = np.sum(((landing - TARGET) / matters) ** 2)
        value += np.sum((np.diff(shifts, axis=0, prepend=np.zeros((1, 3))) / scale) ** 2)
        for way in errors:
            for axis in range(3):
                off = sum(error[:, axis] * shift[axis] for error, shift in zip(way, shifts, strict=True))
                value += np.sum((off / matters) ** 2)
        return float(value)

    found = minimize(cost, np.zeros(3 * len(spans)), method="BFGS", options={"gtol": 1e-9})
    return found.x[:3]


def solve(
    plan: ShiftedPlan,
    config: GoalShiftConfig,
    update: int,
    predicted: np.ndarray,
    before: tuple[float, ...] = (0, 0, 0),
) -> np.ndarray:
    problem = GoalShiftPlanner(plan, Law(), TARGET, config).problem(update, predicted, np.array(before, dtype=float))
    solution = solver(QpConfig()).solve(problem)
    assert solution.fault(1e-4, 1e-4) is None
    return solution.x


@pytest.mark.parametrize("update", [0, 9, 25, 30, 31])
def test_the_shift_minimises_what_is_written_above_the_problem(plan: ShiftedPlan, update: int) -> None:
    roomy = replace(FREE, limits=replace(FREE.limits, friction=50.0, largest_n=1e5))
    predicted = TARGET + np.array([0.03, -0.02, 0.08])
    found = solve(plan, roomy, update, predicted)[:3]
    np.testing.assert_allclose(found, best_shifts(plan, roomy, update, predicted), atol=1e-4)


def test_a_plan_that_was_moved_has_the_problems_of_the_one_it_was_moved_to(plan: ShiftedPlan) -> None:
    """Goal and stance are moved by 2 cm, 1 cm, −20 mrad and 30 mrad, along slopes that are small waves."""
    rng, change = np.random.default_rng(4), np.array([0.02, 0.01, -0.02, 0.03])
    _, left, of_left = np.unique(plan.reference.torque, axis=1, return_index=True, return_inverse=True)
    slopes = plan.slopes | {"torque": plan.slopes["torque"][:, :, left[of_left.ravel()]]}  # equal left and right
    by_stance = {name: 0.1 * of_goal[0] for name, of_goal in slopes.items()}
    movable = ShiftedPlan(plan.reference, slopes).with_stance(by_stance)
    moved = {
        name: getattr(plan.reference, name) + np.tensordot(change[:3], slopes[name], 1) + 0.03 * by_stance[name]
        for name in QUANTITIES
    }
    there = ShiftedPlan(replace(plan.reference, **moved), slopes)
    target = TARGET + np.array([0.01, 0.0, 0.02])
    first = GoalShiftPlanner(movable, replace(Law(), authority=2 * law_of_shifts()), TARGET, GoalShiftConfig())
    found, expected = first.moved(Law(), target, change), GoalShiftPlanner(there, Law(), target, GoalShiftConfig())
    for update in (0, 12, 19, 31):
        at = update, TARGET + 0.05 * rng.standard_normal(3), 0.01 * rng.standard_normal(3)
        for part in ("hessian", "gradient", "lower", "upper", "rows", "row_upper"):
            of_moved, of_other = (getattr(planner.problem(*at), part) for planner in (found, expected))
            np.testing.assert_allclose(of_moved, of_other, rtol=1e-9, atol=1e-9, err_msg=f"{part} {update}")


def test_a_shift_whose_effect_is_fickle_is_held_and_not_taken_back(plan: ShiftedPlan) -> None:
    """In two steps the effect may be as much larger as smaller: that cancels for a shift that is held through both."""
    fickle, error = np.zeros((UPDATES, 3, 3)), np.zeros((1, UPDATES, 3, 3))
    first, second = slice(9, 14), slice(14, 18)
    fickle[first, 0, 0], fickle[second, 0, 0] = 1.5 / 5, -0.5 / 4
    error[0, first, 0, 0], error[0, second, 0, 0] = 1 / 5, -1 / 4

    def shifts(errors: np.ndarray) -> np.ndarray:
        law = replace(Law(), authority=fickle, authority_error=errors)
        planner = GoalShiftPlanner(plan, law, TARGET, roomy)
        qp = planner.problem(8, TARGET - np.array([0.03, 0, 0]), np.zeros(3))
        return solver(QpConfig()).solve(qp).x[: 3 * roomy.steps : 3]

    limits = replace(FREE.limits, friction=50.0, largest_n=1e5)
    roomy = replace(FREE, limits=limits, authority_doubt=0.0, timing_doubt_s=0.0, scale=(0.5, 0.5, 0.5))
    sure, unsure = shifts(0 * error), shifts(3 * error)
    assert sure[1] - sure[2] > 0.003
    assert unsure[1] - unsure[2] == pytest.approx(0, abs=0.001)
    assert unsure[1] > 0.5 * sure[1]


def test_on_the_rear_feet_alone_nothing_is_shifted_any_more(plan: ShiftedPlan) -> None:
    """The front feet leave at 0.5 s, with update 20; the last step before is held to the landing."""
    held = replace(FREE, on_rear_feet=False)
    off = TARGET - np.array([0.05, 0.08, 0.3])
    assert np.abs(solve(plan, held, 19, off)[:3]).max() > 0.005
    for update in (20, 31):
        np.testing.assert_allclose(solve(plan, held, update, off)[:-3], 0, atol=1e-9)
    grid = ShiftGrid(plan.reference.schedule, held.period_s, held.steps, held.on_rear_feet)
    assert grid.horizon(14).tolist() == [14, 15, 16, 17, 18, 19, UPDATES]


def test_on_the_target_nothing_is_shifted(plan: ShiftedPlan) -> None:
    found = solve(plan, FREE, 5, TARGET)
    np.testing.assert_allclose(found[:-3], 0, atol=1e-6)


def test_pitch_is_a_limit_before_distance(plan: ShiftedPlan) -> None:
    """Landing far too short, and nose-down at the limit: going farther would pitch it further."""
    tight = replace(FREE, largest_pitch_rad=0.15, matters=(0.01, 0.03, 10.0))
    predicted = TARGET + np.array([-0.1, 0.0, 0.14])
    steps = ShiftGrid(plan.reference.schedule).horizon(4)
    gains = np.concatenate([law_of_shifts()[a:b].sum(axis=0) for a, b in itertools.pairwise(steps)], axis=1)
    loose = replace(tight, largest_pitch_rad=9.0)
    pitch, pitch_loose = ((predicted + gains @ solve(plan, c, 4, predicted)[:-3])[2] for c in (tight, loose))
    assert pitch_loose > 0.16
    assert pitch < 0.155


def test_shifts_stay_in_their_box_and_change_slowly(plan: ShiftedPlan) -> None:
    config = replace(FREE, largest=(0.05, 0.05, 0.1), largest_change=(0.01, 0.02, 0.03))
    before = (-0.045, 0.0, 0.0)
    found = solve(plan, config, 3, TARGET + np.array([0.3, 0.0, 0.0]), before=before)[:-3].reshape(-1, 3)
    assert (np.abs(found + np.array(before)) <= np.array([0.05, 0.05, 0.1]) + 1e-6).all()
    far = solve(plan, config, 3, TARGET + np.array([0.3, 0.0, 0.0]))[:3]
    assert (np.abs(far) <= np.array([0.01, 0.02, 0.03]) + 1e-6).all()
    assert far[0] == pytest.approx(-0.01, abs=1e-6)


def test_forces_of_the_shifted_plan_stay_in_the_cone(plan: ShiftedPlan) -> None:
    """A limit just above the friction of the plan itself leaves room for a small shift alone."""
    predicted = TARGET + np.array([0.1, 0.0, 0.0])
    rows = plan.reference.rows(np.array([0.3, 0.3125, 0.323]))

    def friction(shift: np.ndarray) -> float:
        force = np.array([plan.at("force", row, shift) for row in rows])
        return float(np.max(np.abs(force[:, ::2]) / force[:, 1::2]))

    own = friction(np.zeros(3))
    limited = replace(FREE, limits=replace(FREE.limits, friction=own + 0.01), soft_effort=(0.1, 0.1))
    free = replace(FREE, limits=replace(FREE.limits, friction=50.0))
    assert friction(solve(plan, free, 12, predicted)[:3]) > own + 0.03
    assert friction(solve(plan, limited, 12, predicted)[:3]) < own + 0.012


def test_every_horizon_reaches_the_landing_and_its_steps_shrink() -> None:
    grid = ShiftGrid(ContactSchedule())
    horizons = [grid.horizon(update) for update in range(grid.updates)]
    assert all(edges[0] == update and edges[-1] == 32 for update, edges in enumerate(horizons))
    assert all(edges[1] == edges[0] + 1 for edges in horizons)
    assert all((np.diff(edges) >= 1).all() for edges in horizons)
    longest = [int(np.diff(edges).max()) for edges in horizons]
    assert longest == sorted(longest, reverse=True)
    assert longest[0] == 7 and longest[-1] == 1
    assert max(len(edges) for edges in horizons) == 7
