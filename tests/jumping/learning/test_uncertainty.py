"""Expected errors: the kernel's posterior against its definition, and coverage of held-out jumps."""

from dataclasses import replace

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.stats import norm

from leapgap.jumping.learning import uncertainty
from leapgap.jumping.learning.experiment import folds
from leapgap.jumping.learning.models import kernel
from leapgap.jumping.learning.models.kernel import KernelConfig, KernelModel
from leapgap.jumping.learning.models.nominal import fit_gains
from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.rigid_body import FEATURES
from stages.compose import compose_conf
from tests.conftest import A1_BODY

NAMES = [name for name in FEATURES if name not in ("x_from_start", "z_from_start")]
CONFIG = KernelConfig(inputs=dict.fromkeys(NAMES, 0.5))


def fit_kernel(windows: Windows, config: KernelConfig = CONFIG) -> KernelModel:
    return kernel.fit(windows, fit_gains(windows, A1_BODY), config)


def test_the_posterior_is_that_of_a_gaussian_process(windows: Windows):
    """At a training step: λ + λ (K (K + λ I)⁻¹)ᵢᵢ, from the eigenvalues; far from all data: 1 + u² + λ."""
    model = fit_kernel(windows)
    part = model.contact
    assert part is not None
    mine = uncertainty.kernel_posterior(model, CONFIG)
    gram = kernel.gauss(part.inputs, part.inputs) * (1 + part.forces @ part.forces.T)
    values, vectors = np.linalg.eigh(gram)
    ridge = CONFIG.ridge_contact
    smooth = ((vectors * (values / (values + ridge))) @ vectors.T).diagonal()

    first = windows.start == 5
    situation = kernel.Situation(
        windows.state[first, 0], windows.foot[first, 0], windows.time_s[first, 0], windows.state[first, 0]
    )
    at = np.stack(kernel.columns(model.names, situation), axis=-1)
    which = [
        int(np.argmin(((part.inputs - row) ** 2).sum(axis=1))) for row in (at - part.input_mean) / part.input_scale
    ]
    found = uncertainty.posterior_variance(mine, "contact", part, situation, windows.force[first, 0])
    np.testing.assert_allclose(found, ridge + ridge * smooth[which], atol=1e-9)

    far = replace(situation, state=situation.state + 1e3)
    u = (windows.force[first, 0] - part.force_mean) / part.force_scale
    found = uncertainty.posterior_variance(mine, "contact", part, far, windows.force[first, 0])
    np.testing.assert_allclose(found, 1 + (u**2).sum(axis=1) + ridge)


def test_unfamiliar_windows_are_expected_to_err_more(windows: Windows, tmp_path):
    found = uncertainty.fit(windows, fit_kernel, CONFIG)
    uncertainty.save(found, tmp_path / "spread.npz")
    back = uncertainty.load(tmp_path / "spread.npz", found.kernel)
    inputs = windows.inputs
    usual = found.deviation(inputs)
    assert usual.shape == (len(windows), 10, 6) and (usual > 0).all()
    np.testing.assert_array_equal(back.deviation(inputs), usual)
    odd = replace(inputs, state=inputs.state + np.array([0, 0, 2.0, 0, 0, 5.0]))
    assert (found.deviation(odd)[inputs.contact[:, 0], 0] > usual[inputs.contact[:, 0], 0]).all()


def test_the_closed_form_without_a_jump_is_the_solution_without_its_steps(windows: Windows):
    """At the scalings of all jumps: weights and inverse by a solve over the other jumps' steps alone."""
    model = fit_kernel(windows)
    mine = uncertainty.without_jump(uncertainty.kernel_posterior(model, CONFIG), windows, 2)
    for phase, ridge in (("contact", CONFIG.ridge_contact), ("flight", CONFIG.ridge_flight)):
        part, found = getattr(model, phase), getattr(mine.kernel, phase)
        steps_a_jump = len(part.inputs) // 6
        others = np.arange(len(part.inputs)) // steps_a_jump != 2
        gram = kernel.gauss(part.inputs, part.inputs) * (1 + part.forces @ part.forces.T) + ridge * np.eye(len(others))
        residual = (gram @ part.weights)[others]
        small = gram[np.ix_(others, others)]
        np.testing.assert_allclose(mine.inverse[phase], np.linalg.inv(small), rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(found.weights, np.linalg.solve(small, residual), rtol=1e-7, atol=1e-6)
        np.testing.assert_array_equal(found.inputs, part.inputs[others])


def test_many_jumps_are_left_out_without_a_fit_for_each_and_give_about_the_same(
    windows: Windows, monkeypatch: pytest.MonkeyPatch
):
    fits = []

    def counted(some: Windows) -> KernelModel:
        fits.append(some.jumps)
        return fit_kernel(some)

    anew = uncertainty.fit(windows, counted, CONFIG)
    assert len(fits) == 7
    monkeypatch.setattr(uncertainty, "MOST_REFITS", 5)
    closed = uncertainty.fit(windows, counted, CONFIG)
    assert len(fits) == 8
    ratio = closed.deviation(windows.inputs) / anew.deviation(windows.inputs)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


def test_a_kernel_of_more_steps_than_it_can_have_is_fitted_to_some_of_each_jump(
    windows: Windows, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(kernel, "MOST_STEPS", 48)
    kept = kernel.training_steps(windows, pushing=True)
    assert len(kept.step) == 48
    assert np.bincount(kept.jump).tolist() == [8] * 6
    assert fit_kernel(windows).contact.weights.shape == (48, 3)


def test_intervals_on_real_jumps_hold_what_they_say(real_windows: Windows):
    """Deviations from training jumps only; shares within 8 points of 50, 80 and 95 % over the folds."""
    train = OmegaConf.create(compose_conf()).train
    config: KernelConfig = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(KernelConfig), train.kernel))
    off = []
    for split in folds(real_windows.jumps, 4):
        mine, held_out = (real_windows.of_jumps(part) for part in (split.train, split.held_out))
        found = uncertainty.fit(mine, lambda windows: fit_kernel(windows, config), config)
        error = found.kernel.predict(held_out.inputs)[:, 1:] - held_out.state[:, 1:]
        off.append(np.abs(error) / found.deviation(held_out.inputs))
    for level in (0.5, 0.8, 0.95):
        assert (np.concatenate(off) < norm.ppf(0.5 + level / 2)).mean() == pytest.approx(level, abs=0.08)


def test_few_jumps_need_wider_intervals():
    """Normal errors: variances of three jumps are so uncertain that intervals must widen; of many, hardly."""
    random = np.random.default_rng(0)
    unfamiliar = np.ones((60, 8, 5))
    few, many = (uncertainty.widening_factor(random.normal(size=(n, 8, 5, 6)) ** 2, unfamiliar[:n]) for n in (3, 60))
    assert many == pytest.approx(1.0, abs=0.03) and 1.1 < few < 2.0
