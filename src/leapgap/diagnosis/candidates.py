"""What a search for causes believes: sets of hypotheses with numbers, and how well they do on logs not fitted on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.hypotheses import Hypothesis

LEAST_SPREADS = 2.0
"""A number this many standard deviations from nominal is known to differ from it."""


@dataclass(frozen=True)
class Candidate:
    """A set of hypotheses acting together, with their numbers."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray
    """Fitted on all logs, those of all hypotheses in one vector."""
    covariance: np.ndarray
    """Of the numbers."""
    fold_numbers: np.ndarray
    """Fitted without each fold, (folds, numbers)."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(h.name for h in self.hypotheses)

    @property
    def at_bound(self) -> bool:
        """Whether some number ran to the end of its range."""
        return any(h.at_bound(n) for h, n in zip(self.hypotheses, self.split(), strict=True))

    @property
    def sensible(self) -> bool:
        """Whether every hypothesis departs from nominal, and none ran to the end of its range."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        departs = [
            (np.abs(n - h.nominal) > LEAST_SPREADS * s).any()
            for h, n, s in zip(self.hypotheses, self.split(), self.split(spread), strict=True)
        ]
        return all(departs) and not self.at_bound

    def split(self, numbers: np.ndarray | None = None) -> list[np.ndarray]:
        """Numbers of each hypothesis."""
        return split_numbers(self.hypotheses, self.numbers if numbers is None else numbers)


@dataclass(frozen=True)
class Fit(Candidate):
    """A belief fitted to replays of its own, and judged on logs it was not fitted on.

    Its covariance has the nuisances free: from the curvature of the loss, or from the scatter of its slope over pieces
    where that says more.
    """

    linearisation_point: np.ndarray
    """Where it was replayed: the numbers are one linear step from here."""
    columns: np.ndarray
    """Errors there and their derivatives, (pieces, values, 1 + numbers)."""
    loss: float
    """On all logs, fitted on all."""
    chi2: np.ndarray
    """Of each piece over its values, fitted on all logs; 1 is what noise explains, (pieces,)."""
    heldout: np.ndarray
    """Loss of each piece, fitted without its fold, (pieces,)."""


@dataclass(frozen=True)
class ProfileLikelihood:
    """How much worse the evidence fits as a hypothesis's first number leaves its best value, all else free."""

    hypothesis: Hypothesis
    values: np.ndarray
    loss: np.ndarray
    """Above the least, (values,)."""


@dataclass(frozen=True)
class SearchResult:
    """What a search believes, and all that it fitted on the way."""

    nominal: Fit
    selected: Fit
    rounds: tuple[tuple[Fit, ...], ...]
    """Fits of sets of one, two, … hypotheses, best on held-out logs first; the last round may not be believed."""
    log_of_piece: np.ndarray
    values: int
    """Of a piece."""
    profiles: tuple["ProfileLikelihood", ...]
    """Of the first round."""

    def before(self, number: int) -> Fit:
        """The fit of the first so many of the believed hypotheses."""
        if number == 0:
            return self.nominal
        wanted = self.selected.hypotheses[:number]
        return next(fit for fit in self.rounds[number - 1] if fit.hypotheses == wanted)

    @property
    def steps(self) -> tuple[Fit, ...]:
        """Fits of the first one, two, … of the believed hypotheses; the last is what is believed."""
        return tuple(self.before(k) for k in range(1, len(self.selected.hypotheses) + 1))

    @property
    def rivals(self) -> tuple[Fit, ...]:
        """Sets as large as the believed one, itself among them."""
        return self.rounds[len(self.selected.hypotheses) - 1] if self.selected.hypotheses else ()

    @property
    def alternatives(self) -> tuple[Fit, ...]:
        """The rivals, then each effect alone."""
        return (*self.rivals, *(self.rounds[0] if self.rounds else ()))


def in_words(fit: Candidate) -> str:
    """``payload 1.7 + foot_friction at front 0.44``."""
    parts = []
    for h, numbers in zip(fit.hypotheses, fit.split(), strict=True):
        where = "" if h.location == "all" else f" at {h.location}"
        parts.append(f"{h.name}{where} {' '.join(f'{n:.4g}' for n in numbers)}")
    return " + ".join(parts)


def split_numbers(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """One vector of numbers cut to those of each hypothesis."""
    return np.split(numbers, np.cumsum([len(h.parameters) for h in hypotheses])[:-1]) if hypotheses else []


def clip_numbers(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> np.ndarray:
    """Numbers within their ranges."""
    parts = [h.clip(n) for h, n in zip(hypotheses, split_numbers(hypotheses, numbers), strict=True)]
    return np.concatenate(parts) if parts else numbers
