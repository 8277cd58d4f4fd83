"""The best simulator: all effects fitted together, for prediction rather than causes.

An answer names few causes, each of which the logs force upon us. What they leave is spread over many numbers, none of
which stands out. Here all effects are fitted at once, drawn towards the nominal robot by their usual sizes, and what
replays held-out logs best is kept: the answer, or one of the fits on the way. Numbers of such a fit make up for each
other and for what the model lacks, so each of them says whether to believe it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.gap import SIGMAS, HeldOutGap, Interval
from leapgap.diagnosis.hypotheses import Hypothesis, parts_of, places
from leapgap.diagnosis.joint_likelihood import JointLikelihood, Linearised, Numbers
from leapgap.diagnosis.linear_fits import LinearFits, LinearModel, Weighting
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.effects.base import Effect

JOINT = (Weighting(0.1, False), Weighting(1.0, False), Weighting(0.3, True), Weighting(1.0, True))
"""Weightings of fits of all effects about the answer."""
IN_PARTS = (Weighting(0.1, False), Weighting(0.5, False))
"""Weightings of fits of effects at parts of the robot about the best of those."""
HANDICAPS = (1.0, 1.02, 1.04)
"""Factors on the squares of the answer, of fits of all effects and of fits in parts: more numbers must help more."""
LEAST_BETTER = 0.01  # A fit of all effects must close more of the gap of held-out logs than the answer by this share
WORTH_A_STEP = 0.05  # All effects are fitted again where the best fit leaves a larger share of the gap
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
class JointCandidate:
    """A fit of all effects, with what it came from."""

    fits: LinearFits
    weighting: Weighting
    candidate: Candidate
    handicap: float  # Factor on its squares where candidates are compared


@dataclass(frozen=True)
class BestFit:
    """Fits all effects together about an answer, and keeps what replays held-out logs best."""

    heldout_gap: HeldOutGap
    pieces: Callable[[], ShortRollouts]  # Short pieces of the logs; nobody asks where nothing is fitted
    answer: Candidate
    hypotheses: Sequence[Hypothesis]
    model_error: float  # As in ``Settings``
    told: Mapping[str, Evidence] = field(default_factory=dict)
    """Evidence by the parameter that it tells; these numbers are held."""
    joint: Linearised | None = None  # Where a joint fit of all effects has ended; None: it is made here
    progress: Callable[[str], None] = lambda _: None

    def search(self) -> BestSimulator:
        """Fit all effects about the answer, then again about the best of these fits, with numbers for each part.

        Nothing is fitted where the answer leaves no gap, and not again where the first fits leave hardly any, or where
        a joint fit has ended there already.
        """
        gap = self.heldout_gap
        if not gap.has_gap or gap.closure_value(*gap.squares([self.answer])) > 1 - LEAST_BETTER:
            return self.best([])
        joint = self.joint or self.linearised(self.at_all_places(), whole=True)
        model = self.linear_model(joint, self.is_named)
        fits = candidates_of(LinearFits(joint.about, model, np.zeros(self.shape(joint))), JOINT, HANDICAPS[1])
        squares = gap.squares([one.candidate for one in fits])
        best = int(np.argmin([of.sum() for of in squares]))
        if self.joint is None and gap.closure_value(squares[best]) < 1 - WORTH_A_STEP:
            start = self.in_parts(fits[best].candidate)
            again = self.linearised(start, whole=False)
            expected = np.array([again.about.departs(x) for x in (start.numbers, *start.fold_numbers)])
            model = self.linear_model(again, lambda _: False)
            fits += candidates_of(LinearFits(again.about, model, expected), IN_PARTS, HANDICAPS[2])
        return self.best(fits)

    @cached_property
    def short(self) -> ShortRollouts:
        """The short pieces of the logs."""
        return self.pieces()

    def is_named(self, hypothesis: Hypothesis) -> bool:
        """Whether the answer names an effect that acts at the place of a hypothesis."""
        return any(h.name == hypothesis.name and overlap(h, hypothesis) for h in self.answer.hypotheses)

    def at_all_places(self) -> Candidate:
        """The answer's effects with its numbers, and all others at all places, nominal."""
        others = tuple(h for h in self.hypotheses if h.location == "all" and not self.is_named(h))
        nominal = np.concatenate([np.zeros(0), *(h.nominal for h in others)])
        folds = [np.concatenate([own, nominal]) for own in self.answer.fold_numbers]
        numbers = np.concatenate([self.answer.numbers, nominal])
        return Candidate((*self.answer.hypotheses, *others), numbers, np.zeros(0), np.array(folds))

    def in_parts(self, candidate: Candidate) -> Candidate:
        """The same with effects at all places taken apart where they can differ between parts of the robot."""
        parts = [self.parts(h) or [h] for h in candidate.hypotheses]

        def apart(numbers: np.ndarray) -> np.ndarray:
            of = zip(candidate.hypotheses, candidate.split(numbers), parts, strict=True)
            return np.concatenate([part.clip(part.nominal + own - h.nominal) for h, own, some in of for part in some])

        folds = np.array([apart(numbers) for numbers in candidate.fold_numbers])
        found = tuple(part for some in parts for part in some)
        return Candidate(found, apart(candidate.numbers), np.zeros(0), folds)

    def parts(self, hypothesis: Hypothesis) -> list[Hypothesis]:
        """The effect at each part of the robot; empty where it acts on the robot as one."""
        if self.told or hypothesis.per_log is not None or hypothesis.location != "all":
            return []
        wanted = parts_of(hypothesis.kind, hypothesis.robot)
        return [h for h in self.hypotheses if h.name == hypothesis.name and h.location in wanted]

    def linearised(self, start: Candidate, whole: bool) -> Linearised:
        """Errors about a candidate with their derivatives."""
        about, likelihood = Numbers.of(start.hypotheses, self.told), JointLikelihood(self.heldout_gap, self.short)
        (errors,) = likelihood.errors(start.hypotheses, [start.numbers], whole, likelihood.logs)
        slopes = likelihood.slopes(about, start.numbers, errors, whole, likelihood.logs)
        return Linearised(about, start.numbers, errors, slopes)

    def linear_model(self, at: Linearised, is_free: Callable[[Hypothesis], bool]) -> LinearModel:
        """The linear model of the errors, in which some effects may depart far."""
        free = np.concatenate([np.full(len(h.parameters), is_free(h)) for h in at.about.hypotheses])
        return LinearModel.of(at.about, at.numbers, at.errors, at.slopes, self.heldout_gap.folds, free)

    def shape(self, at: Linearised) -> tuple[int, int]:
        """Number of fits, of all logs and without each fold, and of the numbers that are fitted."""
        return 2 + int(self.heldout_gap.folds.max()), int(at.about.fitted.sum())

    def best(self, fits: Sequence[JointCandidate]) -> BestSimulator:
        """The best of the answer and of some fits.

        For its closure, each fold is replayed by the candidate that is best on the other folds. The answer stays where
        that closes hardly more than it does.
        """
        gap, candidates = self.heldout_gap, [self.answer, *(one.candidate for one in fits)]
        squares, handicaps = np.stack(gap.squares(candidates)), np.array([1.0, *(one.handicap for one in fits)])
        heldout, before = chosen_without(squares, handicaps, gap.folds), squares[0]
        chosen = int(np.argmin(squares.sum(axis=1) * handicaps))
        answer = gap.closure_value(before)
        if not chosen or gap.closure_value(heldout) - answer < LEAST_BETTER:
            chosen, heldout = 0, before
        candidate = candidates[chosen]
        left = np.zeros(len(candidate.numbers))
        if chosen:
            left = fits[chosen - 1].fits.spread_left(fits[chosen - 1].weighting, candidate.numbers)
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


def candidates_of(fits: LinearFits, weightings: Sequence[Weighting], handicap: float) -> list[JointCandidate]:
    """The fits by some weightings."""
    return [JointCandidate(fits, weighting, fits.candidate(weighting), handicap) for weighting in weightings]


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
    """Whether two hypotheses of one effect act at a place in common."""
    of = places(one.kind, one.robot)
    return bool({*of.get(one.location, ())} & {*of.get(other.location, ())}) or one.location == other.location


def typical(candidate: Candidate, logs: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of a candidate as fitted to all logs, the median where values differ by log, without nominal ones."""
    effects = candidate.typical_effects(logs)
    return tuple(
        effect for h, effect in zip(candidate.hypotheses, effects, strict=True) if not effect.is_nominal_for(h.robot)
    )
