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

from leapgap.diagnosis.candidates import clip_numbers, effects_on_logs, in_words
from leapgap.diagnosis.evidence.base import Evidence, sure
from leapgap.diagnosis.full_rollouts import FullRolloutCause, FullRolloutFit
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_likelihood import JointLikelihood, Linearised, LogErrors, Numbers, bounded_step
from leapgap.diagnosis.joint_sets import at_all_places, at_parts, merge_alike
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError

DAMPINGS = (0.02, 0.2, 1.0, 5.0)
"""Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature."""
KEPT_PROMISE = 0.5
"""A step is taken without trying others where the likelihood rises by this share of what its curvature promised."""
SETTLED = 5.0
"""A fit has converged when the logarithm of its likelihood rises by less than this."""


REPLAYED = 4
"""So many effects, those that matter least by the curvature, are taken away in turn by replays."""
PROMISING = 5.0
"""An effect is tried in the place of another where that costs less by the curvature, in ``least_gain``."""
IDLE = 0.5
"""An effect without which the logarithm of the likelihood falls by less, by the curvature, is not replayed for that."""
KNOWN = 0.5
"""Pieces tell a number where its spread after them is a smaller share of the one before."""


@dataclass(frozen=True)
class JointFitSettings:
    """Width of the joint fit, and when an effect is taken away."""

    first_steps: int = 4
    """Steps of all effects to short pieces alone, which answer almost linearly."""
    all_steps: int = 4
    """Largest number of steps to whole logs and pieces of the effects that pieces leave."""
    steps: int = 6
    """Largest number of steps of later fits, of fewer effects."""
    most_causes: int = 8
    """Largest number of causes together, beside those that evidence tells."""
    least_sign: float = 3.0
    """An effect that pieces know is taken away where the logarithm of their likelihood falls by less without it."""
    least_gain: float = 6.0
    """An effect without which the logarithm of the likelihood of whole logs and pieces falls by less is taken away."""
    least_useful: float = 0.8
    """An effect is taken away where it helps on held-out logs in a smaller share of the resamples."""
    most_lost: float = 0.02
    """Effects that help little stay where the gap of held-out logs closes less by this share without them."""
    least_part: float = 0.05
    """Without a clock, an effect stays where the gap of held-out logs closes less without it by this share."""
    least_closure: float = 0.05
    """Smallest share of the headline gap of held-out logs that it must close beyond the causes found before."""
    least_sure: float = 0.9
    """Smallest share of resampled logs on which it must be better than these."""

    def __post_init__(self) -> None:
        """Refuse numbers that mean nothing: a fit without a step has no derivatives."""
        for name in ("first_steps", "all_steps", "steps", "most_causes"):
            if getattr(self, name) < 1:
                where = f"diagnose.settings.joint.{name}"
                raise InputError(where, f"{getattr(self, name)}", "1 or more", "correct it")


@dataclass(frozen=True)
class Trial:
    """Numbers that a step has led to, with the errors of all logs and minus the logarithm of the likelihood there."""

    numbers: np.ndarray
    errors: Sequence[LogErrors]
    loss: float


@dataclass(frozen=True)
class JointFit:
    """Fits sets of effects to whole logs and short pieces together."""

    heldout_gap: HeldOutGap
    short: ShortRollouts
    evidence: Sequence[Evidence]
    plan: JointFitSettings = field(default_factory=JointFitSettings)
    progress: Callable[[str], None] = lambda _: None
    in_parts: bool = False
    """Whether effects have numbers of their own at the parts of a robot: in logs that need no clock of their own."""
    none_gap: float = 2.7
    """Largest gap, in noise floors, that noise and tolerances explain, as in ``DecisionThresholds``."""
    losses: dict[tuple[tuple[str, ...], bytes], float] = field(default_factory=dict)
    """Minus the logarithm of the likelihood by effects, places and numbers, of sets that were replayed."""
    ends: list[Linearised] = field(default_factory=list)
    """Where fits to whole logs have ended, in turn; the first is that of all effects that short pieces leave."""

    def search(self, hypotheses: Sequence[Hypothesis], found: Sequence[Hypothesis] = ()) -> list[FullRolloutCause]:
        """Fit all effects, take away those that do not matter, and return the rest, what matters most first.

        Short pieces answer almost linearly: effects that they tell to be absent go first, by the curvature. Whole logs
        answer to large changes in ways that no curvature tells, so that replays judge the others. ``found`` are the
        hypotheses of a search one by one, at whose places effects act in parts of the robot.
        """
        if self.in_parts:
            every = self.fit_in_parts(at_parts(hypotheses, found), hypotheses)
            fit = part(every, self.without_idle(every, self.losses_without, IDLE))
        else:
            every = fit = self.fit_beside_clock(at_all_places(hypotheses))
        replayed = self.without_idle(fit, self.replayed_losses_without, self.plan.least_gain, self.plan.most_causes)
        fit = self.fit_part(fit, replayed)
        useful = self.without_useless(fit)
        if len(useful) < len(fit.hypotheses):
            again = self.fit_part(fit, useful)
            if self.closes(fit) - self.closes(again) < self.plan.most_lost:
                fit = again
        if not self.in_parts:
            return self.ordered(fit, {})
        fit = self.without_small(fit)
        return self.ordered(fit, self.rivals(every, fit))

    def fit_beside_clock(self, every: tuple[Hypothesis, ...]) -> FullRolloutFit:
        """The fit of all effects but those that short pieces tell to be absent."""
        near = self.fit(every, self.numbers(every).centre, self.plan.first_steps, whole=False)
        near = part(near, self.without_idle(near, self.losses_without, self.plan.least_sign, among=self.told_by(near)))
        self.progress(f"by short pieces, {in_words(near)}")
        return self.fit(near.hypotheses, near.numbers, self.plan.all_steps)

    def fit_in_parts(self, every: tuple[Hypothesis, ...], hypotheses: Sequence[Hypothesis]) -> FullRolloutFit:
        """The fit of all effects, with one number for the whole robot where its parts need none of their own."""
        near = self.fit(every, self.numbers(every).centre, self.plan.first_steps, whole=False)
        fit = self.fit(every, near.numbers, self.plan.all_steps)
        kept, numbers = merge_alike(fit, hypotheses, self.plan.least_gain)
        if len(kept) < len(every):
            fit = self.fit(kept, numbers, self.plan.steps)
        effects = fit.typical_effects(self.heldout_gap.names)
        lasting = [k for k, one in enumerate(effects) if not one.is_undone_by(effects, fit.hypotheses[k].robot)]
        if len(lasting) < len(effects):
            own = part(fit, lasting)
            fit = self.fit(own.hypotheses, own.numbers, self.plan.steps)
        self.progress(f"all effects, {in_words(fit)}: closes {self.closes(fit):.2f}")
        return fit

    def rivals(self, every: FullRolloutFit, fit: FullRolloutFit) -> dict[str, str]:
        """Effect of a fit → another effect that is as likely in its place, or closes as much of held-out logs' gap.

        ``every`` is the fit of all effects; by its curvature, one effect is tried in the place of each.
        """
        of = {name: [k for k, n in enumerate(every.names) if n == name] for name in every.names}
        kept = [every.hypotheses.index(h) for h in fit.hypotheses]
        loss, cost, found = self.loss_at(fit), cost_of_others(every, kept), dict[str, str]()
        for name in dict.fromkeys(fit.names):
            rest = [k for k in kept if every.names[k] != name]
            sets = {other: [*rest, *places] for other, places in of.items() if other not in fit.names}
            costs = {other: cost_of_others(every, some) for other, some in sets.items()}
            other = min(costs, key=lambda one: costs[one], default=None)
            if other is None or costs[other] - cost > PROMISING * self.plan.least_gain:
                continue
            start = part(every, sets[other])
            again = self.fit(start.hypotheses, start.numbers, self.plan.steps)
            closes = self.closes(again)
            self.progress(f"{other} for {name}: loss {again.loss:.0f}, was {loss:.0f}, closes {closes:.2f}")
            if again.loss < loss + self.plan.least_gain or closes > self.closes(fit) - self.plan.most_lost:
                found[name] = other
        return found

    def closes(self, fit: FullRolloutFit) -> float:
        """Share of the headline gap that a fit closes on held-out logs."""
        return self.heldout_gap.closure_value(fit.heldout)

    @cached_property
    def likelihood(self) -> JointLikelihood:
        """The likelihood that is fitted."""
        return JointLikelihood(self.heldout_gap, self.short)

    @cached_property
    def told(self) -> Mapping[str, Evidence]:
        """Evidence by the parameter that it tells."""
        return {one.quantity: one for one in self.evidence}

    def numbers(self, hypotheses: tuple[Hypothesis, ...]) -> Numbers:
        """The numbers of some hypotheses, with what evidence says of them."""
        return Numbers.of(hypotheses, self.told)

    def is_told(self, hypothesis: Hypothesis) -> bool:
        """Whether evidence alone says that an effect is there."""
        own = ((p, self.told.get(f"{hypothesis.name}.{p.name}")) for p in hypothesis.parameters)
        return any(one is not None and sure(one.value - p.nominal, one.spread) for p, one in own)

    def fit(
        self, hypotheses: tuple[Hypothesis, ...], numbers: np.ndarray, steps: int, whole: bool = True
    ) -> FullRolloutFit:
        """The most likely numbers of a set of effects, with their covariance and those of each fold.

        ``whole``: errors of whole logs count beside those of short pieces. Derivatives are most of the work and change
        little from step to step: after the first step, each takes those of every other log anew.
        """
        about, every = self.numbers(hypotheses), list(self.likelihood.logs)
        (at,) = self.tried(about, [clip_numbers(hypotheses, numbers)], whole)
        slopes: Sequence[LogErrors] = at.errors
        stale, current = every, set[int]()  # logs whose derivatives are taken next, and whose are of these numbers
        for step in range(steps):
            slopes = self.renewed(about, at, whole, slopes, stale)
            current |= set(stale)
            best = self.stepped(about, at, slopes, whole)
            if best.loss < at.loss - SETTLED:
                self.progress(f"joint fit of {len(hypotheses)} effects: loss {best.loss:.0f}, was {at.loss:.0f}")
                at, current = best, set()
                stale = every[step % 2 :: 2]
            elif len(current) < len(every):
                stale = [log for log in every if log not in current]
            else:
                break
        if whole:
            self.ends.append(Linearised(about, at.numbers, at.errors, slopes))
        return self.judged_fit(about, at.numbers, at.errors, slopes, whole)

    def tried(self, about: Numbers, several: Sequence[np.ndarray], whole: bool) -> list[Trial]:
        """Replays of several vectors of numbers."""
        found = self.likelihood.errors(about.hypotheses, several, whole, list(self.likelihood.logs))
        losses = (self.likelihood.loss(of, about.departs(x)) for of, x in zip(found, several, strict=True))
        return [Trial(*one) for one in zip(several, found, losses, strict=True)]

    def stepped(self, about: Numbers, at: Trial, slopes: Sequence[LogErrors], whole: bool) -> Trial:
        """The best of steps of several dampings.

        Without a clock, the least damped is taken alone where it does most of what it promises, which saves replays.
        """
        curvature, slope = self.likelihood.normal(at.errors, slopes, about.departs(at.numbers))
        room = about.room(at.numbers)
        steps = [bounded_step(curvature, slope, damping, room) for damping in DAMPINGS]
        first, *others = (about.moved(at.numbers, step) for step in steps)
        promised = -float(slope @ steps[0] + 0.5 * steps[0] @ curvature @ steps[0])
        (found,) = self.tried(about, [first], whole)
        if self.in_parts and at.loss - found.loss > KEPT_PROMISE * promised > 0:
            return found
        return min([found, *self.tried(about, others, whole)], key=lambda one: one.loss)

    def renewed(
        self,
        about: Numbers,
        at: Trial,
        whole: bool,
        slopes: Sequence[LogErrors],
        logs: Sequence[int],
    ) -> list[LogErrors]:
        """Derivatives of all logs, those of some taken anew."""
        found = self.likelihood.slopes(about, at.numbers, [at.errors[log] for log in logs], whole, logs)
        new = dict(zip(logs, found, strict=True))
        return [new[log] if log in new else slopes[log] for log in self.likelihood.logs]

    def judged_fit(
        self,
        about: Numbers,
        numbers: np.ndarray,
        errors: Sequence[LogErrors],
        slopes: Sequence[LogErrors],
        whole: bool,
    ) -> FullRolloutFit:
        """The fit with its covariance, the numbers of each fold, and its squares on held-out logs."""
        likelihood, folds, departs = self.likelihood, self.heldout_gap.folds, about.departs(numbers)
        equations = [likelihood.normal(errors, slopes, departs, fold) for fold in range(int(folds.max()) + 1)]
        room = about.room(numbers)
        of_folds = np.array([about.moved(numbers, bounded_step(*of, DAMPINGS[1], room)) for of in equations])
        heldout = np.full(len(folds), np.inf)
        if whole:
            candidates = effects_on_logs(about.hypotheses, list(of_folds), self.heldout_gap.names)
            own = [candidates[fold][log] for log, fold in enumerate(folds)]
            heldout = self.heldout_gap.squares_with([own])[0]
        covariance = about.covariance(np.linalg.inv(likelihood.normal(errors, slopes, departs)[0]))
        loss = likelihood.loss(errors, departs)
        return FullRolloutFit(about.hypotheses, numbers, covariance, of_folds, loss, heldout)

    def fit_part(self, fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
        """Some of the effects of a fit, fitted again from their numbers in it."""
        hypotheses = tuple(fit.hypotheses[k] for k in kept)
        numbers = np.concatenate([fit.split()[k] for k in kept])
        again = self.fit(hypotheses, numbers, self.plan.steps)
        self.progress(f"jointly, {in_words(again)}: closes {self.closes(again):.2f}")
        return again

    def told_by(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses of which a fit knows each number much better than it was known before."""
        spread = np.sqrt(np.diag(fit.covariance)) / self.numbers(fit.hypotheses).spread
        return [k for k, (begin, end) in enumerate(itertools.pairwise(fit.ends)) if spread[begin:end].max() < KNOWN]

    def without_idle(
        self,
        fit: FullRolloutFit,
        losses_without: Callable[[FullRolloutFit, Sequence[int]], np.ndarray],
        least: float,
        most: int | None = None,
        among: Sequence[int] | None = None,
    ) -> list[int]:
        """Indices of at most so many hypotheses without each of which the likelihood falls by ``least`` or more.

        The one that matters least goes first. Those that evidence tells stay and are not counted; so do those that are
        not ``among`` the ones in question.
        """
        kept = list(range(len(fit.hypotheses)))
        stay = [self.is_told(h) or (among is not None and k not in among) for k, h in enumerate(fit.hypotheses)]
        while (open_to_doubt := [k for k in kept if not stay[k]]) and len(kept) > 1:
            losses = dict(zip(kept, losses_without(fit, kept), strict=True))
            idlest = min(open_to_doubt, key=lambda k: losses[k])
            if losses[idlest] >= least and (most is None or len(open_to_doubt) <= most):
                break
            kept.remove(idlest)
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

    def without_small(self, fit: FullRolloutFit) -> FullRolloutFit:
        """The fit without causes that close little which the others, fitted again, do not close as well.

        A small cause stays where it closes more than is left with it, and noise does not explain what is left without.
        """
        gap = self.heldout_gap
        while len(fit.hypotheses) > 1:
            each = range(len(fit.hypotheses))
            fewer = [part(fit, [other for other in each if other != k]) for k in each]
            closes = [gap.closure_value(squares) for squares in gap.squares(fewer)]
            again = self.fit_part(fit, [k for k in each if k != int(np.argmax(closes))])
            lost, left = self.closes(fit) - self.closes(again), 1 - self.closes(fit)
            by_noise = gap.gap(again.heldout) <= self.none_gap * gap.gap(gap.floor)
            if lost >= self.plan.least_part or (lost > left and not by_noise):
                break
            fit = again
        return fit

    def losses_without(self, fit: FullRolloutFit, kept: Sequence[int]) -> np.ndarray:
        """Fall of the logarithm of the likelihood without each of the kept hypotheses, the others fitted anew.

        By the curvature at the fit; hypotheses that are not kept are nominal.
        """
        own, shift, inner = where_others_are_nominal(fit, kept)
        departs = fit.departs[own] + shift
        ends = np.cumsum([0, *(len(fit.hypotheses[k].parameters) for k in kept)])
        at = [list(range(begin, end)) for begin, end in itertools.pairwise(ends)]
        return np.array([0.5 * departs[i] @ np.linalg.solve(inner[np.ix_(i, i)], departs[i]) for i in at])

    def replayed_losses_without(self, fit: FullRolloutFit, kept: Sequence[int]) -> np.ndarray:
        """As ``losses_without``, by replays where the others are at their numbers by the curvature.

        Only the few that may matter least by the curvature are replayed; the others count as needed.
        """
        losses = dict(zip(kept, self.losses_without(fit, kept), strict=True))
        doubtful = sorted((k for k in kept if not self.is_told(fit.hypotheses[k])), key=lambda k: losses[k])[:REPLAYED]
        tried = [part(fit, kept), *(part(fit, [other for other in kept if other != k]) for k in doubtful)]
        whole, *without = [self.loss_at(one) for one in tried]
        found = dict(zip(doubtful, without, strict=True))
        return np.array([found.get(k, np.inf) - whole for k in kept])

    def loss_at(self, fit: FullRolloutFit) -> float:
        """Minus the logarithm of the likelihood at the numbers of a fit, by replays; each is made once."""
        key = (tuple(h.label for h in fit.hypotheses), fit.numbers.tobytes())
        if key not in self.losses:
            (errors,) = self.likelihood.errors(fit.hypotheses, [fit.numbers], True, list(self.likelihood.logs))
            self.losses[key] = self.likelihood.loss(errors, self.numbers(fit.hypotheses).departs(fit.numbers))
        return self.losses[key]

    def ordered(self, fit: FullRolloutFit, rivals: Mapping[str, str]) -> list[FullRolloutCause]:
        """The causes of a fit, what matters most first, each with the fit of those up to it and its rival.

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
            FullRolloutCause(step, (step.names[-1], *filter(None, [rivals.get(step.names[-1])])), probability)
            for step, probability in zip(steps, sure or [1.0], strict=True)
        ]


def where_others_are_nominal(fit: FullRolloutFit, kept: Sequence[int]) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Indices of the numbers of some hypotheses, their shift if all others are nominal, and their covariance then.

    By the curvature at the fit: (numbers,), (numbers,) and (numbers, numbers).
    """
    own = fit.indices(kept)
    gone = fit.indices([k for k in range(len(fit.hypotheses)) if k not in kept])
    departs = fit.departs[gone]
    precision = np.linalg.inv(fit.covariance)
    covariance = np.linalg.inv(precision[np.ix_(own, own)])
    return own, covariance @ precision[np.ix_(own, gone)] @ departs, covariance


def cost_of_others(fit: FullRolloutFit, kept: Sequence[int]) -> float:
    """Fall of the logarithm of the likelihood if all but some hypotheses are nominal, by the curvature at the fit."""
    gone = fit.indices([k for k in range(len(fit.hypotheses)) if k not in kept])
    departs = fit.departs[gone]
    return float(0.5 * departs @ np.linalg.solve(fit.covariance[np.ix_(gone, gone)], departs))


def part(fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
    """Some causes of a fit, in this order, at their best numbers by the curvature where all others are nominal."""
    hypotheses = tuple(fit.hypotheses[k] for k in kept)
    own, shift, inner = where_others_are_nominal(fit, kept)
    numbers = clip_numbers(hypotheses, fit.numbers[own] + shift)
    of_folds = np.array([clip_numbers(hypotheses, fold + shift) for fold in fit.fold_numbers[:, own]])
    return FullRolloutFit(hypotheses, numbers, inner, of_folds, fit.loss, fit.heldout)
