"""All plausible effects fitted together, then taken away while the simulation gets no worse.

Causes that act together can each look wrong alone: right legs on soft feet open the gap. So all effects are fitted at
once, drawn towards the nominal robot and towards what evidence says, to replays of whole logs and of short pieces in
one likelihood. Effects without which the likelihood hardly falls are then taken away, and the rest is fitted again.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import clip_numbers, effects_on_logs, in_words, split_numbers
from leapgap.diagnosis.evidence.base import Evidence, sure
from leapgap.diagnosis.full_rollouts import EVERY_S, FullRolloutCause, FullRolloutFit
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.short_rollouts import ShortRollouts

DIFFERENCE = 0.1
"""Step of finite differences, as a share of the scale of a number."""
DAMPINGS = (0.02, 0.2, 1.0)
"""Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature."""
SETTLED = 5.0
"""A fit has converged when the logarithm of its likelihood rises by less than this."""
INDEPENDENT_S = 0.2
"""Errors of whole replays at one instant say little more than those so long before."""
PIECE_VALUES = 6
"""A short piece counts as so many independent values."""
USUAL = 1.0
"""A usual χ² of a piece over its number of values: below it pieces count alike."""


@dataclass(frozen=True)
class JointFitSettings:
    """Width of the joint fit, and when an effect is taken away."""

    steps: int = 6
    """Largest number of steps of the first fit of all effects to whole logs and pieces."""
    first_steps: int = 3
    """Steps before it with short pieces alone."""
    most_causes: int = 8
    least_gain: float = 6.0
    """An effect without which the logarithm of the likelihood falls by less is taken away."""
    fewer_steps: int = 6
    """Largest number of steps of later fits, of fewer effects."""
    least_useful: float = 0.5
    """An effect is taken away where it helps on held-out logs in a smaller share of the resamples."""
    most_lost: float = 0.02
    """Effects that help little stay where the gap of held-out logs closes less by this share without them."""
    least_closure: float = 0.05
    """Smallest share of the headline gap of held-out logs that it must close beyond the causes found before."""
    least_sure: float = 0.9
    """Smallest share of resampled logs on which it must be better than these."""


@dataclass(frozen=True)
class Errors:
    """Errors of one set of numbers."""

    whole: np.ndarray
    """Scaled errors of whole replays at the compared instants, (values,)."""
    pieces: np.ndarray
    """Whitened errors of short pieces, (pieces, values)."""


@dataclass(frozen=True)
class Slopes:
    """Errors at some numbers, their derivatives by the scaled numbers, and the normal equations of the likelihood."""

    errors: Errors
    whole: np.ndarray
    """(values, numbers)"""
    pieces: np.ndarray
    """(pieces, values, numbers)"""


@dataclass(frozen=True)
class Numbers:
    """The numbers of a set of effects: what is expected beforehand, and which are fitted."""

    hypotheses: tuple[Hypothesis, ...]
    centre: np.ndarray
    """What evidence says, else nominal, (numbers,)."""
    spread: np.ndarray
    """Standard deviation of what evidence says, else a moderate departure, (numbers,)."""
    fitted: np.ndarray
    """Whether each number is fitted, bool, (numbers,); what evidence says is held."""

    @staticmethod
    def of(hypotheses: tuple[Hypothesis, ...], told: Mapping[str, Evidence]) -> "Numbers":
        """Numbers of some hypotheses; evidence by the parameter that it tells."""
        centre, spread, fitted = [], [], []
        for h in hypotheses:
            for p, moderate in zip(h.parameters, np.abs(h.moderate), strict=True):
                one = told.get(f"{h.name}.{p.name}")
                centre.append(p.nominal if one is None else one.value)
                spread.append(moderate if one is None else one.spread)
                fitted.append(one is None)
        return Numbers(hypotheses, np.array(centre), np.array(spread), np.array(fitted))

    @property
    def scale(self) -> np.ndarray:
        """Scale of the fitted numbers, (fitted,)."""
        return self.spread[self.fitted]

    def departs(self, numbers: np.ndarray) -> np.ndarray:
        """Fitted numbers as scaled departures from what is expected, (fitted,)."""
        return ((numbers - self.centre) / self.spread)[self.fitted]

    def moved(self, numbers: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Numbers after a scaled step of the fitted ones, within their ranges, (numbers,)."""
        found = numbers.copy()
        found[self.fitted] += by * self.scale
        return clip_numbers(self.hypotheses, found)

    def covariance(self, of_fitted: np.ndarray) -> np.ndarray:
        """Covariance of all numbers from that of the fitted ones, scaled; that of the others is evidence's."""
        found = np.diag(self.spread**2)
        found[np.ix_(self.fitted, self.fitted)] = of_fitted * self.scale[:, None] * self.scale
        return found


@dataclass
class JointFit:
    """Fits sets of effects that act at all places to whole logs and short pieces together."""

    heldout_gap: HeldOutGap
    short: ShortRollouts
    evidence: Sequence[Evidence]
    plan: JointFitSettings = field(default_factory=JointFitSettings)
    progress: Callable[[str], None] = lambda _: None
    weight: float = 1.0
    """Of the errors of whole logs beside those of short pieces."""

    def search(self, hypotheses: Sequence[Hypothesis]) -> list[FullRolloutCause]:
        """Fit all effects, take away those that do not matter, and return the rest, what matters most first."""
        every = tuple(h for h in hypotheses if h.location == "all" and h.per_log is None)
        # Short pieces answer almost linearly, and lead near; whole logs then tell the slow effects.
        near = self.fit(every, Numbers.of(every, self.told).centre, self.plan.first_steps, whole=0.0)
        fit = self.fit(every, near.numbers, self.plan.steps)
        kept = self.without_idle(fit)
        fewer = self.fit(*kept_numbers(fit, kept), self.plan.fewer_steps)
        self.progress(f"jointly, {in_words(fewer)}: closes {self.closes(fewer):.2f}")
        useful = self.without_useless(fewer)
        if len(useful) < len(fewer.hypotheses):
            best = part(fewer, useful)
            again = self.fit(best.hypotheses, best.numbers, self.plan.fewer_steps)
            self.progress(f"jointly, {in_words(again)}: closes {self.closes(again):.2f}")
            if self.closes(fewer) - self.closes(again) < self.plan.most_lost:
                fewer = again
        return self.ordered(fewer)

    def closes(self, fit: FullRolloutFit) -> float:
        """Share of the headline gap that a fit closes on held-out logs."""
        return self.heldout_gap.closure_value(fit.heldout)

    @cached_property
    def told(self) -> Mapping[str, Evidence]:
        """Evidence by the parameter that it tells."""
        return {one.quantity: one for one in self.evidence}

    def is_told(self, hypothesis: Hypothesis) -> bool:
        """Whether evidence alone says that an effect is there."""
        own = ((p, self.told.get(f"{hypothesis.name}.{p.name}")) for p in hypothesis.parameters)
        return any(one is not None and sure(one.value - p.nominal, one.spread) for p, one in own)

    def fit(
        self, hypotheses: tuple[Hypothesis, ...], numbers: np.ndarray, steps: int, whole: float = 1.0
    ) -> FullRolloutFit:
        """The most likely numbers of a set of effects, with their covariance and those of each fold.

        ``whole`` is the weight of the errors of whole logs; those of short pieces have 1.
        """
        self.weight = whole
        about = Numbers.of(hypotheses, self.told)
        numbers = clip_numbers(hypotheses, numbers)
        slopes = self.slopes(about, numbers)
        loss = self.loss(slopes.errors, about.departs(numbers))
        for _ in range(steps):
            departs = about.departs(numbers)
            equations = self.normal(slopes, departs)
            tried = [about.moved(numbers, damped_step(*equations, damping)) for damping in DAMPINGS]
            found = self.errors(hypotheses, tried)
            losses = [self.loss(e, about.departs(x)) for e, x in zip(found, tried, strict=True)]
            best = int(np.argmin(losses))
            if losses[best] >= loss - SETTLED:
                break
            self.progress(f"joint fit of {len(hypotheses)} effects: loss {losses[best]:.0f}, was {loss:.0f}")
            numbers, loss = tried[best], losses[best]
            slopes = self.slopes(about, numbers)
        departs, folds = about.departs(numbers), self.heldout_gap.folds
        of_folds = np.array(
            [
                about.moved(numbers, damped_step(*self.normal(slopes, departs, fold), DAMPINGS[1]))
                for fold in range(int(folds.max()) + 1)
            ]
        )
        candidates = effects_on_logs(hypotheses, list(of_folds), self.heldout_gap.names)
        heldout = self.heldout_gap.squares_with(candidates)[folds, np.arange(len(folds))]
        covariance = about.covariance(np.linalg.inv(self.normal(slopes, departs)[0]))
        return FullRolloutFit(hypotheses, numbers, covariance, of_folds, loss, heldout)

    def without_idle(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses that matter, by what the likelihood loses without them, one after the other.

        Those that evidence tells stay, and are not counted.
        """
        kept = list(range(len(fit.hypotheses)))
        told = [self.is_told(h) for h in fit.hypotheses]
        while (open_to_doubt := [k for k in kept if not told[k]]) and len(kept) > 1:
            losses = dict(zip(kept, self.losses_without(fit, kept), strict=True))
            least = min(open_to_doubt, key=lambda k: losses[k])
            if losses[least] >= self.plan.least_gain and len(open_to_doubt) <= self.plan.most_causes:
                break
            kept.remove(least)
        return kept

    def without_useless(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses that help on held-out logs, or that evidence tells; what helps least goes first."""
        kept, draws = list(range(len(fit.hypotheses))), self.heldout_gap.draws
        while len(kept) > 1:
            open_to_doubt = [k for k in kept if not self.is_told(fit.hypotheses[k])]
            tried = [part(fit, kept), *(part(fit, [other for other in kept if other != k]) for k in open_to_doubt)]
            whole, *without = [squares[draws].sum(axis=1) for squares in self.heldout_gap.squares(tried)]
            sure = [float((whole < own).mean()) for own in without]
            if not sure or min(sure) >= self.plan.least_useful:
                break
            kept.remove(open_to_doubt[int(np.argmin(sure))])
        return kept

    def losses_without(self, fit: FullRolloutFit, kept: Sequence[int]) -> np.ndarray:
        """Fall of the logarithm of the likelihood without each of the kept hypotheses, the others fitted anew.

        By the curvature at the fit; hypotheses that are not kept are nominal.
        """
        own, shift, inner = where_others_are_nominal(fit, kept)
        departs = (fit.numbers - np.concatenate([h.nominal for h in fit.hypotheses]))[own] + shift
        ends = np.cumsum([0, *(len(fit.hypotheses[k].parameters) for k in kept)])
        at = [list(range(begin, end)) for begin, end in itertools.pairwise(ends)]
        return np.array([0.5 * departs[i] @ np.linalg.solve(inner[np.ix_(i, i)], departs[i]) for i in at])

    def ordered(self, fit: FullRolloutFit) -> list[FullRolloutCause]:
        """The causes of a fit, what matters most first, each with the fit of those up to it.

        The probability of a cause is the share of resampled logs on which the whole set is better than without it.
        """
        kept = list(range(len(fit.hypotheses)))
        last_first = []
        while len(kept) > 1:
            last_first.append(kept.pop(int(np.argmin(self.losses_without(fit, kept)))))
        order = [*kept, *reversed(last_first)]
        without = [part(fit, [k for k in order if k != one]) for one in order] if len(order) > 1 else []
        draws = self.heldout_gap.draws
        sure = [
            float((own[draws].sum(axis=1) > fit.heldout[draws].sum(axis=1)).mean())
            for own in self.heldout_gap.squares(without)
        ]
        whole = part(fit, order)
        steps = [part(fit, order[: k + 1]) for k in range(len(order) - 1)] + [whole]
        return [
            FullRolloutCause(step, (step.names[-1],), probability)
            for step, probability in zip(steps, sure or [1.0], strict=True)
        ]

    def loss(self, errors: Errors, departs: np.ndarray) -> float:
        """Minus the logarithm of the likelihood, up to a constant; ``departs`` from what is expected, scaled."""
        whole = self.weight * self.whole_values / 2 * np.log(np.mean(errors.whole**2))
        pieces = PIECE_VALUES / 2 * np.log(USUAL + np.mean(errors.pieces**2, axis=1)).sum()
        return float(whole + pieces + 0.5 * departs @ departs)

    def normal(self, slopes: Slopes, departs: np.ndarray, fold: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Curvature and slope of ``loss`` by the scaled numbers, (numbers, numbers) and (numbers,), without a fold."""
        folds = self.heldout_gap.folds
        values, pieces = folds[self.log_of_value] != fold, folds[self.short.log_of_piece] != fold
        errors = slopes.errors
        of_whole = self.weight * self.whole_values / (np.mean(errors.whole**2) * len(errors.whole))
        chi2 = USUAL + np.mean(errors.pieces**2, axis=1)
        of_pieces = PIECE_VALUES / (chi2 * errors.pieces.shape[1]) * pieces
        by_whole = slopes.whole * (of_whole * values)[:, None]
        by_pieces = (slopes.pieces * of_pieces[:, None, None]).reshape(-1, len(departs))
        flat = slopes.pieces.reshape(-1, len(departs))
        curvature = by_whole.T @ slopes.whole + by_pieces.T @ flat + np.eye(len(departs))
        slope = by_whole.T @ errors.whole + by_pieces.T @ errors.pieces.ravel() + departs
        return curvature, slope

    def slopes(self, about: Numbers, numbers: np.ndarray) -> Slopes:
        """Errors at numbers, and finite differences about them within their ranges, by those that are fitted."""
        lower, upper = (np.concatenate([h.bounds[side] for h in about.hypotheses]) for side in (0, 1))
        size = DIFFERENCE * np.abs(np.concatenate([h.moderate for h in about.hypotheses]))
        by = np.where(numbers + size <= upper, size, -np.minimum(size, numbers - lower))
        by = np.where(by == 0, size, by)
        start, *moved = self.errors(about.hypotheses, [numbers, *(numbers + np.diag(by))[about.fitted]])
        share = (about.spread / by)[about.fitted]
        return Slopes(
            start,
            np.stack([(e.whole - start.whole) * s for e, s in zip(moved, share, strict=True)], axis=1),
            np.stack([(e.pieces - start.pieces) * s for e, s in zip(moved, share, strict=True)], axis=2),
        )

    def errors(self, hypotheses: tuple[Hypothesis, ...], tried: Sequence[np.ndarray]) -> list[Errors]:
        """Errors of several vectors of numbers."""
        names = self.heldout_gap.names
        sets = effects_on_logs(hypotheses, tried, names)
        whole = self.heldout_gap.errors_with(sets)
        pieces = self.short.residuals(sets)
        return [
            Errors(
                np.concatenate([of[::rows].ravel() for of, rows in zip(logs, self.every, strict=True)]),
                np.concatenate(parts),
            )
            for logs, parts in zip(whole, pieces, strict=True)
        ]

    @cached_property
    def every(self) -> list[int]:
        """Number of rows between the compared rows of each log."""
        return [log.info.rows(EVERY_S) for log in self.heldout_gap.judged.logs]

    @cached_property
    def log_of_value(self) -> np.ndarray:
        """Index of the log of each compared value of whole replays, (values,)."""
        judged = self.heldout_gap.judged
        instants = [len(range(0, rows, every)) for rows, every in zip(judged.rows, self.every, strict=True)]
        return np.repeat(np.arange(len(instants)), np.array(instants) * len(judged.channels))

    @cached_property
    def whole_values(self) -> float:
        """Number of independent values of whole replays."""
        return len(self.log_of_value) * EVERY_S / INDEPENDENT_S


def damped_step(curvature: np.ndarray, slope: np.ndarray, damping: float) -> np.ndarray:
    """Levenberg–Marquardt step in the scaled numbers, (numbers,), by the normal equations."""
    return np.asarray(-np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope))


def kept_numbers(fit: FullRolloutFit, kept: Sequence[int]) -> tuple[tuple[Hypothesis, ...], np.ndarray]:
    """The kept hypotheses of a fit, with their numbers."""
    parts = split_numbers(fit.hypotheses, fit.numbers)
    return tuple(fit.hypotheses[k] for k in kept), np.concatenate([parts[k] for k in kept])


def where_others_are_nominal(fit: FullRolloutFit, kept: Sequence[int]) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Indices of the numbers of some hypotheses, their shift if all others are nominal, and their covariance then.

    By the curvature at the fit: (numbers,), (numbers,) and (numbers, numbers).
    """
    ends = np.cumsum([0, *(len(h.parameters) for h in fit.hypotheses)])
    own = [i for k in kept for i in range(ends[k], ends[k + 1])]
    gone = [i for i in range(ends[-1]) if i not in own]
    departs = (fit.numbers - np.concatenate([h.nominal for h in fit.hypotheses]))[gone]
    precision = np.linalg.inv(fit.covariance)
    covariance = np.linalg.inv(precision[np.ix_(own, own)])
    return own, covariance @ precision[np.ix_(own, gone)] @ departs, covariance


def part(fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
    """Some causes of a fit, in this order, at their best numbers by the curvature where all others are nominal."""
    hypotheses = tuple(fit.hypotheses[k] for k in kept)
    own, shift, inner = where_others_are_nominal(fit, kept)
    numbers = clip_numbers(hypotheses, fit.numbers[own] + shift)
    of_folds = np.array([clip_numbers(hypotheses, fold + shift) for fold in fit.fold_numbers[:, own]])
    return FullRolloutFit(hypotheses, numbers, inner, of_folds, fit.loss, fit.heldout)
