"""Where a robot lands that was told to land somewhere: learned from its jumps, and turned round to aim.

A jump is planned to a goal (x, z, pitch at the landing). The robot lands off the goal by an error that depends
smoothly on the goal and on how it stood before, because joint PD and feed-forward repeat. Learning that error directly
predicts the landing from before the first push on, where there is all the authority; forces late in the jump have none.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize

from leapgap.logs.segments import Target

GOAL = ("x", "z", "pitch")
"""Layout of a goal and of a landing: m, m over the height of a robot that stands on level ground, rad nose-down."""


REWEIGHTED = 10
"""Times that jumps are weighed anew; most settle after three."""
LEAST_COUNT = 1e-4


@dataclass(frozen=True)
class AimConfig:
    """How landing errors are learned and weighed."""

    scale: tuple[float, float, float, float] = (0.2, 0.1, 0.2, 0.1)
    """Of the inputs x, z, pitch of the goal and pitch of the stance: changes that matter, m, m, rad, rad."""
    length: float = 1.5
    """Of the kernel, in these scales: errors change this slowly."""
    trend_ridge: float = 1.0
    """Of the linear trend below the kernel; a quadratic one extrapolates badly, to a box that was never practised."""
    noise: float = 0.02
    """Variance of what does not repeat, as part of the kernel's."""
    astray: float = 2.5
    """A jump whose landing is this many times farther off what all others foretell than is usual counts less, by the
    square: feet that slip land anywhere, and say nothing about those that hold."""
    matters: tuple[float, float, float] = (0.01, 0.03, 0.1)
    """Landing errors that cost alike: m, m, rad."""
    clearance_m: float = 0.015
    """Aim this much above the target: feet that touch before the scheduled landing let the ground change it."""
    caution: float = 0.02
    """Cost of an aim beyond the target, per squared scale: of aims that land alike, the nearest is taken."""
    largest: tuple[float, float, float] = (0.25, 0.15, 0.2)
    """No aim is farther beyond its target than this: m, m, rad."""


@dataclass(frozen=True)
class Tried:
    """Jumps that were made: their goals, stances and landings."""

    goal: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) as ``GOAL``"""
    stance_pitch: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n,), rad"""
    landing: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) as ``GOAL``, at the end of the scheduled flight"""

    def __len__(self) -> int:
        return len(self.stance_pitch)

    def and_also(self, other: "Tried") -> "Tried":
        """Both."""
        return Tried(
            np.concatenate([self.goal, other.goal]),
            np.concatenate([self.stance_pitch, other.stance_pitch]),
            np.concatenate([self.landing, other.landing]),
        )

    @property
    def inputs(self) -> np.ndarray:
        """Goal and stance, (n, 4)."""
        return np.column_stack([self.goal, self.stance_pitch])


class LandingModel:
    """Landing − goal as a function of goal and stance: a linear trend and a Gaussian process on what it leaves."""

    def __init__(self, tried: Tried, config: AimConfig) -> None:
        self.tried, self.config = tried, config
        self.centre = tried.inputs.mean(axis=0) if len(tried) else np.zeros(4)
        self.error = tried.landing - tried.goal
        self.counts = np.ones(len(tried))
        """How much each jump counts, 0 to 1, (n,)."""
        self._fit()
        for _ in range(REWEIGHTED):
            self.counts = self._trusted()
            self._fit()

    def _fit(self) -> None:
        """Trend, then the process on what it leaves; a jump that counts less is one with more noise."""
        tried, config = self.tried, self.config
        trend = self._trend(tried.inputs)
        weighed = trend.T * self.counts
        ridge = config.trend_ridge * np.eye(trend.shape[1])
        ridge[0, 0] = 1e-6  # the mean error is free
        self.weights = np.linalg.solve(weighed @ trend + ridge, weighed @ self.error)
        self.inverse = np.linalg.inv(self._kernel(tried.inputs, tried.inputs) + np.diag(config.noise / self.counts))
        left = self.error - trend @ self.weights
        self.dual = self.inverse @ left
        self.scatter = np.sqrt((left * self.dual).sum(axis=0) / max(len(tried), 1))
        """Standard deviation of the process, by maximum likelihood, (3,), m, m, rad."""

    def _trusted(self) -> np.ndarray:
        """How much each jump counts by how far it is from what the process makes of all others, (n,)."""
        others_miss = self.dual / np.diag(self.inverse)[:, None] / np.array(self.config.matters)
        off = np.linalg.norm(others_miss, axis=1)
        usual = max(float(np.median(off)), 1.0) if len(off) else 1.0  # errors that do not matter are not astray
        return np.clip((self.config.astray * usual / np.maximum(off, 1e-9)) ** 2, LEAST_COUNT, 1.0)

    def landing(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Predicted landing of a goal (3,), (3,)."""
        at = np.append(goal, stance_pitch)[None]
        return goal + (self._trend(at) @ self.weights + self._kernel(at, self.tried.inputs) @ self.dual)[0]

    def deviation(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Standard deviation of that prediction, (3,), m, m, rad: far from what was tried little is known."""
        k = self._kernel(np.append(goal, stance_pitch)[None], self.tried.inputs)[0]
        return self.scatter * np.sqrt(max(1 - k @ self.inverse @ k, 0.0))

    def heldout_errors(self) -> np.ndarray:
        """Landing less its prediction by all other jumps, (n, 3), by leaving each out."""
        errors = []
        for i in range(len(self.tried)):
            others = np.arange(len(self.tried)) != i
            rest = Tried(self.tried.goal[others], self.tried.stance_pitch[others], self.tried.landing[others])
            predicted = LandingModel(rest, self.config).landing(self.tried.goal[i], self.tried.stance_pitch[i])
            errors.append(self.tried.landing[i] - predicted)
        return np.array(errors).reshape(-1, 3)

    def _scaled(self, inputs: np.ndarray) -> np.ndarray:
        return (inputs - self.centre) / np.array(self.config.scale)

    def _trend(self, inputs: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(len(inputs)), self._scaled(inputs)])

    def _kernel(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        apart = self._scaled(a)[:, None] - self._scaled(b)[None]
        return np.exp(-0.5 * (apart**2).sum(axis=2) / self.config.length**2)


def wanted(target: Target) -> np.ndarray:
    """The landing that is wanted: on the target, level, (3,)."""
    return np.array([target.x_m, target.z_m, 0.0])


def best_goal(
    model: LandingModel | None, target: Target, stance_pitch: float, offset: np.ndarray | None = None
) -> np.ndarray:
    """The goal whose landing is expected nearest to the target, (3,); the target itself without a model.

    ``offset`` (3,) is how much farther than predicted this target's jumps have landed.
    """
    if model is None:
        return wanted(target)
    config = model.config
    want = wanted(target) + np.array([0.0, config.clearance_m, 0.0])
    more = np.zeros(3) if offset is None else offset
    matters, scale, largest = (np.array(v) for v in (config.matters, config.scale[:3], config.largest))

    def cost(beyond: np.ndarray) -> float:
        goal = want + beyond * scale
        missed = (model.landing(goal, stance_pitch) + more - want) / matters
        unsure = model.deviation(goal, stance_pitch) / matters
        return float(missed @ missed + unsure @ unsure + config.caution * (beyond @ beyond))

    first = -(model.landing(want, stance_pitch) + more - want)
    starts = (np.zeros(3), np.clip(first, -largest, largest) / scale)
    bounds = [(-edge, edge) for edge in largest / scale]
    found = [minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    return want + min(found, key=lambda one: float(one.fun)).x * scale
