"""Fits of sets of effects to whole logs and short pieces in one likelihood.

Causes that act together can each look wrong alone: right legs on soft feet open the gap. So all effects are fitted at
once, drawn towards the nominal robot and towards what evidence says. ``joint_search`` takes away those without which
the likelihood hardly falls, and fits the rest again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import Candidate, clip_numbers, effects_on_logs
from leapgap.diagnosis.evidence.base import Evidence, sure
from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_likelihood import JointLikelihood, Linearised, Numbers, bounded_step
from leapgap.diagnosis.log_errors import LogErrors
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError

DAMPINGS = (0.02, 0.2, 1.0, 5.0)  # Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature
SETTLED = 5.0  # A fit has converged when the logarithm of its likelihood rises by less than this


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
    """Fits sets of effects to whole logs and short pieces together."""

    heldout_gap: HeldOutGap
    short: ShortRollouts
    evidence: Sequence[Evidence]
    plan: JointFitSettings = field(default_factory=JointFitSettings)
    progress: Callable[[str], None] = lambda _: None
    losses: dict[tuple[tuple[str, ...], bytes], float] = field(default_factory=dict)
    """Minus the logarithm of the likelihood by effects, places and numbers, of sets that were replayed."""
    ends: list[Linearised] = field(default_factory=list)
    """Where fits to whole logs have ended, in turn; the first is that of all effects that short pieces leave."""

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
            slopes = self.renewed(about, at, whole, slopes, stale)
            current |= set(stale)
            best = self.stepped(about, at, slopes, whole)
            if best.loss < at.loss - SETTLED:
                self.progress(f"joint fit of {len(hypotheses)} effects: loss {best.loss:.0f}, was {at.loss:.0f}")
                at, current, stale = best, set(), every[taken % 2 :: 2]
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
        """The best of steps of several dampings."""
        curvature, slope = self.likelihood.normal(at.errors, slopes, about.departs(at.numbers))
        room = about.room(at.numbers)
        steps = (bounded_step(curvature, slope, damping, room) for damping in DAMPINGS)
        tried = self.tried(about, [about.moved(at.numbers, step) for step in steps], whole)
        return min(tried, key=lambda one: one.loss)

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

    def loss_at(self, fit: Candidate) -> float:
        """Minus the logarithm of the likelihood at the numbers of a candidate, by replays; each is made once."""
        key = (tuple(h.label for h in fit.hypotheses), fit.numbers.tobytes())
        if key not in self.losses:
            (errors,) = self.likelihood.errors(fit.hypotheses, [fit.numbers], True, list(self.likelihood.logs))
            self.losses[key] = self.likelihood.loss(errors, self.numbers(fit.hypotheses).departs(fit.numbers))
        return self.losses[key]


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
