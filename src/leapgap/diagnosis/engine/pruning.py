"""Which of many effects that act together are needed, in closed form."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from leapgap.diagnosis.engine.evidence import Posterior, posterior_of
from leapgap.diagnosis.engine.points import ABSENT, Acting, Point
from leapgap.diagnosis.hypotheses import Hypothesis


def needed(point: Point, least: float, most: int) -> Acting:
    """At ``most`` so many members of a point, each of which loses ``least`` nats a number where it is taken away.

    One is taken away after the other, the rest making up for it. What is left of an effect has one number for all its
    places where these need no more.
    """
    (deviation, centre), first = point.priors(), point.nuisances
    gram, constant = point.evidence.at_best_levels(deviation, centre).total()
    ends = np.cumsum([first, *(len(numbers) for _, numbers in point.acting)]).tolist()
    at = [slice(begin, end) for begin, end in pairwise(ends)]
    kept = list(range(len(at)))
    while True:
        told = departures(posterior_of(gram, constant, deviation, centre), centre)
        losses = [loss(told, at[m]) - least * (at[m].stop - at[m].start) for m in kept]
        if not kept or (min(losses) > 0 and len(kept) <= most):
            break
        out = kept.pop(int(np.argmin(losses)))
        deviation[at[out]] = ABSENT
    found: list[tuple[Hypothesis, np.ndarray]] = []
    for name in dict.fromkeys(point.acting[m][0].name for m in kept):
        found += at_fewest_places(point, [m for m in kept if point.acting[m][0].name == name], told, at, least)
    return tuple((h, h.clip(h.nominal + off)) for h, off in found)


def departures(told: Posterior, nominal: np.ndarray) -> Posterior:
    """The same posterior of departures from nominal."""
    return Posterior(told.evidence, told.mean - nominal, told.covariance)


def loss(told: Posterior, at: slice | np.ndarray) -> float:
    """Log likelihood that is lost where some numbers are nominal, nats."""
    off = told.mean[at]
    return float(0.5 * off @ np.linalg.solve(told.covariance[at][:, at], off))


def at_fewest_places(point: Point, own: Sequence[int], told: Posterior, at: Sequence[slice], least: float) -> Acting:
    """Members ``own`` of one effect at single places with their departures, or the effect at all of these places.

    That is where a number for each but one of them gains less than ``least`` nats a number.
    """
    members, acting = point.basis.columns.members, point.acting
    name, apart = acting[own[0]][0].name, tuple((acting[m][0], told.mean[at[m]]) for m in own)
    places = {place for m in own for place in members[name, acting[m][0].location]}
    of_all = [h for h in point.basis.hypotheses if h.name == name and {*members[name, h.location]} == places]
    if len(own) == 1 or not of_all or len(of_all[0].parameters) > 1:
        return apart
    which = [at[m].start for m in own]
    contrast = np.concatenate([-np.ones((len(own) - 1, 1)), np.eye(len(own) - 1)], axis=1)
    covariance = contrast @ told.covariance[np.ix_(which, which)] @ contrast.T
    differ = Posterior(0.0, contrast @ told.mean[which], covariance)
    if loss(differ, np.arange(len(own) - 1)) >= least * (len(own) - 1):
        return apart
    return ((of_all[0], np.mean([off for _, off in apart], axis=0)),)
