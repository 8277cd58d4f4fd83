"""The scores of the blind check: the keys of ``metrics/blind.json``, counted from the outcomes of the cases."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from leapgap.validation.outcome import CaseOutcome

Scores = dict[str, Any]


def share(of: Iterable[bool]) -> float | None:
    """Share of true values; ``None`` where there is nothing to count."""
    values = list(of)
    return sum(values) / len(values) if values else None


def median(of: Iterable[float]) -> float | None:
    """Median of the values; ``None`` where there are none."""
    values = list(of)
    return float(np.median(values)) if values else None


def mean(of: Iterable[float]) -> float | None:
    """Mean of the values; ``None`` where there are none."""
    values = list(of)
    return float(np.mean(values)) if values else None


def scores(outcomes: Sequence[CaseOutcome], draws: int, bins: int, rng: np.random.Generator) -> Scores:
    """All scores of one half; a share of nothing is null."""
    singles = [o for o in outcomes if o.kind == "single" and o.detectable]
    pairs = [o for o in outcomes if o.kind == "pair" and o.each_detectable]
    unnamed = [o for o in outcomes if o.kind == "nameless" and o.detectable]
    shown = [o for o in outcomes if o.detectable]
    told = [c for o in singles + pairs for c in o.compared]
    errors = closure_errors(outcomes)
    return {
        "cases": len(outcomes),
        "detectable": len(shown),
        "named_first": share(o.first in o.true for o in singles),
        "named_in_set": share(o.true[0] in o.answered for o in singles),
        "named_alone": share(o.verdict == "named" and o.answered == set(o.true) for o in singles),
        "located": share(true == said for o in singles for true, said in o.locations),
        "set_size_mean": mean(len(names) for o in singles for names in o.answer),
        "wrongly_named": share(o.wrongly_named for o in outcomes),
        "unknown_recall": share(o.verdict == "unknown" for o in unnamed),
        "none_correct": share(o.verdict == "none" for o in outcomes if o.kind == "none"),
        "where_right": share(o.where_right for o in shown),
        "where_right_mirrored": share(o.where_mirrored for o in shown),
        "pairs_both_named": share(o.verdict in ("named", "ambiguous") and set(o.true) <= o.answered for o in pairs),
        "parameter_error_median": median(c.error for c in told),
        "coverage": share(c.interval_holds_truth for c in told),
        "brier": with_interval(outcomes, brier, draws, rng),
        "calibration_error": with_interval(outcomes, lambda these: calibration_error(these, bins), draws, rng),
        "closure_promise_error": mean(errors),
        "closure_promise_within_5_points": share(e <= 0.05 for e in errors),
    }


def closure_errors(outcomes: Iterable[CaseOutcome]) -> list[float]:
    """|promised − realised closure| of every claim on a detectable case."""
    return [
        abs(o.promised - o.realised)
        for o in outcomes
        if o.detectable and o.promised is not None and o.realised is not None
    ]


def claims(outcomes: Iterable[CaseOutcome]) -> tuple[np.ndarray, np.ndarray]:
    """Probability of the first cause of every verdict that claims one, and whether it acted, (claims,) each."""
    pairs = [(o.probability, o.first in o.true) for o in outcomes if o.probability is not None]
    return np.array([p for p, _ in pairs], dtype=float), np.array([r for _, r in pairs], dtype=float)


def brier(outcomes: Iterable[CaseOutcome]) -> float | None:
    """Mean squared difference between the first cause's probability and whether it acted."""
    probability, right = claims(outcomes)
    return float(((probability - right) ** 2).mean()) if len(right) else None


def calibration_error(outcomes: Iterable[CaseOutcome], bins: int) -> float | None:
    """Expected calibration error: |mean probability − share right| over bins, weighted by their claims."""
    found = reliability(outcomes, bins)
    return sum(n * abs(p - r) for p, r, n in found) / sum(n for _, _, n in found) if found else None


def reliability(outcomes: Iterable[CaseOutcome], bins: int) -> list[tuple[float, float, int]]:
    """Mean probability, share right and number of claims of each bin that has some."""
    probability, right = claims(outcomes)
    at = np.minimum((probability * bins).astype(int), bins - 1)
    return [
        (float(probability[at == b].mean()), float(right[at == b].mean()), int((at == b).sum())) for b in np.unique(at)
    ]


def with_interval(
    outcomes: Sequence[CaseOutcome],
    statistic: Callable[[Sequence[CaseOutcome]], float | None],
    draws: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """A statistic with its 95 % bootstrap interval over cases."""
    sample = (
        [
            value
            for _ in range(draws)
            if (value := statistic([outcomes[i] for i in rng.integers(len(outcomes), size=len(outcomes))])) is not None
        ]
        if outcomes
        else []
    )
    ends = [float(np.percentile(sample, q)) for q in (2.5, 97.5)] if sample else [None, None]
    return {"value": statistic(outcomes) if outcomes else None, "ci95": ends}


def detection_limits(outcomes: Iterable[CaseOutcome]) -> dict[str, dict[str, Any]]:
    """For each effect, how much it must change the motion, in noise floors, to be found.

    Found: in the answer, or, for an effect without a name, called unknown. The limit is the step that agrees with
    most cases; null where none was found, and below the least where all were.
    """
    by_effect: dict[str, list[tuple[float, bool]]] = {}
    for o in outcomes:
        if o.kind in ("single", "nameless"):
            found = o.verdict == "unknown" if o.kind == "nameless" else o.true[0] in o.answered
            by_effect.setdefault(o.true[0], []).append((o.change_floors, found))
    return {name: limit_of(sorted(cases)) for name, cases in sorted(by_effect.items())}


def limit_of(cases: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """The step of one effect; ``cases`` are (size, found), by size."""
    right = [sum(not f for _, f in cases[:k]) + sum(f for _, f in cases[k:]) for k in range(len(cases) + 1)]
    best = max(range(len(right)), key=lambda k: (right[k], k))
    limit = None
    if best == 0:
        limit = cases[0][0]
    elif best < len(cases):
        limit = float(np.sqrt(max(cases[best - 1][0], 1e-3) * cases[best][0]))
    return {
        "limit_floors": limit,
        "cases": [{"change_floors": size, "found": found} for size, found in cases],
        "agree": right[best] / len(cases),
    }


def confusion(outcomes: Iterable[CaseOutcome]) -> dict[str, dict[str, int]]:
    """Counts of what was said of each truth, detectable cases: effect → answer → number."""
    table: dict[str, dict[str, int]] = {}
    for o in outcomes:
        if o.kind in ("none", "real") or not o.detectable:
            truth = "none" if o.kind == "none" else "too small to detect"
        else:
            truth = " + ".join(o.true) if o.kind == "single" else f"{o.kind}: " + " + ".join(o.true)
        said = o.first if o.first is not None else o.verdict
        if o.kind == "real":
            truth = "real jumps"
        row = table.setdefault(truth, {})
        row[said] = row.get(said, 0) + 1
    return dict(sorted(table.items()))
