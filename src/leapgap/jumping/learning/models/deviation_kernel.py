"""Kernel ridge regression of h, C and G of the deviation from a plan, in closed form, for each mode of contact."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from leapgap.jumping.learning.models.kernel import gauss
from leapgap.jumping.learning.recipe import DeviationRecipe, DeviationTask, ModelSettings
from leapgap.jumping.learning.window_extraction import BALLISTIC_S, DeviatingJump
from leapgap.jumping.models.affine_model import AffineModel
from leapgap.jumping.models.rigid_body import DeviationModel, PlannedSteps, RigidBody
from leapgap.logs.pair_force import FORCES, per_axis

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
        """Refuse numbers that mean nothing."""
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


def fit(jumps: Sequence[DeviatingJump], body: RigidBody, config: DeviationKernelConfig) -> DeviationKernel:
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
        return fit(task.jumps, task.body, task.settings(DeviationKernelConfig))
