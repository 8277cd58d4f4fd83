"""Regression from commanded goal to landing pose, inverted to choose the goal.

A jump is planned to a goal (x, z, pitch at the landing). Joint PD and feed-forward repeat, so the landing error is a
smooth function of the goal and of the stance before the jump. A model of that error predicts the landing before the
first push, when the whole jump can still be changed. Forces late in the jump could change little.
"""

from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.task import Target

GOAL = ("x", "z", "pitch")
"""Layout of a goal and of a landing: m, m over the height of a robot that stands on level ground, rad nose-down."""


REWEIGHTINGS = 10
"""Iterations of the reweighting; most data sets settle after three."""
LEAST_WEIGHT = 1e-4


@dataclass(frozen=True)
class AimConfig:
    """How landing errors are learned, and what they cost when a goal is chosen."""

    scale: tuple[float, float, float, float] = (0.2, 0.1, 0.2, 0.1)
    """Typical change of each input: x, z and pitch of the goal, and pitch of the stance; m, m, rad, rad."""
    length: float = 1.5
    """Length scale of the kernel, in units of ``scale``."""
    trend_ridge: float = 1.0
    """Ridge of the linear trend. A quadratic trend extrapolates badly, for example to a box."""
    noise: float = 0.02
    """Variance of what does not repeat from jump to jump, as a share of the kernel's variance."""
    astray: float = 2.5
    """A jump whose held-out error is this many times the median or more gets less weight, by the square of the ratio.
    Such jumps are usually those whose feet slipped, and they say nothing about jumps whose feet held."""
    matters: tuple[float, float, float] = (0.01, 0.03, 0.1)
    """Landing errors that cost alike: m, m, rad."""
    clearance_m: float = 0.015
    """Goals are this much above the target, so that no foot touches the ground before the scheduled landing."""
    caution: float = 0.02
    """Cost of a goal away from the target, per squared ``scale``: of goals that land alike, the nearest is chosen."""
    largest: tuple[float, float, float] = (0.25, 0.15, 0.2)
    """Largest distance of a goal from its target: m, m, rad."""


@dataclass(frozen=True)
class LandingSamples:
    """Goals, stances and landings of n jumps."""

    goal: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Commanded goals, (n, 3), as ``GOAL``."""
    stance_pitch: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Pitch of the crouch on the ground before each jump, nose-down, (n,), rad."""
    landing: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Poses at the end of the scheduled flight, (n, 3), as ``GOAL``."""

    def __len__(self) -> int:
        return len(self.stance_pitch)

    def extended_by(self, other: "LandingSamples") -> "LandingSamples":
        """These samples, followed by those of ``other``."""
        return LandingSamples(
            np.concatenate([self.goal, other.goal]),
            np.concatenate([self.stance_pitch, other.stance_pitch]),
            np.concatenate([self.landing, other.landing]),
        )

    @property
    def inputs(self) -> np.ndarray:
        """Goals and stance pitches as inputs of the regression, (n, 4)."""
        return np.column_stack([self.goal, self.stance_pitch])


class LandingModel:
    """Landing − goal as a function of goal and stance: a linear trend and a Gaussian process on what it leaves.

    With a model ``base`` of a similar robot, the same is fitted to landing − its prediction.
    """

    def __init__(self, samples: LandingSamples, config: AimConfig, base: "LandingModel | None" = None) -> None:
        self.samples, self.config, self.base = samples, config, base
        self.centre = samples.inputs.mean(axis=0) if len(samples) else np.zeros(4)
        pairs = zip(samples.goal, samples.stance_pitch, strict=True)
        self.error = samples.landing - np.array([self._expected(*pair) for pair in pairs]).reshape(-1, 3)
        self.sample_weights = np.ones(len(samples))
        """Weight of each jump in the fit, 0 to 1, (n,)."""
        self._fit()
        for _ in range(REWEIGHTINGS):
            self.sample_weights = self._weights_from_residuals()
            self._fit()

    def _fit(self) -> None:
        """Fit the trend, then the process to its residuals; a jump of smaller weight counts as one with more noise."""
        samples, config = self.samples, self.config
        trend = self._trend(samples.inputs)
        weighted = trend.T * self.sample_weights
        ridge = config.trend_ridge * np.eye(trend.shape[1])
        ridge[0, 0] = 1e-6  # the mean error is free
        self.weights = np.linalg.solve(weighted @ trend + ridge, weighted @ self.error)
        noise = np.diag(config.noise / self.sample_weights)
        self.inverse = np.linalg.inv(self._kernel(samples.inputs, samples.inputs) + noise)
        residual = self.error - trend @ self.weights
        self.dual = self.inverse @ residual
        self.scatter = np.sqrt((residual * self.dual).sum(axis=0) / max(len(samples), 1))
        """Standard deviation of the process, by maximum likelihood, (3,), m, m, rad."""

    def _weights_from_residuals(self) -> np.ndarray:
        """Weight of each jump by its error when the process predicts it from all other jumps, (n,)."""
        heldout = self.dual / np.diag(self.inverse)[:, None] / np.array(self.config.matters)
        off = np.linalg.norm(heldout, axis=1)
        usual = max(float(np.median(off)), 1.0) if len(off) else 1.0  # errors below ``matters`` are no outliers
        return np.clip((self.config.astray * usual / np.maximum(off, 1e-9)) ** 2, LEAST_WEIGHT, 1.0)

    def landing(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Predicted landing pose, (3,), of a jump to ``goal`` (3,) from a stance of this pitch, rad; as ``GOAL``."""
        at = np.append(goal, stance_pitch)[None]
        learned = (self._trend(at) @ self.weights + self._kernel(at, self.samples.inputs) @ self.dual)[0]
        return self._expected(goal, stance_pitch) + learned

    def _expected(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """The landing before anything is learned from the samples: the base model's, else the goal, (3,)."""
        return goal if self.base is None else self.base.landing(goal, stance_pitch)

    def deviation(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Standard deviation of that prediction, (3,), m, m, rad; it grows with the distance from the samples."""
        k = self._kernel(np.append(goal, stance_pitch)[None], self.samples.inputs)[0]
        return self.scatter * np.sqrt(max(1 - k @ self.inverse @ k, 0.0))

    def _scaled(self, inputs: np.ndarray) -> np.ndarray:
        return (inputs - self.centre) / np.array(self.config.scale)

    def _trend(self, inputs: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(len(inputs)), self._scaled(inputs)])

    def _kernel(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        apart = self._scaled(a)[:, None] - self._scaled(b)[None]
        return np.exp(-0.5 * (apart**2).sum(axis=2) / self.config.length**2)


def target_pose(target: Target) -> np.ndarray:
    """Pose of a perfect landing: on the target and level, (3,), as ``GOAL``."""
    return np.array([target.x_m, target.z_m, 0.0])


def best_goal(
    model: LandingModel | None, target: Target, stance_pitch: float, offset: np.ndarray | None = None
) -> np.ndarray:
    """The goal whose landing is expected nearest to the target, (3,); the target itself without a model.

    ``offset`` (3,) is how much farther than predicted this target's jumps have landed.
    """
    if model is None:
        return target_pose(target)
    from scipy.optimize import minimize  # most processes read this file and aim at nothing

    config = model.config
    desired = target_pose(target) + np.array([0.0, config.clearance_m, 0.0])
    bias = np.zeros(3) if offset is None else offset
    matters, scale, largest = (np.array(v) for v in (config.matters, config.scale[:3], config.largest))

    def cost(shift: np.ndarray) -> float:
        goal = desired + shift * scale
        error = (model.landing(goal, stance_pitch) + bias - desired) / matters
        deviation = model.deviation(goal, stance_pitch) / matters
        return float(error @ error + deviation @ deviation + config.caution * (shift @ shift))

    first = -(model.landing(desired, stance_pitch) + bias - desired)
    starts = (np.zeros(3), np.clip(first, -largest, largest) / scale)
    bounds = [(-edge, edge) for edge in largest / scale]
    found = [minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    return desired + min(found, key=lambda one: float(one.fun)).x * scale
