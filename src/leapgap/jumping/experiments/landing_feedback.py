"""Predicts the landing while the robot still pushes: from the goal, from what the robot does, and from shifts to come.

At update j the goal is γ: the planned one plus the shift δ_{j−1} so far. The landing is learned directly, not composed
of short steps, so that no error grows on the way to it:

    landing = L(γ, stance) + W_jᵀ φ_j(γ, stance, deviation) + Σ_{i ≥ j} G_i (δ_i − δ_{j−1})

``L`` is the landing model of jumps with one constant goal, ``G_i`` what a shift during update i does to the landing,
and φ_j holds a one, goal, stance, and how far trunk and feet are from the shifted plan. ``W`` is a ridge regression
towards the same model of another robot: the identified one, which was simulated.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.jumping.experiments.landing_model import AimConfig, LandingModel, LandingSamples

TRUNK_SCALE = (0.01, 0.01, 0.04, 0.1, 0.1, 0.4)
"""Typical deviation of x, z, pitch and their rates; m, m, rad, m/s, m/s, rad/s."""
FOOT_SCALE = 0.01
"""Typical deviation of a foot from the plan, relative to the base, m."""


@dataclass(frozen=True)
class FeedbackConfig:
    """How the model of a robot is learned."""

    landing: AimConfig = field(default_factory=lambda: AimConfig(noise=0.5))
    noise: float = 1.2
    """Standard deviation of a simulated, shifted landing, in units of ``landing.matters``."""
    own_noise: float = 0.5
    """The same of the robot's own, unshifted jumps."""
    bias: float = 3.0
    """Standard deviation of the change of the constant from the prior model, in units of ``landing.matters``."""
    change: float = 0.1
    """The same for the other weights, per typical change of their input. It is small: undisturbed jumps deviate by a
    tenth of what kicks do, and weights that explain their scatter miss kicks and unseen ground by centimetres."""
    first_change: float = 3.0
    """The same for a robot without a prior model."""
    doubt_share: float = 0.5
    """Share of what the weights leave open that counts as error of a prediction."""
    free_bias: float = 30.0
    """The same for the constant of a robot without a prior model."""


@dataclass(frozen=True)
class HeldShifts:
    """What k shifts did to the landings of jumps to g goals that were held from some update to the end."""

    x_m: np.ndarray
    """Distances of the goals, rising, (g,), m."""
    update: np.ndarray
    """The update from which each shift was held, (k,)."""
    axis: np.ndarray
    """The axis of the goal along which each shift was, (k,)."""
    effect: np.ndarray
    """Change of the landing per shift, (g, k, 3); not finite where a jump fell."""
    error: float
    """Standard deviation of an effect."""


@dataclass(frozen=True)
class Authority:
    """What a shift does to the landing of jumps to g goals, and in how many ways that may be off."""

    mean: np.ndarray
    """G of each goal and update, (g, T, 3 of the landing, 3 of the shift)."""
    error: np.ndarray
    """By how much G may be off in q independent ways, (q, T, 3, 3); each way is one of whole jumps."""
    x_m: np.ndarray = field(default_factory=lambda: np.array([0.55]))
    """Distances of the goals, rising, (g,), m."""

    def at(self, x_m: np.ndarray) -> np.ndarray:
        """G of goals at n distances, (n, T, 3, 3), linearly between those of the g goals."""
        shares = np.stack([np.interp(x_m, self.x_m, one) for one in np.eye(len(self.x_m))], axis=1)
        return np.einsum("ng,gtij->ntij", shares, self.mean)

    def measured(self, held: HeldShifts) -> "Authority":
        """The same with what was measured of held shifts in the place of what was known of them.

        Between its goals the effect is taken for a straight line, which may be off by half of its difference. An axis
        that was not measured may be off at an update by as much as the measured ones were.
        """
        if not len(held.x_m):
            return self
        mean, error = held_effects(self.at(held.x_m)), held_effects(self.error)
        ways = []
        for update in np.unique(held.update):
            of_update = held.update == update
            simulated = mean[:, update][:, :, held.axis[of_update]].swapaxes(1, 2)
            wrong = np.nan_to_num(np.abs(held.effect[:, of_update] - simulated)).max(axis=(0, 1))
            for i, axis in itertools.product(range(3), set(range(3)) - set(held.axis[of_update])):
                way = np.zeros(error.shape[1:])
                way[update, i, axis] = wrong[i]
                ways.append(way)
        for update, axis, effect in zip(held.update, held.axis, held.effect.swapaxes(0, 1), strict=True):
            if not np.isfinite(effect).all():
                continue
            mean[:, update, :, axis] = effect
            error[:, update, :, axis] = 0.0
            for i, off in enumerate(np.hypot(held.error, np.ptp(effect, axis=0) / 2)):
                way = np.zeros(error.shape[1:])
                way[update, i, axis] = off
                ways.append(way)
        return Authority(
            of_held(mean), of_held(np.concatenate([error, np.array(ways).reshape(-1, *error.shape[1:])])), held.x_m
        )


@dataclass(frozen=True)
class ShiftedJumps:
    """n jumps with T updates each."""

    goal: np.ndarray
    """Planned goals, (n, 3), m, m, rad."""
    stance_pitch: np.ndarray
    """(n,), rad."""
    landing: np.ndarray
    """(n, 3), as the goal."""
    shift: np.ndarray
    """Shift of the goal from each update on, (n, T, 3), m, m, rad."""
    deviation: np.ndarray
    """Deviation from the shifted plan at each update, (n, T, 10); not finite where the jump is not to be learned from:
    before it is disturbed."""
    disturbed: np.ndarray
    """1 where something happened that the plan did not reckon with, else 0, (n,). Only the others teach what shifts do,
    and where constant goals lead."""

    def __len__(self) -> int:
        return len(self.goal)

    @staticmethod
    def join(parts: Sequence["ShiftedJumps"]) -> "ShiftedJumps":
        """All jumps of some parts, in their order."""
        names = [one.name for one in fields(ShiftedJumps)]
        return ShiftedJumps(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def to_json(self) -> dict[str, Any]:
        """The arrays as lists; what is not finite becomes null."""
        return {one.name: null_where_not_finite(getattr(self, one.name)) for one in fields(self)}

    @staticmethod
    def from_json(raw: Mapping[str, Any]) -> "ShiftedJumps":
        """The inverse of ``to_json``."""
        return ShiftedJumps(**{name: np.array(values, dtype=float) for name, values in raw.items()})

    @property
    def undisturbed(self) -> np.ndarray:
        """Whether nothing unexpected happened, bool, (n,)."""
        return self.disturbed == 0

    def goal_at(self, update: int) -> np.ndarray:
        """Goals just before an update, (n, 3)."""
        return self.goal + self.shift_before(update)

    def shift_before(self, update: int) -> np.ndarray:
        """Shifts just before an update, (n, 3)."""
        return self.shift[:, update - 1] if update else np.zeros_like(self.goal)


def held_effects(authority: np.ndarray) -> np.ndarray:
    """Effects of shifts that are held from each of T updates to the end, by those of single updates (n, T, 3, 3).

    Shape (n, T + 1, 3, 3); a shift after the last update does nothing.
    """
    held = np.flip(np.cumsum(np.flip(authority, -3), axis=-3), -3)
    return np.concatenate([held, np.zeros_like(held[..., :1, :, :])], axis=-3)


def of_held(held: np.ndarray) -> np.ndarray:
    """The inverse of ``held_effects``."""
    return -np.diff(held, axis=-3)


def null_where_not_finite(values: np.ndarray) -> Any:
    """Nested lists of the values, with None for those that are not finite."""
    found = values.astype(object)
    found[~np.isfinite(values)] = None
    return found.tolist()


def features(goal: np.ndarray, stance_pitch: np.ndarray, deviation: np.ndarray, config: AimConfig) -> np.ndarray:
    """φ of n jumps at one update, (n, 15), each divided by its typical change."""
    scale = np.array(config.scale)
    centre = np.array([0.55, 0.0, 0.0])
    parts = [
        np.ones((len(goal), 1)),
        (goal - centre) / scale[:3],
        stance_pitch[:, None] / scale[3],
        deviation[:, :6] / np.array(TRUNK_SCALE),
        deviation[:, 6:] / FOOT_SCALE,
    ]
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class LandingFeedback:
    """The learned model of one robot; see the module."""

    config: FeedbackConfig
    landing: LandingModel
    shifts: Authority
    weights: np.ndarray
    """W of each update, (T, 15, 3), in units of ``matters``."""
    covariance: np.ndarray
    """Posterior covariance of a column of W, (T, 15, 15), in squared units of ``matters``."""
    scatter: np.ndarray
    """Standard deviation of held-out landings at each update, (T, 3), in units of ``matters``."""
    planned_x_m: float = 0.55
    """Distance of the planned goal, which decides what shifts do."""

    def planned_to(self, goal: np.ndarray) -> "LandingFeedback":
        """The model for a jump whose plan goes to a goal (3,)."""
        return replace(self, planned_x_m=float(goal[0]))

    @cached_property
    def authority(self) -> np.ndarray:
        """G of each update, (T, 3, 3)."""
        return self.shifts.at(np.array([self.planned_x_m]))[0]

    @property
    def authority_error(self) -> np.ndarray:
        """By how much G may be off in q independent ways, (q, T, 3, 3)."""
        return self.shifts.error

    @cached_property
    def matters(self) -> np.ndarray:
        """Landing errors that count alike, (3,), m, m, rad."""
        return np.array(self.config.landing.matters)

    def predict(self, update: int, goal: np.ndarray, stance: float, deviation: np.ndarray) -> np.ndarray:
        """Landing, (3,), if the goal stays ``goal`` (3,) from this update on."""
        phi = features(goal[None], np.array([stance]), deviation[None], self.config.landing)[0]
        return self.landing.landing(goal, stance) + phi @ self.weights[update] * self.matters

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        """Landing, (3,), of a jump to one constant goal in which nothing unexpected happens."""
        return self.landing.landing(goal, stance)

    def spread(self, update: int, goal: np.ndarray, stance: float, deviation: np.ndarray) -> np.ndarray:
        """Standard deviation of ``predict``, (3,): scatter of held-out jumps, and what the weights leave open."""
        doubt = self.doubt(update, goal, stance, deviation)
        return self.matters * np.hypot(self.scatter[update], self.config.doubt_share * doubt)

    def doubt(self, update: int, goal: np.ndarray, stance: float, deviation: np.ndarray) -> float:
        """Standard deviation of the prediction by what the weights leave open, in units of ``matters``."""
        phi = features(goal[None], np.array([stance]), deviation[None], self.config.landing)[0]
        return float(np.sqrt(phi @ self.covariance[update] @ phi))


def learn_feedback(
    jumps: ShiftedJumps,
    shifts: Authority,
    config: FeedbackConfig,
    prior: LandingFeedback | None = None,
    landing: LandingModel | None = None,
) -> LandingFeedback:
    """Fit the model to jumps, with a model of a similar robot as prior; what shifts do is known from simulation.

    ``landing`` is the model of constant goals where it was learned from the same undisturbed jumps, in their order.
    """
    matters, authority = np.array(config.landing.matters), shifts.at(jumps.goal[:, 0])
    constant = jumps.landing - np.einsum("ntij,ntj->ni", authority, jumps.shift)
    own = jumps.undisturbed
    if landing is None:
        samples = LandingSamples(jumps.goal[own], jumps.stance_pitch[own], constant[own])
        landing = LandingModel(samples, config.landing, None if prior is None else prior.landing)
    at_goal = predictions(landing, jumps.goal, jumps.stance_pitch)
    left_out, trusted = constant - at_goal, np.ones(len(jumps))
    left_out[own] = landing.dual / np.diag(landing.inverse)[:, None]
    trusted[own] = landing.sample_weights
    fits = []
    for update in range(authority.shape[1]):
        goal, before = jumps.goal_at(update), jumps.shift_before(update)
        later = np.einsum("ntij,ntj->ni", authority[:, :update], jumps.shift[:, :update])
        later -= np.einsum("ntij,nj->ni", authority[:, :update], before)
        # landing − L(γ) − Σ_{i ≥ j} G_i (δ_i − δ_before), with L(goal) predicted from the other jumps
        gained = np.einsum("ntij,nj->ni", authority, before)
        moved = predictions(landing, goal, jumps.stance_pitch) - at_goal
        residual = (left_out + later + gained - moved) / matters
        usable = np.isfinite(jumps.deviation[:, update]).all(axis=1)
        weight = trusted * usable
        phi = features(goal, jumps.stance_pitch, np.nan_to_num(jumps.deviation[:, update]), config.landing)
        mean = np.zeros((phi.shape[1], 3)) if prior is None else prior.weights[update]
        change = config.first_change if prior is None else config.change
        deviation = np.full(phi.shape[1], change)
        deviation[0] = config.free_bias if prior is None else config.bias
        fit = Ridge(phi, residual - phi @ mean, weight, deviation, config.noise if prior is None else config.own_noise)
        uncertain = fit.covariance if prior is None else fit.covariance + prior.covariance[update]
        fits.append((mean + fit.weights, uncertain, fit.scatter))
    weights, covariance, scatter = (np.array(part) for part in zip(*fits, strict=True))
    return LandingFeedback(config, landing, shifts, weights, covariance, scatter)


class Ridge:
    """Bayesian linear regression with weights of mean zero and the given standard deviations."""

    def __init__(
        self, inputs: np.ndarray, outputs: np.ndarray, weight: np.ndarray, deviation: np.ndarray, noise: float
    ) -> None:
        weighted = inputs.T * (weight / noise**2)
        self.covariance = np.linalg.inv(weighted @ inputs + np.diag(deviation**-2.0))
        self.weights = self.covariance @ weighted @ outputs
        leverage = np.einsum("ni,ij,nj->n", inputs, self.covariance, inputs) * weight / noise**2
        errors = (outputs - inputs @ self.weights) / np.maximum(1 - leverage, 0.05)[:, None]
        self.scatter = np.sqrt(np.average(errors**2, axis=0, weights=weight + 1e-9))


def predictions(landing: LandingModel, goal: np.ndarray, stance_pitch: np.ndarray) -> np.ndarray:
    """Landings of constant goals, (n, 3)."""
    return np.array([landing.landing(g, s) for g, s in zip(goal, stance_pitch, strict=True)]).reshape(-1, 3)
