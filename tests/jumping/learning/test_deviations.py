"""Deviations from a plan: cut from logs with known ones, learned from a law written here, rolled out by hand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from leapgap.jumping.learning.recipe import DeviationTask, Fitting, ModelSettings
from leapgap.jumping.learning.store import deviation_recipes
from leapgap.jumping.learning.window_extraction import BALLISTIC_S, DeviatingJump, deviating_jump, rolled_out
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import DeviationModel, NominalDeviation, PlannedSteps
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.conftest import A1_BODY

GRID = TimeGrid()
TIMES = np.concatenate([np.arange(0, 0.8, 0.025), np.arange(0.8, 1.201, 0.1)])


def law(time_s: float, target_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """h (3,), C (3, 6) and G (3, 4) of the robot that these tests have."""
    h = np.array([np.sin(3 * time_s), 0.5 * target_m, -1.0 + time_s])
    slope = np.zeros((3, 6))
    slope[0, 0], slope[1, 4], slope[2, 2], slope[2, 5] = -8.0, -1.5, -20.0 * (1 + time_s), -2.0
    by_force = np.zeros((3, 4))
    by_force[0, 2], by_force[1, 3], by_force[2, 1] = -0.02, 0.01 * (1 + target_m), 0.05
    return h, slope, by_force


def made_jump(rng: np.random.Generator, target_m: float) -> DeviatingJump:
    """A jump by that law from random deviations under random forces, stepped by hand; its feet touch down at 1 s."""
    pushing = np.column_stack([TIMES[:-1] < 0.5 - 1e-9, TIMES[:-1] < 0.8 - 1e-9])
    steps = PlannedSteps(TIMES[:-1], TIMES[1:], rng.normal(size=(36, 4)) * 0.2, pushing, Target(target_m))
    force = rng.normal(size=(36, 4)) * 40 * np.repeat(pushing, 2, axis=1)
    error = [rng.normal(size=6) * [0.01, 0.01, 0.03, 0.1, 0.1, 0.3]]
    for k, dt in enumerate(np.diff(TIMES)):
        q, v = error[-1][:3], error[-1][3:]
        acceleration = rng.normal(size=3) * 20  # of a touch-down
        if TIMES[k] < 1.0 - 1e-9:
            h, slope, by_force = law(TIMES[k], target_m)
            fx, fz, rx, rz = force[k]
            ax, az, bx, bz = steps.foot[k]
            of_body = [(fx + rx) / A1_BODY.mass_kg, (fz + rz) / A1_BODY.mass_kg]
            of_body.append((az * fx - ax * fz + bz * rx - bx * rz) / A1_BODY.pitch_inertia_kgm2)
            acceleration = np.array(of_body) + h + slope @ error[-1] + by_force @ force[k]
        error.append(np.concatenate([q + dt * v + dt**2 / 2 * acceleration, v + dt * acceleration]))
    return DeviatingJump(f"to_{target_m}", steps, np.array(error), force)


def learned(name: str, **changes: object) -> DeviationModel:
    rng = np.random.default_rng(1)
    jumps = [made_jump(rng, target_m) for target_m in (0.35, 0.5, 0.65) for _ in range(12)]
    recipe = deviation_recipes()[name]
    settings: dict[str, ModelSettings] = {}
    if recipe.settings is not None:
        settings[recipe.settings.section] = recipe.settings(**changes)
    return recipe.fit(DeviationTask(jumps, A1_BODY, settings))


@pytest.fixture(scope="module")
def kernel() -> DeviationModel:
    return learned("deviation_kernel", ridge=1e-4)


def test_the_law_of_jumps_is_found_at_a_target_that_was_not_practised(kernel: DeviationModel) -> None:
    unseen = made_jump(np.random.default_rng(9), 0.45)
    found = kernel.along(unseen.steps)
    assert found.by_state is not None
    for k in (4, 12, 18, 24, 29):  # of both pairs, and of the rear pair alone
        h, slope, by_force = law(TIMES[k], 0.45)
        pushes = np.repeat(unseen.steps.pushing[k], 2)
        of_body = A1_BODY.force_rows(unseen.steps.foot[k])
        assert found.bias[k] == pytest.approx(h, abs=0.15)
        assert found.by_state[k] == pytest.approx(slope, abs=1.5)
        assert found.by_force[k] == pytest.approx((of_body + by_force) * pushes, abs=0.01)


def test_a_roll_out_goes_where_the_jump_does(kernel: DeviationModel) -> None:
    unseen = made_jump(np.random.default_rng(10), 0.55)
    for first in (0, 20, 30):
        ends = rolled_out(unseen, kernel.along(unseen.steps), first)
        assert ends[0] == pytest.approx(unseen.error[first])
        assert ends[-3] == pytest.approx(unseen.error[-3], abs=0.05)
    no_force = replace(unseen, force=0 * unseen.force)
    assert np.abs(rolled_out(no_force, kernel.along(unseen.steps), 20)[-3] - unseen.error[-3]).max() > 0.2


def test_networks_find_the_law_too() -> None:
    """Nearly: what counts is that a roll-out goes where an unseen jump does, and not where the rigid body would."""
    networks = learned("deviation_networks", seeds=1, fitting=Fitting(steps=400, learning_rate=0.02, weight_decay=0.0))
    unseen = made_jump(np.random.default_rng(10), 0.55)
    for first, largest in ((0, 0.5), (20, 0.15)):
        true = unseen.error[30]
        found = rolled_out(unseen, networks.along(unseen.steps), first)[30 - first]
        plain = rolled_out(unseen, NominalDeviation(A1_BODY).along(unseen.steps), first)[30 - first]
        assert np.abs(found - true).max() < largest
        assert np.abs(found - true).max() < 0.3 * np.abs(plain - true).max()


def test_a_roll_out_is_the_steps_written_out(kernel: DeviationModel) -> None:
    jump = made_jump(np.random.default_rng(11), 0.5)
    affine = kernel.along(jump.steps)
    assert affine.by_state is not None
    state = jump.error[5]
    for k in range(5, 36):
        a = affine.bias[k] + affine.by_state[k] @ state + affine.by_force[k] @ jump.force[k]
        dt = TIMES[k + 1] - TIMES[k]
        state = np.concatenate([state[:3] + dt * state[3:] + dt * dt / 2 * a, state[3:] + dt * a])
    assert rolled_out(jump, affine, 5)[-1] == pytest.approx(state)


def test_nothing_is_learned_where_feet_may_touch_down(kernel: DeviationModel) -> None:
    jump = made_jump(np.random.default_rng(12), 0.5)
    late = jump.steps.time_s >= TIMES[-1] - BALLISTIC_S - 1e-9
    found = kernel.residual(jump.steps)
    assert late.sum() == 2
    assert not found.bias[late].any()
    assert found.bias[~late].any(axis=1).all()
    flown = rolled_out(jump, kernel.along(jump.steps), 34)
    assert flown[-1, 3:] == pytest.approx(jump.error[34, 3:])
    assert flown[-1, :3] == pytest.approx(jump.error[34, :3] + 0.2 * jump.error[34, 3:])


def test_jumps_that_count_more_decide() -> None:
    """Two robots in one pile of jumps: the model is of the one whose jumps weigh more."""
    rng = np.random.default_rng(3)
    plain = [made_jump(rng, 0.5) for _ in range(20)]
    drifting = [replace(jump, error=jump.error + np.outer(TIMES, [0, 0, 0, 1.0, 0, 0])) for jump in plain]
    recipe = deviation_recipes()["deviation_kernel"]

    def bias(weights: tuple[float, float]) -> float:
        pile = [
            replace(jump, weight=weight)
            for pile, weight in zip((plain, drifting), weights, strict=True)
            for jump in pile
        ]
        return float(recipe.fit(DeviationTask(pile, A1_BODY)).along(plain[0].steps).bias[10, 0])

    assert bias((1.0, 100.0)) - bias((100.0, 1.0)) > 0.7


def test_a_robot_has_its_own_h_and_shares_the_slopes_of_simulated_jumps() -> None:
    """Its jumps are pushed by 2 m/s² more, and no force or deviation of theirs tells what those do."""
    rng = np.random.default_rng(4)
    simulated = [replace(made_jump(rng, 0.5), simulated=True) for _ in range(30)]
    plain = simulated[0]
    own = []
    for k, dt in enumerate(np.diff(TIMES)):  # one step each: it begins on the plan, and only its end shows h
        error = np.zeros((37, 6))
        error[k + 1, 3:] = dt * (law(TIMES[k], 0.5)[0] + [2.0, 0.0, 0.0])
        own += 4 * [OneStep("own", plain.steps, error, 0 * plain.force, step=k)]
    fit = deviation_recipes()["deviation_kernel"].fit
    found = fit(DeviationTask([*simulated, *own], A1_BODY)).residual(plain.steps)
    before = fit(DeviationTask(simulated, A1_BODY)).residual(plain.steps)
    assert found.by_state is not None and before.by_state is not None
    for k in (8, 14, 26):
        assert found.bias[k, 0] - before.bias[k, 0] == pytest.approx(2.0, abs=0.4)
        assert found.by_state[k] == pytest.approx(before.by_state[k], abs=0.5)


@dataclass(frozen=True)
class OneStep(DeviatingJump):
    """A jump of which one step is learned from."""

    step: int = 0

    @property
    def learned(self) -> np.ndarray:
        return super().learned & (np.arange(len(self.steps)) == self.step)


def test_deviations_are_cut_from_a_log_and_its_plan(reference: Log, robot: Robot) -> None:
    """A log that is the plan but for a ramp in x and vz, a turn, and a held force."""
    t = reference.time
    columns = {name: np.array(values) for name, values in reference.columns.items()}
    columns["base_pos_x"] = columns["base_pos_x"] + 0.02 * t + 3.0
    columns["base_linvel_z"] = columns["base_linvel_z"] + 0.1 * t
    columns["mpc_force/rear_z"] = columns["mpc_force/rear_z"] + np.where(t < 0.8 - 1e-9, 10 + 100 * t, 0.0)
    jump = Log("driven", columns, reference.info)
    found = deviating_jump(jump, reference, GRID, robot)
    inner = slice(1, -1)
    assert found.error[inner, 0] == pytest.approx(0.02 * TIMES[inner], abs=1e-4)
    assert found.error[inner, 4] == pytest.approx(0.1 * TIMES[inner], abs=1e-3)
    assert np.abs(found.error[:, [1, 2, 3, 5]]).max() < 1e-12
    middle = (TIMES[:-1] + TIMES[1:]) / 2
    assert found.force[:31, 3] == pytest.approx((10 + 100 * middle)[:31], abs=0.2)
    assert np.abs(found.force[:, :3]).max() < 1e-9


def test_nothing_is_learned_of_the_step_of_a_kick() -> None:
    """A kick is no answer of the robot to its forces; what comes after it is."""
    rng = np.random.default_rng(3)
    jumps = [made_jump(rng, 0.5) for _ in range(20)]
    recipe = deviation_recipes()["deviation_kernel"]
    calm = recipe.fit(DeviationTask(jumps, A1_BODY)).along(jumps[0].steps)
    for spoiled, differs in ((14, False), (15, True)):
        kicked = []
        for jump in jumps:
            error = jump.error.copy()
            error[spoiled + 1 :, 3] += 5.0
            kicked.append(replace(jump, error=error, kicked=14))
        left_out = [replace(jump, kicked=14) for jump in jumps]
        expected = recipe.fit(DeviationTask(left_out, A1_BODY)).along(jumps[0].steps)
        found = recipe.fit(DeviationTask(kicked, A1_BODY)).along(jumps[0].steps)
        # the deviations after it differ; of the step itself nothing is known but by its neighbours
        assert (np.abs(found.bias[spoiled, 0] - expected.bias[spoiled, 0]) > 20) == differs
    assert np.abs(calm.bias[14] - expected.bias[14]).max() < 1.0


def test_the_step_of_a_kick_is_the_one_that_holds_its_time(robot: Robot, reference: Log) -> None:
    for kicked_s, step in ((0.1125, 4), (0.7375, 29), (None, None)):
        assert deviating_jump(reference, reference, GRID, robot, kicked_s=kicked_s).kicked == step
