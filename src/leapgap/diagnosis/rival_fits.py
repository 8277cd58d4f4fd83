"""Fits that could be true in place of the answer, which the next experiment is to tell apart from it."""

from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.decision import Judgement
from leapgap.diagnosis.rival_sets import probability

PLACES, NEAR = 2, 10.0
"""Number of places at which each open cause is tried, and how near to its best held-out loss they are."""


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
    """What a search one by one leaves open.

    Each name stands with its fits at the best few places: a cause at one joint may be told from its rival where the
    same cause at all joints is not.
    """
    if not judgement.conclusion.answer:
        return Undecided()
    selected, result = judgement.selected, judgement.result
    names = next((names for names in judgement.conclusion.answer if len(names) > 1), ())
    found = [Rival(selected.names[0], selected)] if selected.hypotheses else []
    if names and names[0] in selected.names:
        own = names[0]
        found[0] = Rival(own, selected)
        found += [Rival(name, fit) for name in names for fit in near_fits(judgement, own, name)[:PLACES]]
    share = max((probability(name, result, judgement.shares) for name in names[1:]), default=0.0)
    return Undecided(names, tuple(Rival(one.name, without_clocks(one.fit)) for one in found), share)


def near_fits(judgement: Judgement, own: str, name: str) -> list[Candidate]:
    """Fits of the answer's causes with ``name`` in place of ``own``, best first, the answer itself left out."""
    selected, result = judgement.selected, judgement.result
    wanted = sorted({*selected.names, name} - ({own} - {name}))
    fits = [fit for fit in result.rivals if sorted(fit.names) == wanted and fit.hypotheses != selected.hypotheses]
    best = min((float(fit.heldout.sum()) for fit in fits), default=0.0)
    near: list[Candidate] = [fit for fit in fits if fit.heldout.sum() < best + NEAR]
    if near or name == own:
        return near
    singles = [fit for fit in result.alternatives if fit.names == (name,)]
    return [in_place_of(selected, own, fit) for fit in singles[:1]]


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
