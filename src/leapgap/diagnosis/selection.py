"""Selection of one effect: hypotheses are fitted to short rollouts of some logs and judged on the others.

Every hypothesis is tried in the linear model of the sensitivities. The most promising ones are fitted to replays of
their own (Gauss–Newton with Broyden's updates of the derivatives), several in one batch. Nuisances are fitted for the
nominal robot and for every hypothesis alike.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap.diagnosis.candidates import Fit, ProfileLikelihood, SearchResult, clip_numbers, in_words, split_numbers
from leapgap.diagnosis.gauss_newton import GaussNewtonFit, broyden, covariance, differences
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.sensitivities import Sensitivities, concatenate_logs, on_logs
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.errors import InputError

SETTLED = 0.3
"""A fit has converged when its loss falls by less than this."""
TRIALS = (0.4, 2.5)
"""Sizes, in moderate departures, at which an effect at all places is simulated beside the linear model."""
REGROUPED = 3
"""So many of the best effects are simulated at groups of places as well."""
LINEAR_ITERATIONS = 4
MOST_SURPRISE = 30.0
"""Upper limit of the loss of a piece above its fitted loss when it is held out; usual losses are a few units."""
FAR = 6.0
"""Standard deviations by which a tolerance may be missed: simulations that integrate otherwise differ by up to four."""
HOPELESS = 0.3
"""A fit stops when, after its second step, it has gained less than this share of the best fit's gain."""


@dataclass(frozen=True)
class LinearGuess:
    """A set of hypotheses with numbers, and its loss in the linear model."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray
    loss: float


@dataclass(frozen=True)
class SearchSettings:
    """Width of the search, and thresholds for a cause."""

    shortlist: int = 8
    """Number of hypotheses fitted to replays of their own; half as many again about the best of them."""
    per_effect: int = 3
    """Largest number of those with one effect at different places."""
    steps: int = 8
    """Largest number of Gauss–Newton steps; most sets converge earlier."""
    promising: int = 7
    """Number of effects that, by half of the evidence, explain most after the first; they are tried in all of it."""
    least_gain: float = 20.0
    """Smallest gain of log likelihood of a cause on held-out logs; on logs without any gap it is up to 17."""
    least_agree: float = 0.75
    """Smallest share of the logs on which a cause must have a positive gain."""

    def __post_init__(self) -> None:
        """Refuse a search that tries nothing."""
        for name in ("shortlist", "per_effect", "steps", "promising"):
            if getattr(self, name) < 1:
                raise InputError(f"settings.plan.{name}", f"{getattr(self, name)}", "1 or more", "correct it")


def find_cause(
    whole: ShortRollouts,
    coarse: ShortRollouts,
    hypotheses: Sequence[Hypothesis],
    tolerances: Mapping[str, float],
    fold_of_log: np.ndarray,
    plan: SearchSettings,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search in half of the pieces about the nominal robot, then in all of them about the robot with the first cause.

    The second search is needed because sensitivities and noise depend on the robot they are taken at.
    """
    first = Search(Sensitivities.of(coarse, hypotheses, tolerances), fold_of_log, plan, progress)
    singles = first.singles(hypotheses)
    sensible = [fit for fit in singles if fit.sensible]
    if sensible and first.is_convincing(sensible[0]):
        best, refined = sensible[0], sensible[: (plan.shortlist + 1) // 2]
        around = list(zip(best.hypotheses, best.split(), strict=True))
        names = {*first.rank_effects(best, hypotheses), *(fit.names[0] for fit in refined)}
        hopeful = [h for h in hypotheses if h.name in names]
        search = Search(Sensitivities.of(whole, hopeful, tolerances, around), fold_of_log, plan, progress)
        return search.select(search.refit(refined))
    search = Search(Sensitivities.of(whole, hypotheses, tolerances), fold_of_log, plan, progress)
    return search.select(search.singles(hypotheses))


@dataclass
class Search:
    """Search for sets of hypotheses on one set of short rollouts."""

    sensitivities: Sensitivities
    fold_of_log: np.ndarray
    plan: "SearchSettings"
    progress: Callable[[str], None] = field(default=lambda _: None)

    def __post_init__(self) -> None:
        self.evidence: ShortRollouts = self.sensitivities.evidence
        self.fold_of_piece = self.fold_of_log[self.evidence.log_of_piece]
        self.nominal = self.cross_validate((), np.zeros(0), self.sensitivities.nominal[:, :, None])

    def singles(self, hypotheses: Sequence[Hypothesis]) -> tuple[Fit, ...]:
        """Fits of single effects, the most promising ones, best on held-out logs first."""
        everywhere = [h for h in hypotheses if h.location == "all"]
        guesses = [*self.guess_sizes(everywhere), *self.guess_linear(self.nominal, hypotheses)]
        fits = self.fit_promising(guesses, self.plan.shortlist)
        elsewhere = self.guess_sizes(self.at_groups(fits, hypotheses))
        return tuple(
            sorted(
                [*fits, *self.fit_promising(elsewhere, self.plan.per_effect)],
                key=lambda fit: fit.heldout.sum(),
            )
        )

    def at_groups(self, fits: Sequence[Fit], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The first few effects of some fits at groups of places where they were not fitted.

        An effect that moves where a foot lands is not linear, so that derivatives do not tell its place.
        """
        names = list(dict.fromkeys(fit.names[0] for fit in fits))[:REGROUPED]
        known = {(fit.names[0], fit.hypotheses[0].location) for fit in fits}
        return [
            h
            for h in hypotheses
            if h.name in names
            and h.location != "all"
            and (h.name, h.location) not in known
            and len(self.sensitivities.members.get((h.name, h.location), ())) > 1
        ]

    def refit(self, fits: Sequence[Fit]) -> tuple[Fit, ...]:
        """Fits of the same sets on this evidence, starting from the given fits."""
        return self.fit_promising([LinearGuess(f.hypotheses, f.numbers, f.heldout.sum()) for f in fits], len(fits))

    def select(self, singles: tuple[Fit, ...]) -> SearchResult:
        """The best of the fits of single effects, where it gains enough on held-out logs."""
        sensible = [fit for fit in singles if fit.sensible]
        return SearchResult(
            self.nominal,
            sensible[0] if sensible and self.is_convincing(sensible[0]) else self.nominal,
            singles,
            self.evidence.log_of_piece,
            self.nominal.columns.shape[1],
            self.profiles(singles),
        )

    def profiles(self, fits: Sequence[Fit]) -> tuple[ProfileLikelihood, ...]:
        """Profile likelihood of each effect at its best place."""
        best: dict[str, Fit] = {}
        for fit in fits:
            best.setdefault(fit.names[0], fit)
        return tuple(self.profile(fit) for fit in best.values())

    def profile(self, fit: Fit) -> ProfileLikelihood:
        """Profile likelihood of one hypothesis, by the derivatives at its fit."""
        (hypothesis,) = fit.hypotheses
        spread = 4 * np.sqrt(fit.covariance[0, 0])
        bounds = (hypothesis.bounds[0][0], hypothesis.bounds[1][0])
        values = np.unique(np.clip(fit.numbers[0] + spread * np.linspace(-1, 1, 17), *bounds))
        losses, prior = [], self.prior(len(fit.numbers) - 1)
        for value in values:
            errors = fit.columns[:, :, :1] + (value - fit.linearisation_point[0]) * fit.columns[:, :, 1:2]
            products = self.sensitivities.with_nuisances(np.concatenate([errors, fit.columns[:, :, 2:]], axis=2))
            losses.append(products.penalised_loss(products.fit(prior, self.all_pieces), prior))
        return ProfileLikelihood(hypothesis, values, np.array(losses) - min(losses))

    def fit_promising(self, guesses: Sequence[LinearGuess], most: int) -> tuple[Fit, ...]:
        """Fit the most promising guesses; best on held-out logs first."""
        fits = sorted(self.fit_nonlinear(self.shortlist(guesses, most)), key=lambda fit: fit.heldout.sum())
        for fit in fits[:3]:
            self.progress(f"{in_words(fit)}: gain {self.nominal.heldout.sum() - fit.heldout.sum():.0f}")
        return tuple(fits)

    def shortlist(self, guesses: Sequence[LinearGuess], most: int) -> list[LinearGuess]:
        """The best guesses of single effects by their loss: each once, and a limited number of the same effect."""
        kept: dict[Hypothesis, LinearGuess] = {}
        of_effect = Counter[str]()
        for guess in sorted(guesses, key=lambda g: g.loss):
            (h,) = guess.hypotheses
            if h not in kept and of_effect[h.name] < self.plan.per_effect and len(kept) < most:
                kept[h] = guess
                of_effect[h.name] += 1
        return list(kept.values())

    def is_convincing(self, fit: Fit) -> bool:
        """Whether a cause gains enough on held-out logs."""
        log = self.evidence.log_of_piece
        gains = np.bincount(log, self.nominal.heldout - fit.heldout)[np.unique(log)]  # not every log need have a piece
        return bool(gains.sum() > self.plan.least_gain and (gains > 0).mean() >= self.plan.least_agree)

    @property
    def all_pieces(self) -> np.ndarray:
        """Mask that selects all pieces, bool, (pieces,)."""
        return np.ones(self.evidence.size, bool)

    def prior(self, numbers: int) -> np.ndarray:
        """1/σ² of the numbers, which is 0, then of the nuisances, (numbers + nuisances,)."""
        return np.concatenate([np.zeros(numbers), np.ones(self.sensitivities.nuisances.shape[2])])

    def residuals(self, tried: Sequence[tuple[Sequence[Hypothesis], np.ndarray]]) -> list[np.ndarray]:
        """Whitened errors (pieces, values) of sets of hypotheses with their numbers."""
        candidates = [
            on_logs(self.evidence, *zip(hypotheses, split_numbers(hypotheses, numbers), strict=True))
            for hypotheses, numbers in tried
        ]
        return [concatenate_logs(of) for of in self.evidence.residuals(candidates)]

    def loss_of(self, errors: np.ndarray) -> float:
        """Loss of errors (pieces, values) with the nuisances fitted."""
        products, prior = self.sensitivities.with_nuisances(errors[:, :, None]), self.prior(0)
        return products.penalised_loss(products.fit(prior, self.all_pieces), prior)

    def guess_sizes(self, hypotheses: Sequence[Hypothesis]) -> list[LinearGuess]:
        """Guesses from simulations of effects at several sizes."""
        tried = [
            [(h, numbers)]
            for h in hypotheses
            for size in TRIALS
            for sign in (1.0, -1.0)
            if h.allows(numbers := h.nominal + size * sign * h.moderate)
        ]
        found = self.sensitivities.departures(tried)
        return [
            LinearGuess((h,), x, self.loss_of(self.sensitivities.nominal + change))
            for ((h, x),), change in zip(tried, found, strict=True)
        ]

    def rank_effects(self, base: Fit, hypotheses: Sequence[Hypothesis]) -> list[str]:
        """Names of effects to add to a fit, best first by the linear model."""
        guesses = sorted(self.guess_linear(base, hypotheses), key=lambda guess: guess.loss)
        return list(dict.fromkeys(guess.hypotheses[-1].name for guess in guesses))[: self.plan.promising]

    def guess_linear(self, base: Fit, hypotheses: Sequence[Hypothesis]) -> list[LinearGuess]:
        """Guesses in the linear model: a fit with each further hypothesis."""
        further = [h for h in hypotheses if h.name not in base.names and h.name in self.sensitivities.names]
        found = []
        for h, products in zip(further, self.sensitivities.with_hypotheses(base.columns, further), strict=True):
            both, p = (*base.hypotheses, h), len(base.numbers) + len(h.parameters)
            weights = products.fit(self.prior(p), self.all_pieces, LINEAR_ITERATIONS)
            numbers = np.concatenate([base.numbers, h.nominal]) + weights[1 : 1 + p]
            found.append(
                LinearGuess(both, clip_numbers(both, numbers), products.penalised_loss(weights, self.prior(p)))
            )
        return found

    def fit_nonlinear(self, guesses: Sequence[LinearGuess]) -> list[Fit]:
        """Fit sets of hypotheses to their own replays, all in one batch."""
        before = self.nominal.loss
        fits = [GaussNewtonFit(g.hypotheses, g.numbers, g.numbers) for g in guesses]
        for step in range(self.plan.steps):
            active = [d for d in fits if not d.done]
            if not active:
                break
            self.step(active)
            least = min(d.loss for d in fits)
            for d in active:
                d.done = d.done or (step > 0 and before - d.loss < HOPELESS * (before - least))
        return [self.cross_validate(d.hypotheses, d.best, d.columns) for d in fits if d.columns is not None]

    def step(self, fits: Sequence[GaussNewtonFit]) -> None:
        """Evaluate each fit once, with derivatives where there are none yet, and update its numbers."""
        tried: list[tuple[tuple[Hypothesis, ...], np.ndarray]] = []
        for d in fits:
            tried.append((d.hypotheses, d.numbers))
            if d.columns is None:
                tried += [(d.hypotheses, d.numbers + by) for by in differences(d.hypotheses, d.numbers)]
        found = iter(self.residuals(tried))
        for d in fits:
            errors = next(found)
            if d.columns is None:
                by = differences(d.hypotheses, d.numbers)
                slopes = np.stack([(next(found) - errors) / step.sum() for step in by], axis=2)
            else:
                slopes = broyden(d.columns, d.numbers - d.best, errors)
            loss = self.loss_of(errors)
            if loss > d.loss:  # too far: keep the place, learn the slope, go half way
                d.columns = np.concatenate([d.columns[:, :, :1], slopes], axis=2) if d.columns is not None else None
                d.numbers = (d.numbers + d.best) / 2
                continue
            d.done = d.loss - loss < SETTLED
            d.loss, d.best = loss, d.numbers
            d.columns = np.concatenate([errors[:, :, None], slopes], axis=2)
            products, p = self.sensitivities.with_nuisances(d.columns), len(d.numbers)
            d.numbers = clip_numbers(d.hypotheses, d.best + products.fit(self.prior(p), self.all_pieces)[1 : 1 + p])

    def cross_validate(self, hypotheses: tuple[Hypothesis, ...], numbers: np.ndarray, columns: np.ndarray) -> Fit:
        """Numbers and held-out losses of a set, fitted on the other folds by derivatives ``columns`` at ``numbers``.

        These derivatives are wrong where the time of a contact changes. So that no such piece decides alone, the loss
        of a held-out piece is at most ``MOST_SURPRISE`` above its fitted loss. Nuisances explain no more than ``FAR``
        of their standard deviations: beyond, it is no tolerance.
        """
        products, p = self.sensitivities.with_nuisances(columns), len(numbers)
        prior = self.prior(p)
        weights = products.fit(prior, self.all_pieces, furthest=FAR)
        most = products.loss(weights) + MOST_SURPRISE
        heldout, folds = np.zeros(self.evidence.size), []
        for fold in range(int(self.fold_of_log.max()) + 1):
            out = self.fold_of_piece == fold
            others = products.fit(prior, ~out, furthest=FAR)
            folds.append(clip_numbers(hypotheses, numbers + others[1 : 1 + p]))
            heldout[out] = np.minimum(products.loss(others), most)[out]
        chi2 = products.chi2(weights)
        emphasis = 2 * products.values / (products.values + chi2)
        normal = np.tensordot(emphasis, products.gram, axes=1)[1:, 1:] + np.diag(prior)
        slope = emphasis[:, None] * (products.gram @ weights)[:, 1:]
        return Fit(
            hypotheses=hypotheses,
            numbers=clip_numbers(hypotheses, numbers + weights[1 : 1 + p]),
            covariance=covariance(normal, slope.T @ slope + np.diag(prior), p),
            fold_numbers=np.array(folds),
            linearisation_point=numbers,
            columns=columns,
            loss=products.penalised_loss(weights, prior),
            chi2=chi2 / products.values,
            heldout=heldout,
        )
