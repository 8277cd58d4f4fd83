"""Kernel ridge regression of the residual acceleration, affine in the force, in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from leapgap.jumping.learning.model import Model, Nominal, Part, ResidualModel
from leapgap.jumping.learning.model_files import arrays_below
from leapgap.jumping.learning.models.nominal import fit_gains
from leapgap.jumping.learning.recipe import (
    DeviationRecipe,
    DeviationTask,
    FitTask,
    LearningCurve,
    ModelRecipe,
    ModelSettings,
    configured_inputs,
)
from leapgap.jumping.learning.window_extraction import BALLISTIC_S, DeviatingJump
from leapgap.jumping.learning.windows import (
    RolloutInputs,
    Transitions,
    Windows,
    drop_forces,
    extract_transitions,
    spread_evenly,
)
from leapgap.jumping.models.rigid_body import (
    AffineModel,
    DeviationModel,
    PlannedSteps,
    RigidBody,
    Situation,
    check_names,
    columns,
    selection,
)
from leapgap.logs.pair_force import FORCES, per_axis

MOST_STEPS = 2048  # Largest number of training steps of a phase: 64 jumps of 32 steps in contact
PHASES = {"contact": True, "flight": False}


INPUTS = {
    **{"z": 0.2, "pitch": 0.2, "vx": 0.15, "vz": 0.15, "pitch_rate": 0.8},
    **{"front_foot_x": 0.4, "front_foot_z": 0.4, "rear_foot_x": 0.4, "rear_foot_z": 0.4, "phase": 6.0},
}
"""Of the kernel model, chosen by cross-validation over jumps of one contact schedule."""


@dataclass
class KernelConfig(ModelSettings):
    """How smooth the kernel model is. Lengths are in weighted standard deviations of the training inputs."""

    section: ClassVar[str] = "kernel"
    inputs: dict[str, float] = field(default_factory=lambda: dict(INPUTS))
    """Inputs, each with its weight after scaling to unit variance: a large weight lets the model change fast."""
    force_scale: float = 8.0  # Standard deviations of a force that count like the constant: large trusts B(r)
    length_contact: float = 1.0
    length_flight: float = 0.6
    ridge_contact: float = 0.02
    ridge_flight: float = 0.3  # Noise variance over signal variance, per training step

    def __post_init__(self) -> None:
        for name in ("length_contact", "length_flight", "ridge_contact", "ridge_flight"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name)}: above 0")
        if not self.force_scale > 0 or not all(0 < weight < np.inf for weight in self.inputs.values()):
            raise ValueError("force_scale and the weights of the inputs: above 0")


@dataclass(frozen=True)
class KernelPart:
    """The fit of one phase: n training steps, f inputs."""

    input_mean: np.ndarray  # Mean of the raw training inputs, (f,)
    input_scale: np.ndarray  # Divides the inputs: standard deviation over weight, length and √f, (f,)
    force_mean: np.ndarray  # Mean of the training forces, (4,), N
    force_scale: np.ndarray  # Divides the forces after their mean is taken off, (4,), N
    inputs: np.ndarray  # Scaled training inputs, (n, f)
    forces: np.ndarray  # Scaled training forces, (n, 4)
    weights: np.ndarray  # Of the training steps, in accelerations, (n, 3)
    mean: np.ndarray  # Mean training residual, (3,)

    def at(self, inputs: np.ndarray) -> AffineModel:
        """h and G at scaled inputs (m, f).

        With k((x, u), (x', u')) = exp(−‖x − x'‖²/2) (1 + ũ·ũ'), ũ = (u − mean) / scale, the prediction Σ k a is
        affine in u: the coefficient of each force is Σ exp(…) ũ' a / scale.
        """
        similar = gauss(inputs, self.inputs)
        by_scaled_force = np.einsum("mn,nj,ni->mij", similar, self.forces, self.weights, optimize=True)
        by_force = by_scaled_force / self.force_scale
        return AffineModel(self.mean + similar @ self.weights - by_force @ self.force_mean, by_force)


def gauss(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """exp(−‖a_i − b_j‖²/2), shape (len(a), len(b))."""
    squared = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.exp(-np.maximum(squared, 0) / 2)


@dataclass(frozen=True)
class KernelModel(ResidualModel):
    """Residual h(x) + G(x) u by kernel ridge, separate for contact and flight."""

    kind: ClassVar[str] = "kernel"
    nominal: Nominal
    names: tuple[str, ...]
    contact: KernelPart | None
    flight: KernelPart | None

    def residual_in(self, phase: str, situation: Situation) -> AffineModel | None:
        """h and G; a phase that had no training step has none."""
        part: KernelPart | None = getattr(self, phase)
        if part is None:
            return None
        return part.at((np.stack(columns(self.names, situation), axis=-1) - part.input_mean) / part.input_scale)

    def flat_residual(self, phase: str) -> tuple[np.ndarray, tuple[Part, ...]]:
        """The mean training residual and one kernel; a phase that had no training step has none."""
        part: KernelPart | None = getattr(self, phase)
        return (np.zeros(3), ()) if part is None else (part.mean, (flatten_kernel(self.names, part),))

    def arrays(self) -> dict[str, np.ndarray]:
        """The parts' arrays, as ``contact/weights``."""
        parts = {"contact": self.contact, "flight": self.flight}
        return {f"{phase}/{name}": value for phase, part in parts.items() if part for name, value in vars(part).items()}

    def settings(self) -> dict[str, Any]:
        """What ``from_parts`` needs beside the arrays."""
        return {"nominal": self.nominal.to_json(), "inputs": list(self.names)}

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "KernelModel":
        """The model of stored parts."""
        found = {phase: arrays_below(arrays, phase) for phase in PHASES}
        parts = {phase: KernelPart(**mine) if mine else None for phase, mine in found.items()}
        return cls(Nominal.from_json(settings["nominal"]), tuple(settings["inputs"]), **parts)


def flatten_kernel(names: tuple[str, ...], part: KernelPart) -> Part:
    """h and G as coefficients of the same similarities."""
    by_force = part.weights[:, :, None] * (part.forces / part.force_scale)[:, None, :]
    bias = part.weights - by_force @ part.force_mean
    return Part(
        "kernel",
        {
            "select": selection(names) / part.input_scale,
            "shift": part.input_mean / part.input_scale,
            "centres": part.inputs,
            "coefficients": np.concatenate([bias, by_force.reshape(len(bias), 12)], axis=1),
        },
    )


@dataclass(frozen=True)
class KernelForecast(KernelModel):
    """Predicts from the first state and the phase alone; measured feet and forces are not looked at."""

    kind: ClassVar[str] = "kernel_forecast"
    infinite: ClassVar[tuple[str, ...]] = ("force_scale",)

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        """States from the first one and the phase; forces and feet of ``inputs`` are dropped."""
        return super().predict(drop_forces(inputs))


def fit_forecast(windows: Windows, config: KernelConfig, curvature: float = 0.0) -> KernelForecast:
    """Fit whole accelerations to state and phase: h alone, no G, no nominal body under it."""
    kept = configured_inputs(config.inputs, uses_phase=True, uses_feet=False)
    nothing = Nominal(RigidBody(mass_kg=np.inf, pitch_inertia_kgm2=np.inf), curvature=curvature)
    fitted = fit(windows, nothing, replace(config, inputs=kept, force_scale=np.inf))
    return KernelForecast(fitted.nominal, fitted.names, fitted.contact, fitted.flight)


def fit(windows: Windows, nominal: Nominal, config: KernelConfig) -> KernelModel:
    """Fit the residual of the nominal body to the measured steps of some windows."""
    names = tuple(config.inputs)
    check_names(names, "train.kernel.inputs")
    parts = {}
    for phase, pushing in PHASES.items():
        mine = training_steps(windows, pushing)
        parts[phase] = fit_part(mine, nominal, config, pushing) if len(mine.step) else None
    return KernelModel(nominal, names, **parts)


def training_steps(windows: Windows, pushing: bool) -> Transitions:
    """The steps of contact or flight that a kernel is fitted to: all, or ``MOST_STEPS`` spread evenly over them.

    Time grows with the third power of their number, and memory with its square.
    """
    steps = extract_transitions(windows)
    mine = np.flatnonzero(steps.contact == pushing)
    return steps.at(mine[spread_evenly(len(mine), MOST_STEPS)])


def fit_part(steps: Transitions, nominal: Nominal, config: KernelConfig, pushing: bool) -> KernelPart:
    """One phase in closed form: (K + λ σ² I) a = y, one output a velocity row."""
    length = config.length_contact if pushing else config.length_flight
    ridge = config.ridge_contact if pushing else config.ridge_flight
    raw = np.stack(columns(tuple(config.inputs), steps.situation), axis=-1)
    input_mean = raw.mean(axis=0)
    weight = np.array(list(config.inputs.values()))
    input_scale = (raw.std(axis=0) + 1e-9) / weight * length * np.sqrt(len(weight))
    force_mean = steps.force.mean(axis=0)
    force_scale = (steps.force.std(axis=0) + 1e-9) * config.force_scale if pushing else np.ones(4)
    inputs, forces = (raw - input_mean) / input_scale, (steps.force - force_mean) / force_scale
    residual = steps.acceleration - nominal.at(steps.situation.foot).acceleration(steps.force)
    mean = residual.mean(axis=0)
    gram = gauss(inputs, inputs) * (1 + forces @ forces.T)
    weights = np.linalg.solve(gram + ridge * np.eye(len(gram)), residual - mean)
    return KernelPart(input_mean, input_scale, force_mean, force_scale, inputs, forces, weights, mean)


class KernelRecipe(ModelRecipe):
    """Kernel ridge on the residual of the body with fitted gains."""

    name = "kernel"
    model = KernelModel
    settings = KernelConfig
    colour = "#14804a"
    uncertainty_from = "kernel"
    uncertainty_file = "spread"
    uses_phase: ClassVar[bool] = True  # Whether the phase of the jump stays among the configured inputs

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Solve for the weights of the training steps."""
        config = task.settings(KernelConfig)
        config = replace(config, inputs=configured_inputs(config.inputs, self.uses_phase))
        return fit(task.train, fit_gains(task.train, task.body, task.curvature), config), []


class KernelWithoutPhaseRecipe(KernelRecipe):
    """The same for any contact schedule."""

    name = "kernel_no_phase"
    colour = "#7fc4a0"
    uncertainty_from = "kernel_no_phase"
    uncertainty_file = "spread_no_phase"
    uses_phase = False


class KernelForecastRecipe(ModelRecipe):
    """Kernel ridge from the first state and the phase; what acts later is not known to it."""

    name = "kernel_forecast"
    model = KernelForecast
    settings = KernelConfig
    colour = "#b5dec7"
    is_forecast = True
    can_be_exported = False
    forecast_name = "kernel"
    uncertainty_from = "kernel_forecast"
    uncertainty_file = "spread_forecast"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        """Fit without feet and forces among the inputs."""
        return fit_forecast(task.train, task.settings(KernelConfig), task.curvature), []


REGRESSORS = 1 + 6 + FORCES  # What h, C and G multiply: 1, the errors and the forces


@dataclass
class DeviationKernelConfig(ModelSettings):
    """How smoothly h, C and G change with phase, target and stance, and how large they may be."""

    section: ClassVar[str] = "deviation_kernel"
    phase_s: float = 0.05
    target_m: float = 0.3
    stance_rad: float = 0.15
    ridge: float = 0.1  # Noise variance over the variance of h, per step of weight 1
    error_unit: list[float] = field(default_factory=lambda: [0.02, 0.02, 0.05, 0.1, 0.1, 0.4])
    """Deviations whose effects are as large as h, m, rad, s."""
    force_unit_n: float = 40.0  # Deviation of a force whose effect is as large as h
    own_h: float = 1.0
    """Variance of the h that the robot has beside that of the simulated jumps, over the variance of h; C and G are
    shared."""

    def __post_init__(self) -> None:
        positive = (*self.scale, self.ridge, self.force_unit_n, *self.error_unit)
        if not (all(0 < one < np.inf for one in positive) and 0 <= self.own_h < np.inf):
            raise ValueError("deviation_kernel: all above 0, own_h not below")

    @property
    def scale(self) -> np.ndarray:
        """Divides phase, s, target x and z, m, and stance, rad, (4,)."""
        return np.array([self.phase_s, self.target_m, self.target_m, self.stance_rad])


@dataclass(frozen=True)
class ModePart:
    """The fit of one mode to n steps."""

    place: np.ndarray  # Scaled phase, target and stance of each step, (n, 4)
    weights: np.ndarray  # Of 1, the scaled errors and the scaled forces, for each velocity row: (n, 11 × 3)


@dataclass(frozen=True)
class DeviationKernel(DeviationModel):
    """k((s, w), (s', w')) = exp(−‖s − s'‖²/2) w·w', s of phase, target and stance, w = (1, e, du) in units."""

    body: RigidBody
    scale: np.ndarray  # Divides phase, s, target x and z, m, and stance, rad, (4,)
    unit: np.ndarray  # Of the errors and the forces, (10,)
    modes: dict[str, ModePart]  # By the pairs that push, as in ``mode_of``
    landing_s: float

    def residual(self, steps: PlannedSteps) -> AffineModel:
        """h, G and C by kernel ridge; zero in the last flight step, in which feet touch down."""
        found = np.zeros((len(steps), REGRESSORS, 3))
        modes = mode_of(steps)
        learned = steps.time_s < self.landing_s - BALLISTIC_S - 1e-6
        for name, part in self.modes.items():
            mine = np.flatnonzero((modes == name) & learned)
            if len(mine):
                similar = gauss(places(steps, self.scale)[mine], part.place)
                found[mine] = (similar @ part.weights).reshape(len(mine), REGRESSORS, 3)
        found[:, 1:] /= self.unit[:, None]
        return AffineModel(found[:, 0], found[:, 7:].transpose(0, 2, 1), found[:, 1:7].transpose(0, 2, 1))

    def arrays(self) -> dict[str, np.ndarray]:
        """Units, and by mode the places and the weights."""
        parts = {f"{name}/{key}": value for name, part in self.modes.items() for key, value in vars(part).items()}
        return {"scale": self.scale, "unit": self.unit} | parts


def mode_of(steps: PlannedSteps) -> np.ndarray:
    """Which pairs push at each step, as text: ``both``, ``rear``, ``front`` or ``none``, (n,)."""
    front, rear = np.asarray(steps.pushing).T
    return np.select([front & rear, rear, front], ["both", "rear", "front"], "none")


def places(steps: PlannedSteps, scale: np.ndarray) -> np.ndarray:
    """Scaled phase, target and stance at each step, (n, 4)."""
    plan = np.tile([steps.target.x_m, steps.target.z_m, steps.stance_rad], (len(steps), 1))
    return np.column_stack([steps.time_s, plan]) / scale


def fit_deviation(jumps: Sequence[DeviatingJump], body: RigidBody, config: DeviationKernelConfig) -> DeviationKernel:
    """(K + λ diag(σ² / weight)) a = y for each mode and velocity row; y is what the rigid body leaves of it.

    Where some jumps are simulated, the others have a part of h of their own.
    """
    with_simulated = any(jump.simulated for jump in jumps)
    scale = config.scale
    unit = np.array([*config.error_unit, *[config.force_unit_n] * FORCES])
    landing_s = float(max(jump.steps.end_s[-1] for jump in jumps))
    rows: dict[str, list[tuple[np.ndarray, ...]]] = {}
    for jump in jumps:
        steps = jump.steps
        force = jump.force * per_axis(steps.pushing)
        by_body = np.einsum("nij,nj->ni", body.force_rows(steps.foot), force)
        known = np.concatenate([np.ones((len(steps), 1)), np.hstack([jump.error[:-1], force]) / unit], axis=1)
        own_h = np.full(len(steps), config.own_h if with_simulated and not jump.simulated else 0.0)
        by_weight = np.full(len(steps), jump.weight)
        measured = (places(steps, scale), known, own_h, jump.acceleration - by_body, by_weight)
        modes, learned = mode_of(steps), jump.learned
        for name in np.unique(modes[learned]):
            mine = (modes == name) & learned
            rows.setdefault(str(name), []).append(tuple(values[mine] for values in measured))
    found = {}
    for name, parts in rows.items():
        place, known, own_h, residual, weight = (np.concatenate(one) for one in zip(*parts, strict=True))
        found[name] = fit_mode(place, known, own_h, residual, weight, config.ridge)
    return DeviationKernel(body, scale, unit, found, landing_s)


def fit_mode(
    place: np.ndarray, known: np.ndarray, own_h: np.ndarray, residual: np.ndarray, weight: np.ndarray, ridge: float
) -> ModePart:
    """One mode; ``known`` is w, (n, 11), ``own_h`` the variance of an h that only these rows share, (n,)."""
    gram = gauss(place, place) * (known @ known.T + np.sqrt(np.outer(own_h, own_h)))
    weights = np.linalg.solve(gram + ridge * np.diag(1 / weight), residual)
    of_robot = known.copy()
    of_robot[:, 0] += own_h
    return ModePart(place, (of_robot[:, :, None] * weights[:, None, :]).reshape(len(known), -1))


class DeviationKernelRecipe(DeviationRecipe):
    """h, C and G in closed form."""

    name = "deviation_kernel"
    settings = DeviationKernelConfig

    def fit(self, task: DeviationTask) -> DeviationKernel:
        """Solve for the weights of the steps of all jumps."""
        return fit_deviation(task.jumps, task.body, task.settings(DeviationKernelConfig))
