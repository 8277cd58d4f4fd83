"""Fits of sets of effects to whole logs and short pieces in one likelihood.

Causes that act together can each look wrong alone: right legs on soft feet open the gap. So all effects are fitted at
once, drawn towards the nominal robot and towards what evidence says. ``joint_search`` takes away those without which
the likelihood hardly falls, and fits the rest again.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import Candidate, clip_numbers, effects_on_logs
from leapgap.diagnosis.evidence.base import Evidence, sure
from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_likelihood import (
    JointLikelihood,
    Linearised,
    Numbers,
    bounded_step,
)
from leapgap.diagnosis.log_errors import LogErrors, chi2_of_pieces, updated
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError

DAMPINGS = (0.02, 0.2, 1.0, 5.0)
"""Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature."""
KEPT_PROMISE = 0.5
"""A step is taken without trying others where the likelihood rises by this share of what its curvature promised."""
SETTLED = 5.0
"""A fit has converged when the logarithm of its likelihood rises by less than this."""
SHORT_STEPS = 0.5
"""Share of what steps of a quarter change from which on these explain logs better than the usual steps."""
NEAR_NOISE = 2.0
"""Largest median over pieces of χ² over its expectation at which the error of a step can be told from causes."""
FINE_FITS, FINE_SETTLED = 2, 0.5
"""Most steps of a fit of an answer's numbers alone, which begins near its end, and when it has converged."""


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
    """Largest number of causes together, without those that consistency checks give."""
    least_sign: float = 3.0
    """An effect that segments determine is taken away where their log likelihood falls by less without it."""
    least_gain: float = 6.0
    """An effect without which the log likelihood of whole logs and segments falls by less is taken away."""
    least_useful: float = 0.8
    """An effect is taken away where it helps on held-out logs in a smaller share of the resamples."""
    most_lost: float = 0.02
    """Effects that help little stay where they explain less than this share of the gap of held-out logs."""
    least_part: float = 0.05
    """Without a clock, an effect stays where it explains this share of the gap of held-out logs."""
    least_share: float = 0.15
    """It stays as well where the logarithm of the likelihood falls without it by this share of its rise by all."""
    least_likelier: float = 40.0
    """On a held robot it stays as well where the logarithm of the likelihood falls without it by more, if held-out logs
    are significantly nearer with it; and what a fit of all effects has found takes the place of what a search one by
    one has, where it is likelier by more and explains more."""
    clear_gain: float = 60.0
    """A further cause that gained so much in short segments is tried on whole logs even where noise explains their
    rest. Errors in the simulation of the causes before it give gains of up to 50."""
    least_closure: float = 0.05
    """Smallest share of the headline gap of held-out logs that it must close beyond the causes found before."""
    least_sure: float = 0.9
    """Smallest share of resampled logs on which it must be better than these."""

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
    in_parts: bool = False
    """Whether effects have numbers of their own at the parts of a robot: in logs that need no clock of their own."""
    near: Candidate | None = None
    """A robot near which the error of the simulation's step is taken; None: the step is not in doubt."""
    tolerances: Mapping[str, float] = field(default_factory=dict)
    """``Settings.tolerances``, taken about that robot."""
    last: Sequence[str] = ()
    """Names of effects that are looked for beside the answer: each can do what several others do."""
    short_gap: HeldOutGap | None = None
    """The gap by short steps, where these explain the logs better."""
    usual: bool = False
    """Whether the usual steps are known to explain them as well."""
    made: dict[int | None, JointLikelihood] = field(default_factory=dict)
    """The likelihoods made so far, by identity of ``near``."""
    losses: dict[tuple[tuple[str, ...], bytes], float] = field(default_factory=dict)
    """Minus the logarithm of the likelihood by effects, places and numbers, of sets that were replayed."""
    notes: list[str] = field(default_factory=list)
    """What a report must say of how sets were judged."""
    ends: list[Linearised] = field(default_factory=list)
    """Where fits to whole logs have ended, in turn; the first is that of all effects that short pieces leave."""

    def closes(self, fit: FullRolloutFit) -> float:
        """Share of the headline gap that a fit closes on held-out logs."""
        return self.judging.closure_value(fit.heldout)

    @property
    def judging(self) -> HeldOutGap:
        """The gap of held-out logs that sets are judged by."""
        return self.heldout_gap if self.short_gap is None else self.short_gap

    @property
    def steps_known(self) -> bool:
        """Whether it is known by which steps of the simulation logs are explained."""
        return self.near is None or self.short_gap is not None or self.usual

    def by_steps_of(self, candidate: Candidate) -> "JointFit | None":
        """The same, judged by the steps of the simulation that explain a candidate's short pieces better.

        None where it leaves much more than noise: then causes that it lacks may look like the error of a step.
        """
        if self.steps_known:
            return self
        share, left = self.share_and_rest(candidate)
        if left > NEAR_NOISE:
            return None
        if share < SHORT_STEPS:
            return replace(self, usual=True)
        short_gap = self.heldout_gap.by_short_steps
        period = self.heldout_gap.judged.logs[0].info.sample_period_s
        steps = [math.ceil(period / gap.replayer.largest_step_s) for gap in (self.heldout_gap, short_gap)]
        usual_ms, short_ms = (1e3 * period / number for number in steps)
        note = (
            f"a time step of {short_ms:.2g} ms explains these logs better than {usual_ms:.2g} ms, whose error looks "
            "like damping and lag; causes were chosen with the short step"
        )
        if note not in self.notes:
            self.notes.append(note)
            self.progress(note)
        return replace(self, short_gap=short_gap)

    def share_and_rest(self, candidate: Candidate) -> tuple[float, float]:
        """Share of short steps that a candidate tells, and the median over pieces of χ² over its expectation."""
        likelihood = self.likelihood
        errors = likelihood.errors_of(candidate)
        numbers = likelihood.beside.likeliest(errors, self.heldout_gap.folds)
        left = chi2_of_pieces(likelihood.beside.at(errors, numbers))
        return likelihood.beside.step_share(numbers), float(np.median(left))

    def explains_pieces(self, candidate: Candidate) -> bool:
        """Whether a candidate leaves little more than noise in short pieces."""
        return self.share_and_rest(candidate)[1] <= NEAR_NOISE

    def by_usual_steps(self) -> "JointFit":
        """The same by the usual steps of the simulation, whose error is not looked for."""
        return replace(self, near=None, made={None: self.likelihood.with_step_known()}, losses={})

    def by_short_steps(self, hypotheses: tuple[Hypothesis, ...], numbers: np.ndarray) -> FullRolloutFit:
        """The fit of a set of effects from some numbers, by short steps of the simulation."""
        short = self.short.with_steps(self.judging.replayer.largest_step_s)
        beside = self.likelihood.beside.without_step()
        made: dict[int | None, JointLikelihood] = {None: JointLikelihood(self.judging, short, beside)}
        fine = replace(
            self, near=None, heldout_gap=self.judging, short=short, short_gap=None, ends=[], made=made, losses={}
        )
        return fine.fit(hypotheses, numbers, FINE_FITS, settled=FINE_SETTLED)

    def by_whole_logs(self, candidate: Candidate) -> FullRolloutFit:
        """The fit of the effects of a candidate from its numbers, by the usual steps."""
        own = replace(self, near=None, ends=[], made={None: self.likelihood_about(candidate, alone=True)}, losses={})
        return own.fit(candidate.hypotheses, candidate.numbers, FINE_FITS, settled=FINE_SETTLED)

    @cached_property
    def nominal_loss(self) -> float:
        """Minus the logarithm of the likelihood of the nominal robot."""
        (errors,) = self.likelihood.errors((), [np.zeros(0)], True, list(self.likelihood.logs))
        return self.likelihood.loss(errors, np.zeros(0))

    @property
    def likelihood(self) -> JointLikelihood:
        """The likelihood that is fitted."""
        key = None if self.near is None else id(self.near)
        if key not in self.made:
            self.made[key] = self.likelihood_about(self.near)
        return self.made[key]

    def likelihood_about(self, candidate: Candidate | None, alone: bool = False) -> JointLikelihood:
        """The likelihood with the numbers beside those of effects, about a candidate; None: without them.

        ``alone`` as in ``tolerance_effects``.
        """
        likelihood = JointLikelihood(self.heldout_gap, self.short)
        if candidate is None:
            return likelihood
        return likelihood.with_tolerances(candidate, self.tolerances, alone).with_step_unknown(candidate)

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
        self,
        hypotheses: tuple[Hypothesis, ...],
        numbers: np.ndarray,
        steps: int,
        whole: bool = True,
        settled: float = SETTLED,
    ) -> FullRolloutFit:
        """The most likely numbers of a set of effects, with their covariance and those of each fold.

        It ends where the logarithm of the likelihood rises by less than ``settled``.
        ``whole``: errors of whole logs count beside those of short pieces. Derivatives are most of the work and change
        little from step to step: after the first step, each takes those of every other log anew. Without a clock, steps
        that do what the derivatives promise go on with these, updated by what was seen, and are not counted.
        """
        about, every = self.numbers(hypotheses), list(self.likelihood.logs)
        (at,) = self.tried(about, [clip_numbers(hypotheses, numbers)], whole)
        slopes: Sequence[LogErrors] = at.errors
        stale, current = every, set[int]()  # logs whose derivatives are taken next, and whose are of these numbers
        taken = 0
        while taken < steps or not stale:
            if stale:
                slopes = self.renewed(about, at, whole, slopes, stale)
                current |= set(stale)
                taken += 1
            best, as_promised = self.stepped(about, at, slopes, whole)
            if best.loss < at.loss - settled:
                self.progress(f"joint fit of {len(hypotheses)} effects: loss {best.loss:.0f}, was {at.loss:.0f}")
                if self.in_parts:
                    by = about.departs(best.numbers) - about.departs(at.numbers)
                    slopes = [updated(*of, by) for of in zip(slopes, at.errors, best.errors, strict=True)]
                at, current = best, set()
                stale = [] if as_promised else every[(taken - 1) % 2 :: 2]
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

    def stepped(self, about: Numbers, at: Trial, slopes: Sequence[LogErrors], whole: bool) -> tuple[Trial, bool]:
        """The best of steps of several dampings, and whether it does most of what the derivatives promise.

        Without a clock, the least damped is taken alone where it does most of what it promises, which saves replays.
        """
        curvature, slope = self.likelihood.normal(at.errors, slopes, about.departs(at.numbers))
        room = about.room(at.numbers)
        steps = [bounded_step(curvature, slope, damping, room) for damping in DAMPINGS]
        first, *others = (about.moved(at.numbers, step) for step in steps)
        promised = -float(slope @ steps[0] + 0.5 * steps[0] @ curvature @ steps[0])
        (found,) = self.tried(about, [first], whole)
        if self.in_parts and at.loss - found.loss > KEPT_PROMISE * promised > 0:
            return found, True
        return min([found, *self.tried(about, others, whole)], key=lambda one: one.loss), False

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
            heldout = self.judging.squares_with([own])[0]
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
