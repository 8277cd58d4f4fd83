"""Compiled updates: forces, feet and torques equal those of the exact solver and of MuJoCo, and every way to fail.

Without numba the same functions run as plain Python, so these tests need no compiler; a controller does.
"""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control import compiled_planner, compiler, inference, leg_kinematics
from leapgap.jumping.control.compiled_planner import CompiledPlanner
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.inference import CompiledSum, ExportedModel, Perceptron, Phase, first_step, kernel
from leapgap.jumping.control.leg_kinematics import CompiledLegs, LegKinematics, StartFrame
from leapgap.jumping.control.mpc import ForcePlanner, JumpMpc, MpcConfig
from leapgap.jumping.control.qp import FAILED, NOT_FINITE
from leapgap.jumping.control.tracking import PhaseGains, Reference
from leapgap.jumping.learning.windows import Purpose, TimeGrid
from leapgap.jumping.models.rigid_body import AffineModel, PredictionModel, RigidBodyModel, Situation
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis
from leapgap.robot.model import Robot
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import estimate, rigid_reference
from tests.jumping.control.test_qp import by_least_distance

REFERENCE = rigid_reference(A1_BODY)
MODEL = RigidBodyModel(A1_BODY)
NOISE = np.array([0.02, 0.02, 0.05, 0.15, 0.15, 0.4])
"""What measured states are off by: m, m, rad, m/s, m/s, rad/s."""


@pytest.fixture(autouse=True)
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_planner, "require_compiler", lambda where: None)


def random_perceptron(widths: tuple[int, ...], rng: np.random.Generator, scale: float) -> Perceptron:
    """From the 17 known inputs to the 15 outputs, unit gain a layer, the last one scaled."""
    layers, inputs = [], 17
    for i, outputs in enumerate((*widths, 15)):
        gain = (scale if i == len(widths) else 1.0) / np.sqrt(inputs)
        weight = (gain * rng.normal(size=(inputs, outputs))).astype(np.float32)
        layers.append((weight, (0.1 * gain * rng.normal(size=outputs)).astype(np.float32)))
        inputs = outputs
    return Perceptron(tuple(layers))


def learned(*widths: tuple[int, ...], kernels: bool = False) -> ExportedModel:
    """A rigid body and perceptrons that change its accelerations by a few per cent."""
    rng = np.random.default_rng(3)
    at_rest = A1_BODY.force_rows(np.zeros(4)).ravel()
    feet = A1_BODY.force_rows(np.eye(4)).reshape(4, 12) - at_rest
    parts = tuple(random_perceptron(w, rng, 0.01) for w in widths)
    if kernels:
        select, centres = rng.normal(size=(17, 3)), rng.normal(size=(5, 3))
        parts += (
            kernel(
                {"select": select, "shift": np.zeros(3), "centres": centres, "coefficients": np.full((5, 15), 0.01)}
            ),
        )
    constant = np.concatenate([[0.0, -9.81, 0.0], at_rest])
    contact = Phase(constant, np.pad(feet, [(0, 0), (3, 0)]), parts)
    flight = Phase(np.pad(constant[:3], (0, 12)), np.zeros((4, 15)), ())
    return ExportedModel("random", Purpose(TimeGrid(), ContactSchedule(), "", ""), contact, flight)


def exact_forces(planner: ForcePlanner, time_s: float, state: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Forces (n, 4) of the same problem by non-negative least squares."""
    ready = planner.prepared.get(round(1e6 * time_s)) or planner.formulation.prepare(time_s)
    problem = planner._problem(time_s, ready, state, foot)
    assert problem is not None
    return ready.forces(by_least_distance(problem))


@pytest.mark.parametrize("limits", [ForceLimits(), ForceLimits(friction=0.2, largest_n=150.0, smallest_n=20.0)])
@pytest.mark.parametrize("grid", [TimeGrid(), TimeGrid(0.025, 0.025, 22)])
@pytest.mark.parametrize("model", [MODEL, learned((8,), (6, 5)), learned((8,), kernels=True)])
def test_forces_are_the_exact_ones(model: PredictionModel, grid: TimeGrid, limits: ForceLimits) -> None:
    """On states that are off as robots are and on states far away, where many limits act, at and between updates."""
    config, rng, active = MpcConfig(grid, limits=limits), np.random.default_rng(7), 0
    planner, exact = CompiledPlanner(REFERENCE, model, config), ForcePlanner(REFERENCE, model, config)
    for time_s in (0.0, 0.111, 0.3, 0.475, 0.5, 0.7, 0.775):
        for size in (1.0, 5.0):
            row = REFERENCE.row(time_s)
            state = REFERENCE.state[row] + size * NOISE * rng.normal(size=6)
            foot = REFERENCE.foot[row] + 0.01 * size * rng.normal(size=4)
            plan, expected = planner.plan(time_s, state, foot), exact_forces(exact, time_s, state, foot)
            assert plan.fallback is None
            assert plan.force == pytest.approx(expected, abs=1e-3)
            pushing = per_axis(plan.horizon.share > 0)
            active += int((np.abs(expected[pushing] - limits.largest_n) < 1e-6).sum())
            active += int((np.abs(np.abs(expected[:, ::2]) - limits.friction * expected[:, 1::2]) < 1e-6).sum())
    assert active > 50, "problems without active limits test little"


def test_equal_states_give_equal_forces_whatever_came_before() -> None:
    planner, row = CompiledPlanner(REFERENCE, MODEL, MpcConfig()), REFERENCE.row(0.2)
    first = planner.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    planner.plan(0.2, REFERENCE.state[row] - 0.3, REFERENCE.foot[row])
    again = planner.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    assert np.array_equal(first.force, again.force)


@pytest.mark.parametrize("curvature", [0.0, 0.5])
def test_curved_steps_are_solved_too(curvature: float) -> None:
    model = replace(learned((8,)), curvature=curvature)
    row = REFERENCE.row(0.3)
    state = REFERENCE.state[row] + 3 * NOISE
    plan = CompiledPlanner(REFERENCE, model, MpcConfig()).plan(0.3, state, REFERENCE.foot[row])
    exact = exact_forces(ForcePlanner(REFERENCE, model, MpcConfig()), 0.3, state, REFERENCE.foot[row])
    assert plan.force == pytest.approx(exact, abs=1e-3)


# The model at the measured state.


@pytest.mark.parametrize("widths", [(), ((8,),), ((20, 30), (16,))])
def test_compiled_model_is_the_model(widths: tuple[tuple[int, ...], ...]) -> None:
    model, rng = learned(*widths), np.random.default_rng(1)
    for _ in range(5):
        state, foot, time_s = rng.normal(size=6), rng.normal(size=4), float(rng.random())
        said = model.affine(Situation(state[None], foot[None], np.array([time_s]), state[None]), np.array([True]))
        found = first_step(model)(state, foot, time_s)
        assert found[:3] == pytest.approx(said.bias[0], abs=1e-5)
        assert found[3:] == pytest.approx(said.by_force[0].ravel(), abs=1e-8, rel=1e-5)


def test_controllers_of_one_model_share_its_weights_and_those_of_another_do_not() -> None:
    model = learned((8,), (8,))
    first = first_step(model)
    assert isinstance(first, CompiledSum) and first_step(model) is first
    assert first_step(learned((8,), (8,))) is not first


def test_compiled_rigid_body_is_the_rigid_body() -> None:
    state, foot = np.arange(6.0), np.array([0.2, -0.3, -0.1, -0.2])
    found = first_step(MODEL)(state, foot, 0.1)
    assert found[:3] == pytest.approx([0.0, -9.81, 0.0])
    assert found[3:] == pytest.approx(A1_BODY.force_rows(foot).ravel())


def test_wide_layers_of_16_bits_change_forces_by_less_than_a_hundredth_of_a_newton(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inference, "WIDE", 1)
    model, rng = learned((30, 25), (15, 18)), np.random.default_rng(2)
    compiled = first_step(model)
    assert isinstance(compiled, CompiledSum)
    assert len(compiled.wide) == 17 * 30 + 30 * 25 + 25 * 15 + 17 * 15 + 15 * 18 + 18 * 15
    planner, exact = CompiledPlanner(REFERENCE, model, MpcConfig()), ForcePlanner(REFERENCE, model, MpcConfig())
    for time_s in (0.1, 0.4, 0.6):
        row = REFERENCE.row(time_s)
        state, foot = REFERENCE.state[row] + NOISE * rng.normal(size=6), REFERENCE.foot[row]
        expected = exact_forces(exact, time_s, state, foot)
        assert planner.plan(time_s, state, foot).force == pytest.approx(expected, abs=0.01)


def test_tanh_is_that_of_the_library() -> None:
    values = np.concatenate([np.linspace(-12, 12, 4001), [0.0, 1e-6, -80.0, 1e30]]).astype(np.float32)
    expected = np.tanh(values.astype(float))
    inference.squash(values)
    assert values == pytest.approx(expected, abs=3e-7)


# Legs.


@pytest.mark.parametrize("anchors_m", [0.0, 0.03])
def test_feet_and_torques_are_those_of_mujoco(anchors_m: float) -> None:
    """Also of a robot whose joints do not turn about the origins of their links."""
    robot, rng = Robot.load(), np.random.default_rng(4)
    robot.model.jnt_pos[1:] = anchors_m * rng.normal(size=(12, 3))
    by_mujoco, compiled = LegKinematics(robot), CompiledLegs(robot)
    for _ in range(10):
        quaternion, joint_pos, force = rng.normal(size=4), rng.normal(size=12), 100 * rng.normal(size=(2, 3))
        quaternion /= np.linalg.norm(quaternion)
        for offsets in ("pair_offsets", "offsets"):
            places = [getattr(legs, offsets)(quaternion, joint_pos) for legs in (compiled, by_mujoco)]
            assert places[0] == pytest.approx(places[1], abs=1e-12)
        torques = [legs.torque(quaternion, joint_pos, force) for legs in (compiled, by_mujoco)]
        assert torques[0] == pytest.approx(torques[1], abs=1e-9)


def test_planar_state_feet_and_torques_are_those_of_the_frame(robot: Robot) -> None:
    by_mujoco, compiled = LegKinematics(robot), CompiledLegs(robot)
    frame = StartFrame(0.4, -0.3, 0.9, 0.05)
    seen = estimate(0.0, np.array([0.3, 0.25, -0.2, 0.5, -0.4, 0.7]), yaw=0.8)
    for of_frame, found in zip(by_mujoco.planar(seen, frame), compiled.planar(seen, frame), strict=True):
        assert found == pytest.approx(of_frame, abs=1e-12)
    pose, force = (seen.base_quaternion, seen.joint_pos), np.array([10.0, 50.0, -20.0, 80.0])
    expected = by_mujoco.torque(*pose, frame.in_world(force))
    assert compiled.planar_torque(*pose, force, frame) == pytest.approx(expected, abs=1e-9)


def test_arrays_of_any_layout_are_taken(robot: Robot) -> None:
    """A strided or read-only view must not be compiled for anew during a jump."""
    legs, wide = CompiledLegs(robot), np.random.default_rng(5).normal(size=(12, 3))
    seen = estimate(0.0, np.zeros(6))
    strided = replace(seen, joint_pos=wide[:, 1])
    strided.joint_pos.flags.writeable = False
    before = compilations()
    found = legs.planar(strided, StartFrame(0.0, 0.0, 0.0))
    expected = LegKinematics(robot).planar(strided, StartFrame(0.0, 0.0, 0.0))
    assert found[1] == pytest.approx(expected[1], abs=1e-12)
    assert compilations() == before


def compilations() -> int:
    """How many versions of the compiled functions there are; 0 without numba."""
    called = (
        leg_kinematics.follow_chains,
        leg_kinematics.measure_plane,
        compiled_planner.solve_update,
        inference.add_up,
    )
    return sum(len(getattr(function, "signatures", ())) for function in called)


# The controller.


@pytest.mark.skipif(not compiler.AVAILABLE, reason="numba is not installed")
def test_commands_of_a_whole_jump_are_those_of_the_controller_without_compiler(reference: Log, robot: Robot) -> None:
    plan = Reference.of(reference, robot)
    model, rng = learned((16,), (16, 16)), np.random.default_rng(6)
    controllers = [JumpMpc(plan, robot, PhaseGains(), model, MpcConfig(compiled=c)) for c in (False, True)]
    before = compilations()
    for tick in range(0, 1250):
        row = plan.row(tick / 1000)
        off = NOISE * rng.normal(size=6) * (tick > 0)
        seen = estimate(tick / 1000, plan.state[row] + off, plan.joint_pos[row], yaw=0.3)
        exact, compiled = (controller.command(seen) for controller in controllers)
        assert compiled.planned_force == pytest.approx(exact.planned_force, abs=1e-3)
        assert compiled.torque == pytest.approx(exact.torque, abs=1e-3)
        assert (compiled.position == exact.position).all()
    assert compilations() == before, "something was compiled during the jump"
    assert not controllers[1].fallbacks


def test_without_numba_a_compiled_controller_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "AVAILABLE", False)
    monkeypatch.setattr(compiled_planner, "require_compiler", compiler.require_compiler)
    message = r"mpc\.compiled: found no numba; expected the extra `compiled`; pip install 'leapgap\[compiled\]'"
    with pytest.raises(InputError, match=message):
        CompiledPlanner(REFERENCE, MODEL, MpcConfig(compiled=True))


# What goes wrong, and what is sent then.


class Distorted(PredictionModel):
    """The nominal model, its answers for a single moment of the jump (those online) multiplied."""

    def __init__(self) -> None:
        self.factor = 1.0

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        said = MODEL.affine(situation, contact)
        return AffineModel(said.bias, said.by_force * self.factor) if len(contact) == 1 else said


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers overflow, as they should here
@pytest.mark.parametrize(("factor", "reasons"), [(np.nan, {NOT_FINITE}), (1e200, {"inaccurate", FAILED, NOT_FINITE})])
def test_without_a_solution_the_reference_is_sent_and_the_reason_counted(factor: float, reasons: set[str]) -> None:
    model, row = Distorted(), REFERENCE.row(0.2)
    planner = CompiledPlanner(REFERENCE, model, MpcConfig())
    model.factor = factor
    plan = planner.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    assert plan.fallback in reasons
    assert planner.fallbacks == {plan.fallback: 1}
    assert plan.force[0] == pytest.approx(REFERENCE.force[row])


@pytest.mark.parametrize("where", ["state", "foot"])
@pytest.mark.parametrize("entry", range(4))
def test_a_measurement_that_is_no_number_goes_on_with_the_last_plan_shifted(where: str, entry: int) -> None:
    planner, row = CompiledPlanner(REFERENCE, MODEL, MpcConfig()), REFERENCE.row(0.2)
    good = planner.plan(0.2, REFERENCE.state[row] + 0.02, REFERENCE.foot[row])
    bad = {"state": REFERENCE.state[row].copy(), "foot": REFERENCE.foot[row].copy()}
    bad[where][entry] = np.nan
    plan = planner.plan(0.225, **bad)
    assert plan.fallback == NOT_FINITE
    assert plan.force[0] == pytest.approx(good.force[1])


class Footless(PredictionModel):
    """A model that does not depend on the feet."""

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        return MODEL.affine(replace(situation, foot=np.tile(REFERENCE.foot[0], (len(contact), 1))), contact)


def test_feet_that_are_no_numbers_count_for_a_model_without_feet_too() -> None:
    """As in the planner without compiler: what was not measured decides no force."""
    row = REFERENCE.row(0.2)
    for kind in (ForcePlanner, CompiledPlanner):
        planner = kind(REFERENCE, Footless(), MpcConfig())
        assert planner.plan(0.2, REFERENCE.state[row], REFERENCE.foot[row] * np.nan).fallback == NOT_FINITE


def test_too_few_iterations_are_no_solution() -> None:
    config = MpcConfig()
    config, row = replace(config, qp=replace(config.qp, max_iterations=1)), REFERENCE.row(0.3)
    plan = CompiledPlanner(REFERENCE, MODEL, config).plan(0.3, REFERENCE.state[row] + 10 * NOISE, REFERENCE.foot[row])
    assert plan.fallback == FAILED
