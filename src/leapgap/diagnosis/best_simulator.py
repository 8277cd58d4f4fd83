"""The best simulator: all effects fitted together, for prediction rather than causes.

An answer names few causes, each of which the logs force upon us. What they leave is spread over many numbers, none of
which stands out. Here all effects take the mean of their posterior beside the answer, drawn towards the nominal robot
by their usual sizes, and what replays held-out logs best is kept: the answer, or one of these fits. Numbers of such a
fit make up for each other and for what the model lacks, so each of them says whether to believe it.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.engine.points import Acting, prior_of
from leapgap.diagnosis.engine.search import Found, Search, candidate_of
from leapgap.diagnosis.gap import SIGMAS, HeldOutGap, Interval
from leapgap.diagnosis.hypotheses import Hypothesis, parts_of, places
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.joint_likelihood import bounded_minimum
from leapgap.effects.base import Effect

DRAWN = (1.0, 0.3, 0.1)  # Shares of their prior deviations by which further numbers are drawn to nominal
ROUNDS = 2  # Number of steps by columns as they are, and then by columns made anew, that lead to these fits
HANDICAPS = (1.0, 1.02, 1.04)
"""Factors on the squares of the answer, of fits of all effects and of fits in parts: more numbers must help more."""
LEAST_BETTER = 0.01  # A fit of all effects must close more of the gap of held-out logs than the answer by this share
LEAST_INFORMED = 0.5
"""The logs hardly determine a number of whose standard deviation beforehand they leave a larger share."""
ALIKE = 0.9  # Correlation from which on two numbers do the same to the logs
MADE_UP = 0.95  # Multiple correlation from which on other numbers together do the same as one


@dataclass(frozen=True)
class BestNumber:
    """One number of the best simulator, and whether it is to be believed."""

    effect: str
    location: str
    parameter: str
    value: float
    ci95: tuple[float, float]
    nominal: float
    unit: str
    named: bool  # Whether the answer names the effect
    believed: bool
    why: tuple[str, ...]  # Why not, in words; empty where it is believed


@dataclass(frozen=True)
class BestSimulator:
    """The candidate that replays held-out logs best, with what is to be believed of its numbers."""

    candidate: Candidate
    source: str  # ``answer``, or ``joint fit`` of all effects
    closure: Interval  # Of logs held out, the choice among candidates included
    gap: float
    closure_of_answer: float
    tried: int  # Number of candidates that it was chosen among, the answer included
    numbers: tuple[BestNumber, ...]
    effects: tuple[Effect, ...]  # With the numbers fitted to all logs

    @property
    def believed(self) -> tuple[BestNumber, ...]:
        """The numbers that are to be believed."""
        return tuple(one for one in self.numbers if one.believed)

    @property
    def is_answer(self) -> bool:
        """Whether it is the answer itself, or the nominal robot where there is none."""
        return self.source == "answer"

    @property
    def in_words(self) -> str:
        """What it closes beside the answer, and how much of it is to be believed."""
        if self.is_answer:
            whose = "the identified causes" if self.candidate.hypotheses else "the nominal robot"
            left = "no fit of all effects replays held-out logs better" if self.tried > 1 else "no gap is left to fit"
            return f"{whose}; {left}"
        share = self.closure.capped_at_one
        value, low, high, answer = (
            f"{100 * part:.0f}" for part in (share.value, share.low, share.high, min(self.closure_of_answer, 1.0))
        )
        return (
            f"all effects fitted together explain {value} % (95 %: {low} to {high}) of the gap on held-out logs, the "
            f"identified causes {answer} %; {len(self.believed)} of its {len(self.numbers)} numbers are reliable"
        )

    def to_json(self) -> dict[str, Any]:
        """Its entry of ``report.json``, but for the form of the closure."""
        return {
            "source": self.source,
            "says": self.in_words,
            "gap": self.gap,
            "closure_of_answer": self.closure_of_answer,
            "candidates": self.tried,
            "numbers": [asdict(one) for one in self.numbers],
        }


@dataclass(frozen=True)
class FitOfAll:
    """A fit of all effects."""

    candidate: Candidate
    beforehand: np.ndarray  # Standard deviation of each number before any log, (numbers,); infinite where it is held
    handicap: float = HANDICAPS[1]  # Factor on its squares where candidates are compared


def by_columns(search: Search, found: Found, names: Collection[str]) -> list[FitOfAll]:
    """All effects with some ``names`` beside a set, by their columns: everywhere alike, then by parts of the robot.

    Those with states of their own are left out: their columns hold near by alone.
    """
    further: Acting = tuple(
        (h, h.nominal)
        for h in search.bench.hypotheses
        if h.location == "all" and h.name in names and not search.has_memory(h)
        if not any(overlap(h, own) for own in found.members)
    )
    members, fits = found.acting, []
    for handicap in HANDICAPS[1:]:
        point, acting = found.point, (*members, *further)
        for _ in range(ROUNDS):
            point = search.bench.by_columns(point, acting)
            acting = in_range(search.judge(point)).acting
        for _ in range(0 if search.bench.robot.stands else ROUNDS):  # on feet that takes minutes
            point = search.bench.moved(point.intervals, point.basis, acting)
            acting = in_range(search.judge(point)).acting
        beforehand, free = np.concatenate([np.zeros(0), *(prior_of(h) for h, _ in acting)]), search.judge(point)
        for share in DRAWN:
            drawn = search.judge(point, drawn=[*[1.0] * len(members), *[share] * (len(acting) - len(members))])
            own = replace(candidate_of(in_range(drawn)), covariance=free.covariance)
            fits.append(FitOfAll(own, beforehand, handicap))
        members, further = in_parts(search, acting[: len(members)]), in_parts(search, acting[len(members) :])
    return fits


def by_joint_fit(joint: JointFit) -> list[FitOfAll]:
    """The fit of all effects with which a joint fit to whole logs began; none where there was nothing to fit."""
    about = [(end, joint.numbers(end.hypotheses)) for end in joint.ends[:1]]
    return [FitOfAll(end, np.where(own.fitted, own.spread, np.inf)) for end, own in about]


def in_range(found: Found) -> Found:
    """A set at its likeliest numbers within their ranges: what others make of one that is held at an end."""
    limits = np.array([np.concatenate([np.zeros(0), *(h.bounds[side] for h in found.members)]) for side in (0, 1)])
    curvature, none = np.linalg.inv(found.covariance), np.zeros(len(found.numbers))
    numbers, *folds = (
        own + bounded_minimum(curvature, none, *limits - own) for own in (found.numbers, *found.fold_numbers)
    )
    return replace(found, numbers=numbers, fold_numbers=np.array(folds))


def in_parts(search: Search, acting: Acting) -> Acting:
    """The same effects at each part of the robot where they may differ between these."""
    found: list[tuple[Hypothesis, np.ndarray]] = []
    for h, numbers in acting:
        wanted = parts_of(h.kind, h.robot) if h.per_log is None and h.location == "all" else ()
        own = [one for one in search.bench.hypotheses if one.name == h.name and one.location in wanted]
        found += [(one, one.clip(one.nominal + numbers - h.nominal)) for one in own or [h]]
    return tuple(found)


@dataclass(frozen=True)
class BestFit:
    """Chooses among an answer and fits of all effects what replays held-out logs best."""

    heldout_gap: HeldOutGap
    answer: Candidate
    model_error: float  # As in ``Settings``
    progress: Callable[[str], None] = lambda _: None

    def is_named(self, hypothesis: Hypothesis) -> bool:
        """Whether the answer names an effect that acts at the place of a hypothesis."""
        return any(overlap(h, hypothesis) for h in self.answer.hypotheses)

    def best(self, made: Callable[[], Sequence[FitOfAll]]) -> BestSimulator:
        """The best of the answer and of the fits that are ``made`` where it leaves a gap.

        For its closure, each fold is replayed by the candidate that is best on the other folds. The answer stays where
        that closes hardly more than it does.
        """
        gap = self.heldout_gap
        closed = not gap.has_gap or gap.closure_value(*gap.squares([self.answer])) > 1 - LEAST_BETTER
        fits = [] if closed else made()
        candidates = [self.answer, *(one.candidate for one in fits)]
        squares, handicaps = np.stack(gap.squares(candidates)), np.array([1.0, *(one.handicap for one in fits)])
        heldout, before = chosen_without(squares, handicaps, gap.folds), squares[0]
        chosen = int(np.argmin(squares.sum(axis=1) * handicaps))
        answer = gap.closure_value(before)
        if not chosen or gap.closure_value(heldout) - answer < LEAST_BETTER:
            chosen, heldout = 0, before
        candidate = candidates[chosen]
        left = np.zeros(len(candidate.numbers))
        if chosen:
            left = candidate.spread() / fits[chosen - 1].beforehand
        numbers = self.judged(candidate, left)
        best = BestSimulator(
            candidate,
            "joint fit" if chosen else "answer",
            gap.closure(heldout),
            gap.gap(heldout),
            answer,
            len(candidates),
            tuple(numbers),
            typical(candidate, gap.names),
        )
        own = f"explains {100 * best.closure.value:.0f} % of the gap, the identified causes {100 * answer:.0f} %"
        self.progress(f"fit of all effects: {own}")
        return best

    def judged(self, candidate: Candidate, left: np.ndarray) -> list[BestNumber]:
        """Each number of a candidate with the reasons not to believe it.

        ``left`` (numbers,) is the share of the standard deviation beforehand that the logs leave of each.
        """
        if not candidate.hypotheses:
            return []
        covariance = np.nan_to_num(candidate.covariance)
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        nominal = np.concatenate([h.nominal for h in candidate.hypotheses])
        error = self.model_error * np.abs(candidate.numbers - nominal)
        half = SIGMAS * np.hypot(np.maximum(spread, scatter(candidate.fold_numbers)), error)
        with np.errstate(divide="ignore", invalid="ignore"):
            alike = np.nan_to_num(covariance / np.outer(spread, spread)) - np.eye(len(spread))
            share = 1 / (np.diag(covariance) * np.diag(np.linalg.pinv(covariance)))
            together = np.sqrt(np.clip(np.nan_to_num(1 - share), 0.0, 1.0))
        labels = [f"{h.label} {p.name}" for h in candidate.hypotheses for p in h.effect_parameters]
        found, at, logs = [], 0, self.heldout_gap.names
        for h, own, by in zip(candidate.hypotheses, candidate.split(), candidate.split(half), strict=True):
            for k, p in enumerate(h.effect_parameters):
                like = int(np.argmax(np.abs(alike[at])))
                pair = abs(alike[at, like]) > ALIKE
                why = {
                    "at the end of its range": h.at_bound(own),
                    "the logs do not determine it, so that it stays where it was expected": left[at] > LEAST_INFORMED,
                    f"{labels[like]} does the same (correlation {alike[at, like]:.2f})": pair,
                    f"other numbers together do the same (correlation {together[at]:.2f})": not pair
                    and together[at] > MADE_UP,
                    "its interval holds the nominal value": abs(own[k] - h.nominal[k]) <= by[k],
                }
                named = self.is_named(h)
                why["it is not among the identified causes"] = not named and not any(why.values())
                reasons = tuple(reason for reason, holds in why.items() if holds)
                ends = sorted(h.typical_value(p.name, own + side * by, logs) for side in (-1, 1))
                value, ci95 = h.typical_value(p.name, own, logs), (ends[0], ends[1])
                found.append(
                    BestNumber(h.name, h.location, p.name, value, ci95, p.nominal, p.unit, named, not reasons, reasons)
                )
                at += 1
        return found


def scatter(of_folds: np.ndarray) -> np.ndarray:
    """Standard deviation of numbers (folds, numbers) by how they change without each fold (jackknife), (numbers,)."""
    folds = len(of_folds)
    return np.asarray(np.sqrt((folds - 1) / folds * ((of_folds - of_folds.mean(axis=0)) ** 2).sum(axis=0)))


def chosen_without(squares: np.ndarray, handicaps: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Squares (logs,) where each fold is replayed by the candidate that is best on the others.

    ``squares`` are those of the candidates on held-out logs, (candidates, logs); ``handicaps`` (candidates,) are
    factors on them in the choice.
    """
    found = squares[0].copy()
    for fold in np.unique(folds):
        best = int(np.argmin(squares[:, folds != fold].sum(axis=1) * handicaps))
        found[folds == fold] = squares[best, folds == fold]
    return found


def overlap(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two hypotheses are of one effect and act at a place in common."""
    if one.name != other.name:
        return False
    of = places(one.kind, one.robot)
    return bool({*of.get(one.location, ())} & {*of.get(other.location, ())}) or one.location == other.location


def typical(candidate: Candidate, logs: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of a candidate as fitted to all logs, the median where values differ by log, without nominal ones."""
    effects = candidate.typical_effects(logs)
    return tuple(
        effect for h, effect in zip(candidate.hypotheses, effects, strict=True) if not effect.is_nominal_for(h.robot)
    )
