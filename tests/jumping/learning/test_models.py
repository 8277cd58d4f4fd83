"""Roll-outs, baselines and the kernel."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning.experiment import folds, sessions
from leapgap.jumping.learning.model import Nominal, ResidualModel, squared_errors
from leapgap.jumping.learning.models import kernel
from leapgap.jumping.learning.models.kernel import KernelConfig
from leapgap.jumping.learning.models.nominal import ConstantVelocity, NominalModel, Playback, fit_gains
from leapgap.jumping.learning.windows import RolloutInputs, Windows, extract_transitions
from leapgap.jumping.models.rigid_body import FEATURES, AffineModel, RigidBody, Situation
from tests.conftest import A1_BODY
from tests.jumping.learning.conftest import TRUE_GAINS

NAMES = [name for name in FEATURES if name not in ("x_from_start", "z_from_start")]


def error(model, windows) -> float:
    return float(squared_errors(model.predict(windows.inputs), windows).mean())


def test_a_roll_out_computed_by_hand():
    """One contact step of 25 ms and one flight step of 100 ms, with a residual h + G u."""

    class ByHand(ResidualModel):
        nominal = Nominal(RigidBody(10.0, 0.5), (1.0, 1.0, 2.0))

        def residual(self, situation, contact):
            bias = np.where(contact[:, None], [1.0, 0.0, -2.0], [0.0, 3.0, 0.0])
            by_force = np.zeros((len(contact), 3, 4))
            by_force[contact, 0, 1] = 0.01
            return AffineModel(bias, by_force)

        @classmethod
        def from_parts(cls, arrays, settings):
            return cls()

    inputs = RolloutInputs(
        state=np.array([[0.0, 0.3, 0.1, 1.0, 2.0, 0.5]]),
        force=np.array([[[10.0, 100, 0, 0], [0, 0, 0, 0]]]),
        foot=np.array([[[0.2, -0.3, -0.2, -0.3]] * 2]),
        contact=np.array([[True, False]]),
        time_s=np.array([[0.775, 0.8]]),
        step_s=np.array([[0.025, 0.1]]),
        start=np.array([31]),
    )
    spin = 2 * (-0.3 * 10 - 0.2 * 100) / 0.5 - 2  # gain · moment / J + h = -94
    vx, vz, rate = 1 + 0.025 * (1 + 1 + 0.01 * 100), 2 + 0.025 * (10 - 9.81), 0.5 + 0.025 * spin
    first = [0.025, 0.3 + 0.05, 0.1 + 0.0125, vx, vz, rate]
    second = [0.025 + 0.1 * vx, 0.35 + 0.1 * vz, 0.1125 + 0.1 * rate, vx, vz + 0.1 * (3 - 9.81), rate]
    np.testing.assert_allclose(ByHand().predict(inputs)[0], [inputs.state[0], first, second], rtol=1e-12)


def test_fitted_gains_are_the_true_ones(windows: Windows):
    """The synthetic jumps obey the nominal body with known gains, so the fit and its roll-out are exact."""
    nominal = fit_gains(windows, A1_BODY)
    np.testing.assert_allclose(nominal.gains, TRUE_GAINS, rtol=1e-6)
    assert error(NominalModel(nominal), windows) < 1e-12 < error(NominalModel(Nominal(A1_BODY)), windows)


def test_playback_of_one_jump_repeats_it(windows: Windows):
    one = windows.of_jumps(["jump_03"])
    assert error(Playback.fit(one), one) < 1e-24


def test_constant_velocity_is_exact_for_nothing_but_constant_velocity(windows: Windows):
    found = ConstantVelocity().predict(windows.inputs)
    np.testing.assert_allclose(np.diff(found[..., 3:], axis=1), 0)
    np.testing.assert_allclose(np.diff(found[..., :3], axis=1), windows.inputs.step_s[..., None] * found[:, :-1, 3:])


def test_each_measured_step_is_taken_once(windows: Windows):
    steps = extract_transitions(windows)
    assert len(steps.step) == 36 * len(windows.jumps)
    np.testing.assert_array_equal(np.bincount(steps.step), np.full(36, len(windows.jumps)))


@pytest.fixture(scope="module")
def fitted(windows: Windows) -> kernel.KernelModel:
    return kernel.fit(windows, Nominal(A1_BODY), KernelConfig(inputs=dict.fromkeys(NAMES, 1.0), ridge_contact=1e-6))


def test_the_kernel_learns_what_the_nominal_body_lacks(fitted, windows: Windows):
    assert error(fitted, windows) < 0.01 * error(NominalModel(fitted.nominal), windows)


def test_the_kernel_solves_its_ridge_problem(windows: Windows):
    """At the training steps, prediction + ridge · weights = target: the normal equations of kernel ridge."""
    config = KernelConfig(inputs=dict.fromkeys(NAMES, 1.0), ridge_contact=0.3)
    nominal = Nominal(A1_BODY)
    model, steps = kernel.fit(windows, nominal, config), extract_transitions(windows)
    steps = steps.at(steps.contact)
    predicted = model.affine(steps.situation, steps.contact).acceleration(steps.force)
    assert model.contact is not None
    np.testing.assert_allclose(predicted + 0.3 * model.contact.weights, steps.acceleration, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_force_coefficients_are_the_slopes_of_the_prediction(fitted, windows: Windows, seed):
    """By finite differences of one whole step, and h + G u is affine exactly, far from the data too."""
    random = np.random.default_rng(seed)
    inputs = windows.inputs
    situation = Situation(inputs.state, inputs.foot[:, 0], inputs.time_s[:, 0], inputs.state)
    terms = fitted.affine(situation, inputs.contact[:, 0])
    force, other = random.normal(0, 100, (2, len(inputs), 4))
    slope = terms.acceleration(force + other) - terms.acceleration(force)
    np.testing.assert_allclose(slope, np.einsum("nij,nj->ni", terms.by_force, other), rtol=1e-6, atol=1e-6)

    def next_velocity(first_force: np.ndarray) -> np.ndarray:
        pushed = inputs.force.copy()
        pushed[:, 0] = first_force
        return fitted.predict(replace(inputs, force=pushed))[:, 1, 3:]

    for i in range(4):
        bump = 1e-2 * np.eye(4)[i]
        slope = (next_velocity(force + bump) - next_velocity(force - bump)) / 2e-2
        np.testing.assert_allclose(slope, inputs.step_s[:, :1] * terms.by_force[..., i], atol=1e-8)


def test_predictions_move_with_the_jump(fitted, windows: Windows):
    """A shift in x shifts the path and changes nothing else."""
    shift = np.array([2.0, 0, 0, 0, 0, 0])
    shifted = replace(windows.inputs, state=windows.inputs.state + shift)
    for model in (fitted, ConstantVelocity(), Playback.fit(windows)):
        np.testing.assert_allclose(model.predict(shifted), model.predict(windows.inputs) + shift, atol=1e-9)


def test_a_forecast_looks_at_nothing_measured_later(windows: Windows):
    model = kernel.fit_forecast(windows, KernelConfig(inputs=dict.fromkeys(NAMES, 1.0)))
    known, all_of_it = windows.inputs.without_measured_future, windows.inputs
    assert np.isnan(known.force[:, 1:]).all() and np.isnan(known.foot[:, 1:]).all()
    np.testing.assert_array_equal(model.predict(known), model.predict(all_of_it))


def test_an_unknown_input_is_named(windows: Windows):
    with pytest.raises(InputError, match="inputs yaw; expected some of x_from_start, z_from_start, z, pitch"):
        kernel.fit(windows, Nominal(A1_BODY), KernelConfig(inputs={"yaw": 1.0}))


def test_folds_take_every_fourth_jump_in_order():
    names = [f"jump_{i:02d}" for i in range(1, 17)]
    found = folds(names, 4)
    assert found[1].held_out == ("jump_02", "jump_06", "jump_10", "jump_14")
    assert all(set(s.train) | set(s.held_out) == set(names) and not set(s.train) & set(s.held_out) for s in found)
    assert sorted(name for s in found for name in s.held_out) == names
    assert folds(names[:1], 4) == []


def test_sessions_hold_out_whole_groups():
    names = ["jump_01", "jump_10", "jump_15"]
    groups = [["jump_0*", "jump_10"], ["jump_1[5-9]"]]
    assert [s.held_out for s in sessions(names, groups)] == [("jump_01", "jump_10"), ("jump_15",)]
    assert sessions(["sim_1", "sim_2"], groups) == [] and sessions(names, []) == []
    assert sessions([*names, "of_no_known_session"], groups) == []
    with pytest.raises(InputError, match="jump_15 in several sessions"):
        sessions(names, [*groups, ["*15"]])


def test_learned_models_beat_their_baselines_on_real_jumps(real_windows: Windows):
    """The kernel at the configured settings is judged in the pipeline; here only that learning is worth it."""
    weights = {"phase": 6.0, "pitch_rate": 0.8} | {name: 0.25 for name in NAMES if name not in ("phase", "pitch_rate")}
    config = KernelConfig(inputs=weights, length_flight=0.6)
    names = {"kernel": [], "nominal": [], "still": [], "playback": []}
    for split in folds(real_windows.jumps, 4):
        train, held_out = (real_windows.of_jumps(part) for part in (split.train, split.held_out))
        names["kernel"].append(error(kernel.fit(train, fit_gains(train, A1_BODY), config), held_out))
        names["nominal"].append(error(NominalModel(fit_gains(train, A1_BODY)), held_out))
        names["still"].append(error(ConstantVelocity(), held_out))
        names["playback"].append(error(Playback.fit(train), held_out))
    found = {name: float(np.mean(errors)) for name, errors in names.items()}
    assert found["kernel"] < 0.035 < found["playback"] < found["still"] < found["nominal"] * 1.2
