"""A cause that short replays hardly show, in logs that another simulation of the nominal robot explains as well.

A trunk that turns 20 % harder changes a landing and hardly a tenth of a second. Where another integrator or other
contacts bring the gap of whole logs down to noise, too, held-out logs decide: one cause alone is the answer if it
closes most of the gap, and surely more of it than that simulation does.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.diagnosis.candidates import in_words
from leapgap.diagnosis.decision import Judgement, OtherSimulationExplains, conclude_from
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.full_rollouts import FullRolloutCause, FullRolloutFit
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.joint_likelihood import bounded_minimum
from leapgap.diagnosis.joint_sets import at_all_places

FITTED = 3
"""So many effects, those that promise most by the derivatives at the nominal robot, are fitted."""
NARROWER = 0.75
"""The gap with the cause has to be below this share of that by the other simulation."""


def judge_slow_causes(
    judgement: Judgement, fit: JointFit, hypotheses: Sequence[Hypothesis], thresholds: DecisionThresholds
) -> Judgement:
    """The judgement, or one cause in the place of another simulation where it explains held-out logs surely better."""
    other = judgement.conclusion.other_simulation
    if other is None:
        return judgement
    fit = fit.by_steps_of(judgement.result.selected) or fit
    fits = [fit.fit((h,), h.nominal, fit.plan.steps) for h in most_promising(fit, at_all_places(hypotheses))]
    for one in fits:
        gap = fit.judging.gap(one.heldout)
        fit.progress(f"{in_words(one)} alone: gap {gap:.3f}, by another simulation {other.gap:.3f}")
    good = [one for one in fits if is_better(one, other, fit, thresholds)]
    if not good:
        return judgement
    best, *others = sorted(good, key=lambda one: float(one.heldout.sum()))
    sums = np.array([one.heldout[fit.judging.draws].sum(axis=1) for one in (best, *others)])
    shares = np.bincount(sums.argmin(axis=0), minlength=len(sums)) / sums.shape[1]
    rivals = [one.names[0] for one, share in zip(others, shares[1:], strict=True) if share >= thresholds.rival_share]
    conclusion = conclude_from([FullRolloutCause(best, (best.names[0], *rivals), float(shares[0]))])
    return replace(judgement, conclusion=conclusion)


def most_promising(fit: JointFit, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The effects by each of which alone the likelihood rises most, by the derivatives at the nominal robot."""
    likelihood, about = fit.likelihood, fit.numbers(tuple(hypotheses))
    logs, nominal = list(likelihood.logs), np.concatenate([h.nominal for h in hypotheses])
    (errors,) = likelihood.errors(about.hypotheses, [nominal], True, logs)
    slopes = likelihood.slopes(about, nominal, errors, True, logs)
    curvature, slope = likelihood.normal(errors, slopes, about.departs(nominal))
    (lower, upper), ends = about.room(nominal), np.cumsum([0, *(len(h.parameters) for h in hypotheses)])

    def rise(begin: int, end: int) -> float:
        at, by = slice(begin, end), curvature[begin:end, begin:end]
        step = bounded_minimum(by, slope[at], lower[at], upper[at])
        return -float(slope[at] @ step + 0.5 * step @ by @ step)

    rises = [rise(begin, end) for begin, end in itertools.pairwise(ends)]
    return [hypotheses[k] for k in np.argsort(rises)[::-1][:FITTED]]


def is_better(
    one: FullRolloutFit, other: OtherSimulationExplains, fit: JointFit, thresholds: DecisionThresholds
) -> bool:
    """Whether a cause explains most of held-out logs, by a number within its range, and surely better than another
    simulation does."""
    gap = fit.judging
    return bool(
        one.sensible
        and gap.closure_value(one.heldout) >= thresholds.enough_closure
        and gap.gap(one.heldout) <= NARROWER * other.gap
        and gap.share_better(one.heldout, other.squares) >= fit.plan.least_sure
    )
