"""How far off predictions will be: standard deviations of the predicted states, from the training jumps alone.

The kernel is closed-form, so it can leave out each training jump in turn and look at its errors there. Their mean
square by start of the window, step and component is how large errors are; the kernel's posterior variance, summed
along the roll-out, says by how much a situation is less familiar than those were. Networks trained on the same jumps
err alike, so the same deviations serve them; coverage on held-out jumps is judged for each model in ``evaluation``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.model_files import check_finite, read_npz, write_npz
from leapgap.jumping.learning.models.kernel import PHASES, KernelConfig, KernelModel, KernelPart, gauss, training_steps
from leapgap.jumping.learning.windows import RolloutInputs, Windows, spread_evenly
from leapgap.jumping.models.rigid_body import Situation, columns

LEVELS = (0.5, 0.8, 0.95)  # Of the intervals whose width is fitted and whose coverage is checked
MOST_REFITS, MOST_LEFT_OUT = 24, 64
"""Number of training jumps up to which the kernel is fitted again without each, and largest number left out in turn."""
SMOOTHING_STEPS = 1.0  # Errors of neighbouring starts are averaged with such a Gaussian: a dozen jumps give few


@dataclass(frozen=True)
class PredictionUncertainty:
    """Deviations of the predictions of one kernel, and of models like it."""

    kernel: KernelModel
    inverse: dict[str, np.ndarray]  # (K + λ I)⁻¹ of each phase, (n, n)
    ridge: dict[str, float]
    variance: np.ndarray  # Mean squared error on training jumps left out, widened, (starts, K, 6)
    familiar: np.ndarray  # Mean summed posterior variance there, in units of the signal's, (starts, K)

    def deviation(self, inputs: RolloutInputs) -> np.ndarray:
        """Standard deviation of each predicted state after the first, (W, K, 6), in the state's units."""
        unfamiliar = accumulate_variance(self, inputs) / self.familiar[inputs.start]
        return np.sqrt(self.variance[inputs.start] * unfamiliar[..., None])


def kernel_posterior(model: KernelModel, config: KernelConfig) -> PredictionUncertainty:
    """A kernel's posterior, without any errors yet."""
    inverse, ridge = {}, {"contact": config.ridge_contact, "flight": config.ridge_flight}
    for phase, part in (("contact", model.contact), ("flight", model.flight)):
        if part is not None:
            gram = gauss(part.inputs, part.inputs) * (1 + part.forces @ part.forces.T)
            inverse[phase] = np.linalg.inv(gram + ridge[phase] * np.eye(len(gram)))
    return PredictionUncertainty(model, inverse, ridge, np.zeros(0), np.zeros(0))


def accumulate_variance(uncertainty: PredictionUncertainty, inputs: RolloutInputs) -> np.ndarray:
    """Posterior variance of the accelerations, noise included, summed along the kernel's own roll-out, (W, K)."""
    states = uncertainty.kernel.predict(inputs)
    steps = inputs.contact.shape[1]
    found = np.zeros((len(inputs), steps))
    for k in range(steps):
        situation = Situation(states[:, k], np.nan_to_num(inputs.foot[:, k]), inputs.time_s[:, k], inputs.state)
        for phase, mask in (("contact", inputs.contact[:, k]), ("flight", ~inputs.contact[:, k])):
            part = getattr(uncertainty.kernel, phase)
            if part is not None and mask.any():
                force = np.nan_to_num(inputs.force[mask, k])
                found[mask, k] = posterior_variance(uncertainty, phase, part, situation.at(mask), force)
    return np.cumsum(found, axis=1)


def posterior_variance(
    uncertainty: PredictionUncertainty, phase: str, part: KernelPart, situation: Situation, force: np.ndarray
) -> np.ndarray:
    """k(x, x) − kᵀ (K + λ I)⁻¹ k + λ at n moments, (n,), in units of the signal's variance."""
    inputs = (np.stack(columns(uncertainty.kernel.names, situation), axis=-1) - part.input_mean) / part.input_scale
    scaled = (force - part.force_mean) / part.force_scale
    similar = gauss(inputs, part.inputs) * (1 + scaled @ part.forces.T)
    explained = np.einsum("ij,ij->i", similar @ uncertainty.inverse[phase], similar)
    return np.maximum(1 + (scaled**2).sum(axis=1) - explained, 0) + uncertainty.ridge[phase]


def fit(windows: Windows, fit_kernel: Callable[[Windows], KernelModel], config: KernelConfig) -> PredictionUncertainty:
    """Leave training jumps out in turn, all of up to ``MOST_LEFT_OUT``; the jumps must be two or more.

    Up to ``MOST_REFITS`` jumps, the kernel is fitted again without each. With more jumps, one counts for little in the
    scalings and gains, which are kept, and the kernel without it follows in closed form.
    """
    whole = kernel_posterior(fit_kernel(windows), config)
    squared, unfamiliar = [], []
    for jump in [windows.jumps[i] for i in spread_evenly(len(windows.jumps), MOST_LEFT_OUT)]:
        left_out = windows.of_jumps([jump])
        if len(windows.jumps) <= MOST_REFITS:
            one = kernel_posterior(
                fit_kernel(windows.of_jumps([other for other in windows.jumps if other != jump])), config
            )
        else:
            one = without_jump(whole, windows, windows.jumps.index(jump))
        squared.append((one.kernel.predict(left_out.inputs) - left_out.state)[:, 1:] ** 2)
        unfamiliar.append(accumulate_variance(one, left_out.inputs))
    variance, familiar = np.array(squared), np.array(unfamiliar)
    widened = smooth_mean(variance) * widening_factor(variance, familiar) ** 2
    return PredictionUncertainty(whole.kernel, whole.inverse, whole.ridge, widened, familiar.mean(axis=0))


def without_jump(whole: PredictionUncertainty, windows: Windows, jump: int) -> PredictionUncertainty:
    """A kernel's posterior without the training steps of one jump, at the same scalings and gains.

    With A = (K + λ I)⁻¹, weights a = A y, and b for the jump's steps and o for the others, block inversion gives
    A without b as A_oo − A_ob A_bb⁻¹ A_bo, and the weights as a_o − A_ob A_bb⁻¹ a_b.
    """
    parts: dict[str, KernelPart | None] = {}
    inverse: dict[str, np.ndarray] = {}
    for phase, pushing in PHASES.items():
        part: KernelPart | None = getattr(whole.kernel, phase)
        own = training_steps(windows, pushing).jump == jump
        if part is None or own.all():
            parts[phase] = None
            continue
        every = whole.inverse[phase]
        across = every[np.ix_(~own, own)]
        share = np.linalg.solve(every[np.ix_(own, own)], np.column_stack([across.T, part.weights[own]]))
        parts[phase] = replace(
            part,
            inputs=part.inputs[~own],
            forces=part.forces[~own],
            weights=part.weights[~own] - across @ share[:, across.shape[0] :],
        )
        inverse[phase] = every[np.ix_(~own, ~own)] - across @ share[:, : across.shape[0]]
    kernel = replace(whole.kernel, contact=parts["contact"], flight=parts["flight"])
    return replace(whole, kernel=kernel, inverse=inverse)


def smooth_mean(squared: np.ndarray) -> np.ndarray:
    """Mean over jumps (J, starts, K, 6), smoothed over neighbouring starts."""
    from scipy.ndimage import gaussian_filter1d  # most processes read this file and learn no uncertainty

    return gaussian_filter1d(squared.mean(axis=0), SMOOTHING_STEPS, axis=0, mode="nearest")


def widening_factor(squared: np.ndarray, unfamiliar: np.ndarray) -> float:
    """By how much intervals must be wider than normal ones, since a mean over few jumps is itself uncertain.

    Each training jump is judged by the deviations learned from the others; the factor is what makes the quantiles of
    the standardised errors those of the normal distribution, mean of three levels.
    """
    from scipy.special import ndtri

    standardised = []
    for j in range(len(squared)) if len(squared) > 2 else ():
        others = np.arange(len(squared)) != j
        expected = smooth_mean(squared[others]) * (unfamiliar[j] / unfamiliar[others].mean(axis=0))[..., None]
        known = expected > 0
        standardised.append(np.sqrt(squared[j][known] / expected[known]))
    if not standardised or not sum(map(len, standardised)):
        return 1.0
    found = np.quantile(np.concatenate(standardised), LEVELS)
    return float(np.mean(found / ndtri(0.5 + np.array(LEVELS) / 2)))


def save(uncertainty: PredictionUncertainty, path: Path) -> None:
    """Write the deviations, not the kernel: that is stored as a model."""
    ridge = np.array([uncertainty.ridge["contact"], uncertainty.ridge["flight"]])
    write_npz(path, {"variance": uncertainty.variance, "familiar": uncertainty.familiar, "ridge": ridge})


def load(path: Path, kernel: KernelModel) -> PredictionUncertainty:
    """Read back, beside the kernel it is of."""
    arrays = read_npz(path)
    check_finite(arrays, path, "run stages.train again")
    if {name: array.ndim for name, array in arrays.items()} != {"variance": 3, "familiar": 2, "ridge": 1}:
        raise InputError(path, f"arrays {', '.join(arrays)}", "variance, familiar and ridge", "run stages.train again")
    config = KernelConfig(ridge_contact=float(arrays["ridge"][0]), ridge_flight=float(arrays["ridge"][1]))
    bare = kernel_posterior(kernel, config)
    return PredictionUncertainty(kernel, bare.inverse, bare.ridge, arrays["variance"], arrays["familiar"])
