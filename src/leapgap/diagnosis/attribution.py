"""Which effect: every hypothesis fitted on some jumps and judged on the others.

A hypothesis has one number to fit. Its sum of squares is computed on a grid of that number for every jump at once, so
one batch of replays serves all folds, the profile likelihood and the bootstrap; nothing is fitted on a jump it is
judged on.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap import effects
from leapgap.diagnosis.gap import Judged, counts, squares
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.simulation.replay import Replayer


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place, with one number to fit.

    An effect that differs from log to log gets its value on each log from ``per_log`` (found without what is
    scored); the fitted number is then the share of that estimate's departure from nominal that is believed,
    common to all logs.
    """

    name: str
    location: str = "all"
    per_log: Mapping[str, float] | None = None
    fitted: str = ""
    """Name of the parameter that is fitted; empty: the effect's first. The others stay nominal."""

    @property
    def parameter(self) -> effects.base.Parameter:
        """The effect's parameter that is fitted."""
        parameters = effects.known()[self.name].parameters()
        return next((p for p in parameters if p.name == self.fitted), parameters[0])

    @property
    def key(self) -> tuple[str, str]:
        """Effect and parameter: what can be believed once."""
        return self.name, self.parameter.name

    @property
    def nominal(self) -> float:
        """The fitted number at which the effect is absent."""
        return self.parameter.nominal if self.per_log is None else 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of the fitted number."""
        return (self.parameter.lower, self.parameter.upper) if self.per_log is None else (0.0, 1.25)

    def on(self, log: str, number: float) -> Effect:
        """The effect on one log, at a fitted number."""
        return effects.known()[self.name](location=self.location, **{self.parameter.name: self.value(log, number)})

    def value(self, log: str, number: float) -> float:
        """The parameter on one log, at a fitted number."""
        if self.per_log is None:
            return number
        nominal = self.parameter.nominal
        value = nominal + number * (self.per_log[log] - nominal)
        return float(np.clip(value, self.parameter.lower, self.parameter.upper))

    def grid(self, points: int) -> np.ndarray:
        """Numbers to try, from bound to bound, the nominal one among them, denser near it."""
        lower, upper = self.bounds
        above = self.nominal + (upper - self.nominal) * np.linspace(0, 1, points) ** 2
        below = self.nominal - (self.nominal - lower) * np.linspace(0, 1, points) ** 2
        return np.unique(
            np.concatenate(
                [above if upper > self.nominal else [], below[::-1] if lower < self.nominal else [], [self.nominal]]
            )
        )


@dataclass(frozen=True)
class Fit:
    """A hypothesis, fitted and judged, on top of what was already believed."""

    hypothesis: Hypothesis
    numbers: np.ndarray
    """Grid of the fitted number, (numbers,)."""
    curve: np.ndarray
    """Sum of squares on the grid with the beliefs of all jumps, (numbers, jumps): the profile likelihood."""
    fold_numbers: np.ndarray
    """Fitted on the other folds' jumps, (folds,)."""
    heldout: np.ndarray
    """Sum of squares on each jump, at the number fitted without its fold, (jumps,)."""

    @property
    def number(self) -> float:
        """Fitted on all jumps."""
        return lowest(self.numbers, self.curve.sum(axis=1))

    @property
    def at_bound(self) -> bool:
        """Whether the fit ran to the end of its range, away from the nominal value: no sensible value fits."""
        lower, upper = self.hypothesis.bounds
        margin = 0.02 * (upper - lower)
        return any(abs(self.number - bound) < margin for bound in (lower, upper) if bound != self.hypothesis.nominal)


@dataclass(frozen=True)
class Belief:
    """Effects already believed, with the numbers of each fold and of all jumps."""

    fits: tuple[Fit, ...] = ()

    def effects(self, log: str, fold: int | None) -> tuple[Effect, ...]:
        """On one log, as fitted without a fold (None: on all jumps)."""
        return tuple(
            fit.hypothesis.on(log, fit.number if fold is None else float(fit.fold_numbers[fold])) for fit in self.fits
        )


@dataclass
class Search:
    """Fits hypotheses on one set of logs; knows folds, replays and progress."""

    judged: Judged
    replayer: Replayer
    folds: int
    grid_points: int
    refinements: int = 2
    refined_points: int = 3
    progress: Callable[[str], None] = field(default=lambda _: None)

    def __post_init__(self) -> None:
        number = len(self.judged.jumps)
        self.fold_of = np.arange(number) % min(self.folds, number)
        if number < 2:
            raise InputError(
                "diagnose.logs",
                f"{number} jump",
                "two or more: a cause is judged on jumps it was not fitted on",
                "log another jump",
            )

    def fit(self, hypothesis: Hypothesis, belief: Belief) -> Fit:
        """Fit one hypothesis on top of a belief, on every fold's training jumps, and judge it held out."""
        numbers = hypothesis.grid(self.grid_points)
        curve = self._curve(hypothesis, belief, numbers)
        for _ in range(self.refinements):  # valleys may be narrower than the grid
            finer = self._finer(numbers, curve)
            if not len(finer):
                break
            order = np.argsort(np.concatenate([numbers, finer]))
            curve = np.concatenate([curve, self._curve(hypothesis, belief, finer)])[order]
            numbers = np.concatenate([numbers, finer])[order]
        fold_numbers = np.array(
            [lowest(numbers, self._training(curve, f).sum(axis=1)) for f in range(self.fold_of.max() + 1)]
        )
        judge = [
            (*belief.effects(jump.name, int(f)), hypothesis.on(jump.name, float(fold_numbers[f])))
            for jump, f in zip(self.judged.jumps, self.fold_of, strict=True)
        ]
        heldout = squares(self.judged, self.replayer, [judge])[0]
        fit = Fit(hypothesis, numbers, curve, fold_numbers, heldout)
        self.progress(f"{hypothesis.name} at {hypothesis.location}: {hypothesis.parameter.name} {fit.number:.4g}")
        return fit

    def _curve(self, hypothesis: Hypothesis, belief: Belief, numbers: np.ndarray) -> np.ndarray:
        """Sums of squares (numbers, jumps), with what is believed at the numbers fitted on all jumps.

        One batch of replays serves all folds; held-out errors are judged anew with each fold's own numbers.
        """
        candidates = [
            [(*belief.effects(jump.name, None), hypothesis.on(jump.name, float(number))) for jump in self.judged.jumps]
            for number in numbers
        ]
        return squares(self.judged, self.replayer, candidates)

    def _training(self, curve: np.ndarray, fold: int) -> np.ndarray:
        """The part of a curve that a fold may be fitted on (the last, of all jumps, is whole)."""
        return curve[:, self.fold_of != fold]

    def _finer(self, numbers: np.ndarray, curve: np.ndarray) -> np.ndarray:
        """Numbers between the neighbours of the folds' minima."""
        folds = range(self.fold_of.max() + 1)
        lows = [int(np.argmin(self._training(curve, f).sum(axis=1))) for f in folds]
        left, right = numbers[max(0, min(lows) - 1)], numbers[min(len(numbers) - 1, max(lows) + 1)]
        return np.setdiff1d(np.linspace(left, right, self.refined_points + 2)[1:-1], numbers)


def lowest(numbers: np.ndarray, total: np.ndarray) -> float:
    """Minimum of a curve on a grid, by the parabola through its lowest point and neighbours."""
    i = int(np.argmin(total))
    if i in (0, len(numbers) - 1):
        return float(numbers[i])
    (a, b, c), (fa, fb, fc) = numbers[i - 1 : i + 2], total[i - 1 : i + 2]
    curvature = (b - a) * (fb - fc) - (b - c) * (fb - fa)
    if curvature == 0:
        return float(b)
    vertex = b - 0.5 * ((b - a) ** 2 * (fb - fc) - (b - c) ** 2 * (fb - fa)) / curvature
    return float(np.clip(vertex, a, c))


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval over jumps drawn again."""

    value: float
    low: float
    high: float


def resamples(jumps: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap over jumps: indices (draws, jumps)."""
    return rng.integers(0, jumps, size=(draws, jumps))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: Judged, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that goes away; arguments are sums of squares a jump."""
    number = counts(judged)

    def of(chosen: np.ndarray) -> float:
        values = number[chosen].sum()
        before, after, least = (np.sqrt(s[chosen].sum() / values) for s in (nominal, corrected, floor))
        return float((before - after) / max(before - least, 1e-12))

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(number))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def number_interval(fit: Fit, draws: np.ndarray) -> Interval:
    """The fitted number with jumps drawn again: the spread of what other jumps would have said."""
    sample = [lowest(fit.numbers, fit.curve[:, chosen].sum(axis=1)) for chosen in draws]
    return Interval(fit.number, float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def first_shares(fits: Sequence[Fit], draws: np.ndarray) -> np.ndarray:
    """How often each hypothesis has the least held-out error when jumps are drawn again, (hypotheses,)."""
    totals = np.stack([fit.heldout[draws].sum(axis=1) for fit in fits])
    return np.bincount(totals.argmin(axis=0), minlength=len(fits)) / len(draws)


def search_forward(
    search: Search, hypotheses: Sequence[Hypothesis], nominal: np.ndarray, least_gain: float, most: int
) -> tuple[Belief, list[list[Fit]]]:
    """Add the best hypothesis while the next one buys a share of the headline gap on held-out jumps.

    A fit that ran into the bound of its range is shown and never believed. Returns what is believed and the fits of
    every round, the first round being each hypothesis alone.
    """
    belief, rounds, before = Belief(), [], nominal
    while len(belief.fits) < most:
        taken = {fit.hypothesis.key for fit in belief.fits}
        fits = [search.fit(h, belief) for h in hypotheses if h.key not in taken]
        if not fits:
            break
        rounds.append(sorted(fits, key=lambda fit: fit.heldout.sum()))
        sensible = [fit for fit in rounds[-1] if not fit.at_bound]
        if not sensible:
            break
        best = sensible[0]
        gain = (np.sqrt(before.sum()) - np.sqrt(best.heldout.sum())) / np.sqrt(nominal.sum())
        if gain < least_gain:
            break
        belief, before = Belief((*belief.fits, best)), best.heldout
    return belief, rounds
