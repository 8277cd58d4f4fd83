"""Which effects: sets of hypotheses fitted to the evidence of some logs and judged on the others.

Every hypothesis is tried in the linear model of the responses; the most promising are fitted to replays of their own
(Gauss–Newton, derivatives kept up to date by Broyden's rule), several at once. Nuisances are free for the nominal
robot and for every hypothesis alike.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap.diagnosis.candidates import Fit, ProfileLikelihood, SearchResult, clip_numbers, in_words, split_numbers
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.sensitivities import Sensitivities, concatenate_logs, on_logs
from leapgap.diagnosis.short_rollouts import ShortRollouts

STEP = 0.1
"""Of a moderate departure: finite differences of Gauss–Newton."""
SETTLED = 0.3
"""A fit whose loss falls by less is done."""
TRIALS = (0.4, 2.5)
"""Moderate departures at which an effect that acts everywhere is tried as it is, beside the linear model."""
LINEAR_ITERATIONS = 4
MOST_SURPRISE = 30.0
"""Log likelihood that a piece may lose by not being fitted; pieces that derivatives do not mislead lose a few."""
HOPELESS = 0.3
"""A fit that after its second step bought less than this share of what the best one bought is not pursued."""


@dataclass(frozen=True)
class LinearGuess:
    """A set of hypotheses with numbers, and how well it does in the linear model."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray
    loss: float


@dataclass
class GaussNewtonFit:
    """One set of hypotheses on its way down."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray
    """Where it is tried next."""
    best: np.ndarray
    """Where it was best."""
    loss: float = np.inf
    columns: np.ndarray | None = None
    done: bool = False


@dataclass(frozen=True)
class SearchSettings:
    """How wide the search is, and when a further cause is believed."""

    shortlist: int = 8
    """Sets fitted to replays of their own in the first round; of every later one, half as many."""
    per_effect: int = 3
    """Of those of the first round, with one effect at different places; later ones try every set of effects once, at
    the places that promise most."""
    steps: int = 8
    """Of Gauss–Newton; most sets settle earlier."""
    promising: int = 7
    """Effects that in some of the evidence explain most beside the first, and are tried in all of it."""
    beams: int = 2
    """Sets of a round that the next one builds on."""
    most_causes: int = 4
    least_gain: float = 20.0
    """A cause must gain so much log likelihood on held-out logs; logs without any gap gain up to 17."""
    least_further_gain: float = 60.0
    """A further cause must gain so much: what the first leaves by being simulated otherwise gains up to 50."""
    least_share: float = 0.015
    """A cause must gain this share of what all causes together gain."""
    least_agree: float = 0.75
    """On this share of the logs a cause must gain something at all."""


def find_causes(
    bare: ShortRollouts,
    coarse: ShortRollouts,
    hypotheses: Sequence[Hypothesis],
    tolerances: Mapping[str, float],
    fold_of_log: np.ndarray,
    plan: SearchSettings,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search some of the evidence about the nominal robot, then all of it about the robot with what was found there.

    Far from the truth neither noise nor small effects do what they do near it.
    """
    first = Search(Sensitivities.of(coarse, hypotheses, tolerances), fold_of_log, plan, progress)
    singles = first.singles(hypotheses)
    sensible = [fit for fit in singles if fit.sensible]
    if sensible and first.is_convincing(sensible[0], first.nominal):
        best, refined = sensible[0], sensible[: (plan.shortlist + 1) // 2]
        around = list(zip(best.hypotheses, best.split(), strict=True))
        names = {*first.rank_effects(best, hypotheses), *(fit.names[0] for fit in refined)}
        hopeful = [h for h in hypotheses if h.name in names]
        search = Search(Sensitivities.of(bare, hopeful, tolerances, around), fold_of_log, plan, progress)
        return search.select_forward(hopeful, search.refit(refined))
    search = Search(Sensitivities.of(bare, hypotheses, tolerances), fold_of_log, plan, progress)
    return search.select_forward(hypotheses, search.singles(hypotheses))


@dataclass
class Search:
    """Looks for sets of hypotheses on one body of evidence."""

    sensitivities: Sensitivities
    fold_of_log: np.ndarray
    plan: "SearchSettings"
    progress: Callable[[str], None] = field(default=lambda _: None)

    def __post_init__(self) -> None:
        self.evidence: ShortRollouts = self.sensitivities.evidence
        self.fold_of_piece = self.fold_of_log[self.evidence.log_of_piece]
        self.nominal = self.cross_validate((), np.zeros(0), self.sensitivities.nominal[:, :, None])

    def singles(self, hypotheses: Sequence[Hypothesis]) -> tuple[Fit, ...]:
        """Each effect alone: the most promising ones fitted, best on held-out logs first."""
        guesses = [*self.guess_sizes(hypotheses), *self.guess_linear(self.nominal, hypotheses)]
        return self.fit_promising(guesses, self.plan.shortlist, self.nominal)

    def refit(self, fits: Sequence[Fit]) -> tuple[Fit, ...]:
        """Fits of other evidence, begun where they ended."""
        return self.fit_promising(
            [LinearGuess(f.hypotheses, f.numbers, f.heldout.sum()) for f in fits], len(fits), self.nominal
        )

    def select_forward(self, hypotheses: Sequence[Hypothesis], first: tuple[Fit, ...]) -> SearchResult:
        """Believe the best of the first fits, and add hypotheses while a further one gains on held-out logs."""
        selected, rounds, fits = self.nominal, [], first
        while fits:
            rounds.append(fits)
            sensible = [fit for fit in fits if fit.sensible]
            if not sensible or not self.is_convincing(sensible[0], selected):
                break
            selected = sensible[0]
            if len(rounds) >= self.plan.most_causes:
                break
            further = [g for beam in sensible[: self.plan.beams] for g in self.guess_linear(beam, hypotheses)]
            fits = self.fit_promising(further, (self.plan.shortlist + 1) // 2, selected)
        return SearchResult(
            self.nominal,
            selected,
            tuple(rounds),
            self.evidence.log_of_piece,
            self.nominal.columns.shape[1],
            self.profiles(first),
        )

    def profiles(self, fits: Sequence[Fit]) -> tuple[ProfileLikelihood, ...]:
        """One for each effect, at its best place."""
        best: dict[str, Fit] = {}
        for fit in fits:
            best.setdefault(fit.names[0], fit)
        return tuple(self.profile(fit) for fit in best.values())

    def profile(self, fit: Fit) -> ProfileLikelihood:
        """Of one hypothesis, by the derivatives at its fit."""
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

    def fit_promising(self, guesses: Sequence[LinearGuess], most: int, before: Fit) -> tuple[Fit, ...]:
        """The most promising guesses fitted, best on held-out logs first."""
        fits = sorted(self.fit_nonlinear(self.shortlist(guesses, most), before.loss), key=lambda fit: fit.heldout.sum())
        for fit in fits[:3]:
            self.progress(f"{in_words(fit)}: gain {self.nominal.heldout.sum() - fit.heldout.sum():.0f}")
        return tuple(fits)

    def shortlist(self, guesses: Sequence[LinearGuess], most: int) -> list[LinearGuess]:
        """The most promising guesses, not too many of the same effects, each set once."""
        kept: dict[frozenset[Hypothesis], LinearGuess] = {}
        of_effects = Counter[frozenset[str]]()
        for guess in sorted(guesses, key=lambda g: g.loss):
            key, effects = frozenset(guess.hypotheses), frozenset(h.name for h in guess.hypotheses)
            many = self.plan.per_effect if len(effects) == 1 else 1
            if key not in kept and of_effects[effects] < many and len(kept) < most:
                kept[key] = guess
                of_effects[effects] += 1
        return list(kept.values())

    def is_convincing(self, fit: Fit, before: Fit) -> bool:
        """Whether a further cause gains enough on held-out logs."""
        log = self.evidence.log_of_piece
        gains = np.bincount(log, before.heldout - fit.heldout)[np.unique(log)]  # not every log need have a piece
        gain = gains.sum()
        whole = (self.nominal.heldout - fit.heldout).sum()
        plan = self.plan
        least = plan.least_further_gain if before.hypotheses else plan.least_gain
        return bool(gain > least and gain > plan.least_share * whole and (gains > 0).mean() >= plan.least_agree)

    @property
    def all_pieces(self) -> np.ndarray:
        """All pieces."""
        return np.ones(self.evidence.size, bool)

    def prior(self, numbers: int) -> np.ndarray:
        """1/σ² of free numbers, then of the nuisances."""
        return np.concatenate([np.zeros(numbers), np.ones(self.sensitivities.nuisances.shape[2])])

    def residuals(self, tried: Sequence[tuple[Sequence[Hypothesis], np.ndarray]]) -> list[np.ndarray]:
        """Whitened errors (pieces, values) of sets of hypotheses with their numbers."""
        candidates = [
            on_logs(self.evidence, *zip(hypotheses, split_numbers(hypotheses, numbers), strict=True))
            for hypotheses, numbers in tried
        ]
        return [concatenate_logs(of) for of in self.evidence.residuals(candidates)]

    def loss_of(self, errors: np.ndarray) -> float:
        """Loss of errors once the nuisances took their part."""
        products, prior = self.sensitivities.with_nuisances(errors[:, :, None]), self.prior(0)
        return products.penalised_loss(products.fit(prior, self.all_pieces), prior)

    def guess_sizes(self, hypotheses: Sequence[Hypothesis]) -> list[LinearGuess]:
        """Effects that act everywhere, at several sizes, not linear in them."""
        tried = [
            [(h, numbers)]
            for h in hypotheses
            if h.location == "all"
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
        """Effects that may act beside a fit, the best first."""
        guesses = sorted(self.guess_linear(base, hypotheses), key=lambda guess: guess.loss)
        return list(dict.fromkeys(guess.hypotheses[-1].name for guess in guesses))[: self.plan.promising]

    def guess_linear(self, base: Fit, hypotheses: Sequence[Hypothesis]) -> list[LinearGuess]:
        """Each further hypothesis on top of a fit, in the linear model."""
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

    def fit_nonlinear(self, guesses: Sequence[LinearGuess], before: float) -> list[Fit]:
        """Fit sets of hypotheses to their own replays, all side by side; ``before`` is the loss to be lowered."""
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
        """One evaluation of each, with derivatives where there are none yet, and one move."""
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
        """Held out: numbers and nuisances fitted on the other folds, by the derivatives at the fit.

        Where a foot touches a moment later these derivatives mislead: one such piece must not decide, so that none
        is held to lose more than ``MOST_SURPRISE`` by not being fitted.
        """
        products, p = self.sensitivities.with_nuisances(columns), len(numbers)
        prior = self.prior(p)
        weights = products.fit(prior, self.all_pieces)
        most = products.loss(weights) + MOST_SURPRISE
        heldout, folds = np.zeros(self.evidence.size), []
        for fold in range(int(self.fold_of_log.max()) + 1):
            out = self.fold_of_piece == fold
            others = products.fit(prior, ~out)
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


def covariance(normal: np.ndarray, scatter: np.ndarray, numbers: int) -> np.ndarray:
    """Of the first numbers: the inverse curvature, widened to the sandwich N⁻¹ S N⁻¹ where errors are not white."""
    inverse = np.linalg.pinv(normal)
    plain, sandwich = inverse[:numbers, :numbers], (inverse @ scatter @ inverse)[:numbers, :numbers]
    wider = np.sqrt(np.maximum(1.0, np.diag(sandwich) / np.maximum(np.diag(plain), 1e-300)))
    return np.asarray(plain * wider[:, None] * wider)


def differences(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """A small step in each number, inside its range."""
    steps = STEP * np.concatenate([h.moderate for h in hypotheses])
    lower, upper = (np.concatenate([h.bounds[side] for h in hypotheses]) for side in (0, 1))
    inside = (numbers + steps <= upper) & (numbers + steps >= lower)
    return list(np.diag(np.where(inside, steps, -steps)))


def broyden(columns: np.ndarray, move: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Derivatives (pieces, values, numbers) that also explain what a move did to the errors."""
    length = float(move @ move)
    slopes = columns[:, :, 1:]
    if length == 0:
        return slopes
    surprise = errors - columns[:, :, 0] - slopes @ move
    return np.asarray(slopes + surprise[:, :, None] * move / length)
