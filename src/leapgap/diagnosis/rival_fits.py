"""Fits that could be true in place of the answer, which the next experiment is to tell apart from it."""

from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.decision import Judgement, probability

PLACES = 2
"""Number of rivals in the place of one cause that experiments are to tell apart."""


@dataclass(frozen=True)
class Rival:
    """A set of causes that could be true."""

    name: str
    """Name of the effect that may be the one."""
    fit: Candidate


@dataclass(frozen=True)
class Undecided:
    """What an answer leaves open."""

    names: tuple[str, ...] = ()
    """The first cause of the answer that has rivals, with these; empty where none has."""
    fits: tuple[Rival, ...] = ()
    """The answer, and fits with the other names in its place; empty without an answer."""
    share: float = 0.0
    """Probability of the likeliest rival."""


def undecided_of(judgement: Judgement) -> Undecided:
    """What a search for one cause leaves open: each rival stands in the place of the cause, where it fits best."""
    if not judgement.conclusion.answer:
        return Undecided()
    selected, result = judgement.selected, judgement.result
    names = next((names for names in judgement.conclusion.answer if len(names) > 1), ())
    found = [Rival(names[0] if names else selected.names[0], selected)]
    for name in names[1:]:
        single = next(fit for fit in result.singles if fit.names == (name,))
        found.append(Rival(name, in_place_of(selected, names[0], single)))
    share = max((probability(name, result, judgement.shares) for name in names[1:]), default=0.0)
    return Undecided(names, tuple(Rival(one.name, without_clocks(one.fit)) for one in found), share)


def in_place_of(answer: Candidate, own: str, single: Candidate) -> Candidate:
    """The answer with the one cause of another fit in place of one of its own."""
    kept = [k for k, name in enumerate(answer.names) if name != own]
    parts, spreads = answer.split(), answer.split(np.diag(answer.covariance))
    hypotheses = (*(answer.hypotheses[k] for k in kept), single.hypotheses[-1])
    numbers = np.concatenate([*(parts[k] for k in kept), single.split()[-1]])
    variances = np.concatenate([*(spreads[k] for k in kept), single.split(np.diag(single.covariance))[-1]])
    return Candidate(hypotheses, numbers, np.diag(variances), np.tile(numbers, (1, 1)))


def without_clocks(fit: Candidate) -> Candidate:
    """The fit without causes whose values are those of single logs: they are the same in every experiment."""
    kept = [k for k, h in enumerate(fit.hypotheses) if h.per_log is None]
    if len(kept) == len(fit.hypotheses):
        return fit
    which = np.array(fit.indices(kept), int)
    covariance = fit.covariance[np.ix_(which, which)]
    return Candidate(tuple(fit.hypotheses[k] for k in kept), fit.numbers[which], covariance, fit.fold_numbers[:, which])
