"""Fits of sets of effects to whole logs and short pieces in one likelihood, and which effects stay.

Causes that act together can each look wrong alone: right legs on soft feet open the gap. So all effects are fitted at
once, drawn towards the nominal robot and towards what evidence says. Then those without which the likelihood hardly
falls are taken away, and the rest is fitted again.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import Candidate, clip_numbers, effects_on_logs, in_words
from leapgap.diagnosis.evidence.base import Evidence, sure
from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis, parts_of
from leapgap.diagnosis.joint_likelihood import JointLikelihood, LogErrors, Numbers, bounded_step
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError

DAMPINGS = (0.02, 0.2, 1.0, 5.0)  # Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature
SETTLED = 5.0  # A fit has converged when the logarithm of its likelihood rises by less than this
REPLAYED = 4  # So many effects, those that matter least by the curvature, are taken away in turn by replays
KNOWN = 0.5  # Pieces tell a number where its spread after them is a smaller share of the one before


@dataclass(frozen=True)
class JointFitSettings:
    """Width of the joint fit, and when an effect is taken away."""

    first_steps: int = 4
    """Steps of all effects to short segments alone, which answer almost linearly."""
    all_steps: int = 4
    """Largest number of steps to whole logs and segments of the effects that segments leave."""
    steps: int = 6
    """Largest number of steps of later fits, of fewer effects."""
    most_causes: int = 8
    """Largest number of causes together, without those that evidence tells."""
    least_sign: float = 3.0
    """An effect that segments determine is taken away where their log likelihood falls by less without it."""
    least_gain: float = 6.0
    """An effect without which the log likelihood of whole logs and segments falls by less is taken away."""
    most_lost: float = 0.02
    """Effects that explain less than this share of the gap of held-out logs together are taken away."""
    least_closure: float = 0.05
    """Smallest share of the headline gap of held-out logs that the set must close beyond the clock alone."""
    least_sure: float = 0.9
    """Smallest share of resampled logs on which it must be better."""
    enough_closure: float = 0.7
    """An answer that explains less of the headline gap of held-out logs is ``partly``."""
    enough_jointly: float = 0.9
    """The same of an answer with a number at the end of its range."""

    def __post_init__(self) -> None:
        """Refuse numbers that mean nothing: a fit without a step has no derivatives."""
        for name in ("first_steps", "all_steps", "steps", "most_causes"):
            if getattr(self, name) < 1:
                where = f"settings.joint.{name}"
                raise InputError(where, f"{getattr(self, name)}", "1 or more", "correct it")


@dataclass(frozen=True)
class Trial:
    """Numbers that a step has led to, with the errors of all logs and minus the logarithm of the likelihood there."""

    numbers: np.ndarray
    errors: Sequence[LogErrors]
    loss: float


@dataclass(frozen=True)
class JointFit:
    """Fits sets of effects to whole logs and short pieces together, and searches among them.

    The search is that in logs by their own clock, beside which effects act at all places, or at parts of a held robot.
    Short pieces answer almost linearly: effects that they tell to be absent go first, by the curvature. Whole logs
    answer to large changes in ways that no curvature tells, so that replays judge the others.
    """

    heldout_gap: HeldOutGap
    short: ShortRollouts
    evidence: Sequence[Evidence]
    plan: JointFitSettings = field(default_factory=JointFitSettings)
    progress: Callable[[str], None] = lambda _: None
    losses: dict[tuple[tuple[str, ...], bytes], float] = field(default_factory=dict)
    """Minus the logarithm of the likelihood by effects, places and numbers, of sets that were replayed."""
    ends: list[FullRolloutFit] = field(default_factory=list)
    """Fits to whole logs, in turn; the first is that of all effects that short pieces leave."""

    def closes(self, fit: FullRolloutFit) -> float:
        """Share of the headline gap that a fit closes on held-out logs."""
        return self.heldout_gap.closure_value(fit.heldout)

    def surely_helps(self, fit: FullRolloutFit) -> bool:
        """Whether a fit explains more of held-out logs than the nominal robot, beyond doubt."""
        gap = self.heldout_gap
        more = self.closes(fit) - gap.closure_value(gap.nominal)
        return more >= self.plan.least_closure and gap.share_better(fit.heldout, gap.nominal) >= self.plan.least_sure

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
        for taken in range(steps):
            found = self.likelihood.slopes(about, at.numbers, [at.errors[log] for log in stale], whole, stale)
            new = dict(zip(stale, found, strict=True))
            slopes = [new[log] if log in new else slopes[log] for log in every]
            current |= set(stale)
            best = self.stepped(about, at, slopes, whole)
            if best.loss < at.loss - SETTLED:
                self.progress(f"joint fit of {len(hypotheses)} effects: loss {best.loss:.0f}, was {at.loss:.0f}")
                at, current, stale = best, set(), every[taken % 2 :: 2]
            elif len(current) < len(every):
                stale = [log for log in every if log not in current]
            else:
                break
        end = self.judged_fit(about, at.numbers, at.errors, slopes, whole)
        if whole:
            self.ends.append(end)
        return end

    def tried(self, about: Numbers, several: Sequence[np.ndarray], whole: bool) -> list[Trial]:
        """Replays of several vectors of numbers."""
        found = self.likelihood.errors(about.hypotheses, several, whole, list(self.likelihood.logs))
        losses = (self.likelihood.loss(of, about.departs(x)) for of, x in zip(found, several, strict=True))
        return [Trial(*one) for one in zip(several, found, losses, strict=True)]

    def stepped(self, about: Numbers, at: Trial, slopes: Sequence[LogErrors], whole: bool) -> Trial:
        """The best of steps of several dampings."""
        curvature, slope = self.likelihood.normal(at.errors, slopes, about.departs(at.numbers))
        room = about.room(at.numbers)
        steps = (bounded_step(curvature, slope, damping, room) for damping in DAMPINGS)
        tried = self.tried(about, [about.moved(at.numbers, step) for step in steps], whole)
        return min(tried, key=lambda one: one.loss)

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

    def loss_at(self, fit: Candidate) -> float:
        """Minus the logarithm of the likelihood at the numbers of a candidate, by replays; each is made once."""
        key = (tuple(h.label for h in fit.hypotheses), fit.numbers.tobytes())
        if key not in self.losses:
            (errors,) = self.likelihood.errors(fit.hypotheses, [fit.numbers], True, list(self.likelihood.logs))
            self.losses[key] = self.likelihood.loss(errors, self.numbers(fit.hypotheses).departs(fit.numbers))
        return self.losses[key]

    def search(self, near: FullRolloutFit) -> tuple[tuple[FullRolloutFit, ...], tuple[float, ...]]:
        """Fits of the first one, two, … causes, what matters most first, and the probability of each cause.

        That is the share of resampled logs on which the whole set is better than without it. ``near`` is the fit by
        pieces from which that to whole logs begins. Nothing where the set does not surely help.
        """
        fit = self.reduced(self.fit(near.hypotheses, near.numbers, self.plan.all_steps))
        return self.ordered(fit) if self.surely_helps(fit) else ((), ())

    def by_pieces(self, hypotheses: Sequence[Hypothesis]) -> FullRolloutFit:
        """The fit by short pieces of all effects but those that they tell to be absent.

        They act at all places, or at one of the few parts of a held robot; legs of a walking one are alike.
        """
        every = tuple(
            h
            for h in hypotheses
            if h.location == "all" or (not h.robot.has_free_base and h.location in parts_of(h.kind, h.robot))
        )
        near = self.fit(every, self.numbers(every).centre, self.plan.first_steps, whole=False)
        near = part(near, self.without_idle(near, self.losses_without, self.plan.least_sign, among=self.told_by(near)))
        self.progress(f"by short segments, {in_words(near)}")
        return near

    def told_by(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses of which a fit knows each number much better than it was known before."""
        spread = np.sqrt(np.diag(fit.covariance)) / self.numbers(fit.hypotheses).spread
        return [k for k, (begin, end) in enumerate(itertools.pairwise(fit.ends)) if spread[begin:end].max() < KNOWN]

    def reduced(self, fit: FullRolloutFit) -> FullRolloutFit:
        """The fit of the effects of another one that matter and help on held-out logs."""
        plan = self.plan
        kept = self.without_idle(fit, self.replayed_losses_without, plan.least_gain, plan.most_causes)
        fit = self.fit_part(fit, kept)
        useful = self.without_useless(fit)
        if len(useful) < len(fit.hypotheses):
            again = self.fit_part(fit, useful)
            if self.closes(fit) - self.closes(again) < plan.most_lost:
                fit = again
        return fit

    def fit_part(self, fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
        """Some of the effects of a fit, fitted again from their numbers in it."""
        hypotheses = tuple(fit.hypotheses[k] for k in kept)
        numbers = np.concatenate([fit.split()[k] for k in kept])
        again = self.fit(hypotheses, numbers, self.plan.steps)
        closes = self.closes(again)
        self.progress(f"jointly, {in_words(again)}: explains {closes:.2f}, loss {again.loss:.0f}")
        return again

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
        """Indices of the fewest hypotheses that close nearly as much as all; what helps least goes first.

        What evidence tells goes only where held-out logs are replayed better without it.
        """
        kept, gap, now = list(range(len(fit.hypotheses))), self.heldout_gap, self.closes(fit)
        enough = now - self.plan.most_lost
        while len(kept) > 1:
            without = gap.squares([part(fit, [other for other in kept if other != k]) for k in kept])
            closes = np.array([gap.closure_value(squares) for squares in without])
            room = closes - [now if self.is_told(fit.hypotheses[k]) else enough for k in kept]
            least = int(np.argmax(room))
            if room[least] <= 0:
                break
            kept.pop(least)
            now = float(closes[least])
        return kept

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
        open_to_doubt = [k for k in kept if not self.is_told(fit.hypotheses[k])]
        doubtful = sorted(open_to_doubt, key=lambda k: losses[k])[:REPLAYED]
        tried = [part(fit, kept), *(part(fit, [other for other in kept if other != k]) for k in doubtful)]
        whole, *without = [self.loss_at(one) for one in tried]
        found = dict(zip(doubtful, without, strict=True))
        return np.array([found.get(k, np.inf) - whole for k in kept])

    def ordered(self, fit: FullRolloutFit) -> tuple[tuple[FullRolloutFit, ...], tuple[float, ...]]:
        """The causes of a fit, what matters most first, as ``search`` returns them."""
        kept = list(range(len(fit.hypotheses)))
        last_first = []
        while len(kept) > 1:
            last_first.append(kept.pop(int(np.argmin(self.losses_without(fit, kept)))))
        order = [*kept, *reversed(last_first)]
        without = [part(fit, [k for k in order if k != one]) for one in order] if len(order) > 1 else []
        gap = self.heldout_gap
        sure = [gap.share_better(fit.heldout, own) for own in gap.squares(without)]
        return tuple(part(fit, order[: k + 1]) for k in range(len(order))), tuple(sure or [1.0])


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


def part(fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
    """Some causes of a fit, in this order, at their best numbers by the curvature where all others are nominal."""
    hypotheses = tuple(fit.hypotheses[k] for k in kept)
    own, shift, inner = where_others_are_nominal(fit, kept)
    numbers = clip_numbers(hypotheses, fit.numbers[own] + shift)
    of_folds = np.array([clip_numbers(hypotheses, fold + shift) for fold in fit.fold_numbers[:, own]])
    return FullRolloutFit(hypotheses, numbers, inner, of_folds, fit.loss, fit.heldout)
