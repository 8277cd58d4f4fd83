"""The scores of the benchmark: the keys of ``metrics/blind.json``, counted from the outcomes of the cases."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap.validation.outcome import CLAIMS, CLOCK, LEAVES_A_REST, CaseOutcome

Scores = dict[str, Any]
CLEAR_FLOORS = 5.0  # change of the motion, in noise floors, from which on the overlap of the maps has a bar of its own


@dataclass(frozen=True)
class ScoreCondition:
    """What a score counts: of the cases that ``applies`` selects, those that meet ``holds``."""

    applies: Callable[[CaseOutcome], bool]
    holds: Callable[[CaseOutcome], bool]
    desired: bool = True  # whether a perfect diagnosis meets ``holds``

    def share(self, outcomes: Iterable[CaseOutcome]) -> float | None:
        """Share of the selected cases that meet the condition; None where no case is selected."""
        return share(self.holds(o) for o in outcomes if self.applies(o))

    def counts_against(self, o: CaseOutcome) -> bool:
        """Whether a case makes the score worse."""
        return self.applies(o) and self.holds(o) is not self.desired


def detectable_single(o: CaseOutcome) -> bool:
    """Whether one effect of the table acted and shows."""
    return o.kind == "single" and o.detectable


def detectable_pair(o: CaseOutcome) -> bool:
    """Whether two effects of the table acted and each of them shows."""
    return o.kind == "pair" and o.each_detectable


SHARES = {
    "named_first": ScoreCondition(detectable_single, lambda o: o.first in o.true),
    "named_in_set": ScoreCondition(detectable_single, lambda o: o.true[0] in o.answered),
    "named_alone": ScoreCondition(detectable_single, lambda o: o.verdict == "named" and o.answered == set(o.true)),
    "wrongly_named": ScoreCondition(lambda o: o.is_ordinary, lambda o: o.wrongly_named, desired=False),
    "unknown_recall": ScoreCondition(
        lambda o: o.kind == "nameless" and o.detectable, lambda o: o.verdict in LEAVES_A_REST
    ),
    "none_correct": ScoreCondition(lambda o: o.kind == "none", lambda o: o.verdict == "none"),
    "where_right": ScoreCondition(lambda o: o.is_ordinary and o.detectable, lambda o: o.where_right),
    "where_right_mirrored": ScoreCondition(lambda o: o.is_ordinary and o.detectable, lambda o: o.where_mirrored),
    "pairs_both_named": ScoreCondition(detectable_pair, lambda o: o.verdict in CLAIMS and set(o.true) <= o.answered),
}
"""The scores that are shares of cases of the ordinary kinds."""
FURTHER_SHARES = {
    "uneven_clock_first": ScoreCondition(lambda o: o.kind == "uneven", lambda o: o.clock_first),
    "uneven_effect_named": ScoreCondition(
        lambda o: o.kind == "uneven" and o.effect_detectable, lambda o: set(o.true) <= o.answered
    ),
    "uneven_wrongly_named": ScoreCondition(
        lambda o: o.kind == "uneven", lambda o: not o.names_nothing_else, desired=False
    ),
    "third_none_correct": ScoreCondition(lambda o: o.kind == "third" and not o.true, lambda o: o.right),
    "third_named_first": ScoreCondition(lambda o: o.kind == "third" and o.detectable, lambda o: o.first in o.true),
    "third_wrongly_named": ScoreCondition(
        lambda o: o.kind == "third", lambda o: o.verdict == "named" and not o.names_nothing_else, desired=False
    ),
    "too_high_named_first": ScoreCondition(
        lambda o: o.kind == "too_high" and o.detectable, lambda o: o.first in o.true
    ),
    "too_high_wrongly_named": ScoreCondition(lambda o: o.kind == "too_high", lambda o: o.wrongly_named, desired=False),
}
"""The scores that are shares of cases of the further kinds, which the name of the score begins with."""
EXACT = ScoreCondition(lambda o: o.is_ordinary and o.detectable, lambda o: all(c.value == c.true for c in o.compared))
CONDITIONS = SHARES | FURTHER_SHARES | {"parameter_error_median": EXACT}
"""Conditions of all scores for which single cases can be held responsible."""
MISSED = (SHARES["named_first"], SHARES["pairs_both_named"])
"""An effect of the table that shows was missed where a case counts against one of these."""


def counted_against(o: CaseOutcome) -> list[str]:
    """Names of the scores that a case makes worse."""
    return [name for name, condition in CONDITIONS.items() if condition.counts_against(o)]


def is_missed(o: CaseOutcome) -> bool:
    """Whether effects of the table show and were not found: a single one not named first, or one of a pair."""
    return any(condition.counts_against(o) for condition in MISSED)


def share(of: Iterable[bool]) -> float | None:
    """Share of true values; ``None`` where there is nothing to count."""
    values = list(of)
    return sum(values) / len(values) if values else None


def mean(of: Iterable[float], kind: Callable[[list[float]], Any] = np.mean) -> float | None:
    """Mean of the values, or their median; ``None`` where there are none."""
    values = list(of)
    return float(kind(values)) if values else None


def scores(outcomes: Sequence[CaseOutcome], draws: int, bins: int, rng: np.random.Generator) -> Scores:
    """All scores of one half: those of the ordinary kinds of cases, then those of the further ones.

    Cases of other robots have scores of their own (``scores_by_robot``).
    """
    own = of_pipeline(outcomes)
    ordinary = [o for o in own if o.is_ordinary]
    # Scores of the further kinds of cases; a share of nothing is null
    found: Scores = {}
    for kind in ("uneven", "third", "too_high"):
        these = [o for o in own if o.kind == kind]
        found |= {f"{kind}_cases": len(these), f"{kind}_detectable": sum(o.detectable for o in these)}
        found |= {name: one.share(these) for name, one in FURTHER_SHARES.items() if name.startswith(f"{kind}_")}
    clocks = [o for o in own if o.clock is not None]
    third = [o for o in own if o.physics is not None]
    found["uneven_clock_first_by_family"] = {
        family: share(o.clock_first for o in clocks if o.clock == family)
        for family in sorted({str(o.clock) for o in clocks})
    }
    found["third_right_by_physics"] = {
        name: share(o.right for o in third if o.physics == name) for name in sorted({str(o.physics) for o in third})
    }
    return {**ordinary_scores(ordinary, draws, bins, rng), **found}


def of_pipeline(outcomes: Sequence[CaseOutcome]) -> list[CaseOutcome]:
    """The cases of the pipeline's own robot."""
    return [o for o in outcomes if o.robot is None]


def scores_by_robot(outcomes: Sequence[CaseOutcome], main: str, bins: int) -> Scores:
    """Class of cases → scores of its ordinary kinds, without intervals; ``main`` is the pipeline's own robot."""
    ordinary = [o for o in outcomes if o.is_ordinary]
    names = sorted({o.robot for o in ordinary if o.robot is not None})
    found = {main: plain_scores(of_pipeline(ordinary), bins)}
    return found | {name: plain_scores([o for o in ordinary if o.robot == name], bins) for name in names}


def plain_scores(outcomes: Sequence[CaseOutcome], bins: int) -> Scores:
    """Scores of the ordinary kinds of cases without intervals."""
    found = ordinary_scores(outcomes, 0, bins, np.random.default_rng(0))
    return {name: one["value"] if isinstance(one, dict) else one for name, one in found.items()}


def ordinary_scores(outcomes: Sequence[CaseOutcome], draws: int, bins: int, rng: np.random.Generator) -> Scores:
    """All scores of the ordinary kinds of cases; a share of nothing is null."""
    singles, pairs = ([o for o in outcomes if applies(o)] for applies in (detectable_single, detectable_pair))
    compared = [c for o in singles + pairs for c in o.compared]
    shares = {name: condition.share(outcomes) for name, condition in SHARES.items()}
    # |promised − realised closure| of every claim on a detectable case
    errors = [
        abs(o.promised - o.realised)
        for o in outcomes
        if o.detectable and o.promised is not None and o.realised is not None
    ]
    return {
        "cases": len(outcomes),
        "detectable": sum(o.detectable for o in outcomes),
        **{name: shares[name] for name in ("named_first", "named_in_set", "named_alone")},
        "located": share(true == said for o in singles for true, said in o.locations),
        "right_or_honest": share(o.honest for o in outcomes),
        "set_size_mean": mean(len(names) for o in singles for names in o.answer),
        **{name: value for name, value in shares.items() if name not in ("named_first", "named_in_set", "named_alone")},
        "triples_members_named": share(found for o in outcomes for found in o.members.values()),
        "triples_all_named": share(all(o.members.values()) for o in outcomes if o.members),
        "where_overlap": mean_overlap(outcomes, CLEAR_FLOORS),
        "where_overlap_detectable": mean_overlap(outcomes, 0.0),
        "where_top_three": share(o.where_top_three for o in outcomes if o.detectable and o.where_overlap is not None),
        "parameter_error_median": mean((c.error for c in compared), np.median),
        "coverage": share(c.interval_holds_truth for c in compared),
        "brier": with_interval(outcomes, brier, draws, rng),
        "calibration_error": with_interval(outcomes, lambda these: calibration_error(these, bins), draws, rng),
        "closure_promise_error": mean(errors),
        "closure_promise_within_5_points": share(e <= 0.05 for e in errors),
    }


def mean_overlap(outcomes: Iterable[CaseOutcome], least_floors: float) -> float | None:
    """Mean overlap of the maps of where the gap lies, of detectable effects that move at least so many noise floors."""
    return mean(
        o.where_overlap
        for o in outcomes
        if o.detectable and o.where_overlap is not None and o.change_floors >= least_floors
    )


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
    if not outcomes:
        return {"value": None, "ci95": [None, None]}
    chosen = (rng.integers(len(outcomes), size=len(outcomes)) for _ in range(draws))
    drawn = (statistic([outcomes[i] for i in which]) for which in chosen)
    sample = [value for value in drawn if value is not None]
    ends = [float(np.percentile(sample, q)) for q in (2.5, 97.5)] if sample else [None, None]
    return {"value": statistic(outcomes), "ci95": ends}


def detection_limits(outcomes: Iterable[CaseOutcome]) -> dict[str, dict[str, Any]]:
    """For each effect, how much it must change the motion, in noise floors, to be found.

    Found: in the answer, or, for an effect without a name, called unknown. The limit is the step that agrees with
    most cases; null where none was found, and below the least where all were.
    """
    by_effect: dict[str, list[tuple[float, bool]]] = {}
    for o in outcomes:
        if o.kind in ("single", "nameless"):
            found = o.verdict in LEAVES_A_REST if o.kind == "nameless" else o.true[0] in o.answered
            by_effect.setdefault(o.true[0], []).append((o.change_floors, found))
    return {name: limit_of(sorted(cases)) for name, cases in sorted(by_effect.items())}


def limit_of(cases: Sequence[tuple[float, bool]]) -> dict[str, Any]:
    """The step of one effect; ``cases`` are (size, found), by size."""
    right = [sum(not f for _, f in cases[:k]) + sum(f for _, f in cases[k:]) for k in range(len(cases) + 1)]
    best = max(range(len(right)), key=lambda k: (right[k], k))
    limit = cases[0][0] if best == 0 else None
    if 0 < best < len(cases):
        limit = float(np.sqrt(max(cases[best - 1][0], 1e-3) * cases[best][0]))
    return {
        "limit_floors": limit,
        "cases": [{"change_floors": size, "found": found} for size, found in cases],
    }


def confusion(outcomes: Iterable[CaseOutcome]) -> dict[str, dict[str, int]]:
    """Counts of what was said of each truth, detectable cases: effect → answer → number."""
    table: dict[str, dict[str, int]] = {}
    for o in outcomes:
        if o.kind in ("uneven", "third"):
            truth = f"{o.kind}: {' + '.join(o.true) or 'none'}"
        elif o.kind in ("none", "published") or not o.detectable:
            truth = "none" if o.kind == "none" else "too small to detect"
        else:
            truth = " + ".join(o.true) if o.kind == "single" else f"{o.kind}: " + " + ".join(o.true)
        said = CLOCK if o.kind == "uneven" and o.clock_first else o.first if o.first is not None else o.verdict
        if o.kind == "published":
            truth = "published jumps"
        row = table.setdefault(truth, {})
        row[said] = row.get(said, 0) + 1
    return dict(sorted(table.items()))
