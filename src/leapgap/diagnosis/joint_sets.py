"""Which effects are fitted together, and which parts of a robot have one number in common."""

from collections.abc import Sequence

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.hypotheses import Hypothesis, parts_of


def at_all_places(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Each effect once, at all places together."""
    return tuple(h for h in hypotheses if h.location == "all" and h.per_log is None)


def at_parts(hypotheses: Sequence[Hypothesis], found: Sequence[Hypothesis] = ()) -> tuple[Hypothesis, ...]:
    """Each effect at every part of the robot, or where a search has ``found`` it if that is none of the parts."""
    chosen: list[Hypothesis] = []
    for name in dict.fromkeys(h.name for h in hypotheses):
        own = [h for h in hypotheses if h.name == name]
        parts = parts_of(own[0].kind, own[0].robot)
        elsewhere = [h for h in found if h.name == name and h.location not in ("all", *parts)]
        apart = [h for h in own if h.location in parts]
        chosen += elsewhere[:1] or apart or [h for h in own if h.location == "all"]
    return tuple(chosen)


def numbers_at(hypotheses: Sequence[Hypothesis], found: Candidate | None) -> np.ndarray:
    """Numbers of some hypotheses as a candidate has them, there or at all places, else nominal, (numbers,)."""
    known = (
        {} if found is None else dict(zip(((h.name, h.location) for h in found.hypotheses), found.split(), strict=True))
    )
    return np.concatenate([known.get((h.name, h.location), known.get((h.name, "all"), h.nominal)) for h in hypotheses])


def merge_alike(
    fit: Candidate, hypotheses: Sequence[Hypothesis], least_gain: float
) -> tuple[tuple[Hypothesis, ...], np.ndarray]:
    """Hypotheses and numbers of a fit, with one number for the whole robot where its parts need none of their own.

    By the curvature at the fit. What costs least is merged first; merging an effect must lower the logarithm of the
    likelihood by less than ``least_gain``, the others fitted anew. ``hypotheses`` hold those at all places.
    """
    numbers, covariance, ends = fit.departs, fit.covariance, fit.ends
    apart = {
        name: [k for k, h in enumerate(fit.hypotheses) if h.name == name]
        for name in fit.names
        if sum(h.name == name for h in fit.hypotheses) > 1
    }
    merged: dict[str, Hypothesis] = {}
    while apart:
        unequal = {name: differences_between(parts, ends) for name, parts in apart.items()}
        costs = {name: cost_of(by, numbers, covariance) for name, by in unequal.items()}
        name = min(costs, key=lambda one: costs[one])
        if costs[name] >= least_gain:
            break
        by = unequal[name]
        pull = covariance @ by.T @ np.linalg.inv(by @ covariance @ by.T)
        numbers, covariance = numbers - pull @ by @ numbers, covariance - pull @ by @ covariance
        merged[name] = next(h for h in hypotheses if h.name == name and h.location == "all")
        del apart[name]
    kept, values = [], []
    for k, (h, begin, end) in enumerate(zip(fit.hypotheses, ends, ends[1:], strict=False)):
        whole = merged.get(h.name)
        if whole is None or h.name not in fit.names[:k]:
            kept.append(whole or h)
            values.append(kept[-1].nominal + numbers[begin:end])
    return tuple(kept), np.concatenate(values)


def differences_between(parts: Sequence[int], ends: np.ndarray) -> np.ndarray:
    """Matrix whose product with all numbers is the numbers of the first part less those of each other one."""
    first, *others = ([*range(ends[k], ends[k + 1])] for k in parts)
    found = np.zeros((len(others) * len(first), int(ends[-1])))
    for row, (one, other) in enumerate(pair for of in others for pair in zip(first, of, strict=True)):
        found[row, one], found[row, other] = 1.0, -1.0
    return found


def cost_of(by: np.ndarray, numbers: np.ndarray, covariance: np.ndarray) -> float:
    """Fall of the logarithm of the likelihood where ``by`` @ numbers is zero, by the curvature."""
    apart = by @ numbers
    return float(0.5 * apart @ np.linalg.solve(by @ covariance @ by.T, apart))
