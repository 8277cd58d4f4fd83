"""Evidence of sets of effects, from inner products of whitened errors and columns.

Errors e of a block of intervals are E x + noise: x holds the numbers of effects, each N(0, its prior), and nuisances,
each N(0, its tolerance). With G = EᵀE and b = Eᵀe the evidence of any set, its numbers and their covariance follow in
closed form. Each block has the level of the force without a name that suits it best, given the set.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

BLOCK_S = 0.1
"""Length of a block, s: the force without a name has one level in it."""


@dataclass(frozen=True)
class Posterior:
    """What logs say of a set of columns."""

    evidence: float
    """Log of the marginal likelihood, nats."""
    mean: np.ndarray
    """Of all used columns, (used,)."""
    covariance: np.ndarray
    """(used, used)"""


@dataclass
class Evidence:
    """Inner products of errors (column 0) and all columns, for each level and block."""

    gram: np.ndarray
    """(levels, blocks, 1 + columns, 1 + columns)"""
    constant: np.ndarray
    """Log determinants of the innovations' covariances, (levels, blocks)."""
    log_of_block: np.ndarray
    """(blocks,)"""
    places: Sequence[tuple[int, int, int]]
    """Chunk, first interval and the one after the last of each block."""
    levels: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """Index of the level of each block, (blocks,)."""

    def total(self, blocks: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Sum of inner products and of constants over some blocks (mask; all, if None), each at its level."""
        chosen = np.flatnonzero(np.ones(len(self.levels), bool) if blocks is None else blocks)
        return self.gram[self.levels[chosen], chosen].sum(axis=0), float(
            self.constant[self.levels[chosen], chosen].sum()
        )

    def only(self, columns: np.ndarray) -> "Evidence":
        """The same with some of the columns, which are told by their indices."""
        at = np.concatenate([[0], 1 + columns])
        return replace(self, gram=self.gram[:, :, at[:, None], at], levels=self.levels.copy())

    def without_each(self, parts: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Sums as in ``total`` over the blocks of all parts but one, for each; ``parts`` are numbers, (blocks,)."""
        own = [self.total(parts == part) for part in range(int(parts.max()) + 1)]
        gram, constant = np.sum([g for g, _ in own], axis=0), sum(c for _, c in own)
        return [(gram - g, constant - c) for g, c in own]

    def posterior(
        self,
        transform: np.ndarray,
        deviation: np.ndarray,
        centre: np.ndarray,
        total: tuple[np.ndarray, float] | None = None,
    ) -> Posterior:
        """The posterior of sums of columns: ``transform`` (columns, used), prior deviations and means (used,)."""
        gram, constant = self.total() if total is None else total
        return posterior_of(gram, constant, transform, deviation, centre)

    def choose_levels(self, transform: np.ndarray, deviation: np.ndarray, centre: np.ndarray, rounds: int = 3) -> None:
        """Set the level of each block to the likeliest one, given the numbers that all blocks tell."""
        for _ in range(rounds):
            mean = self.posterior(transform, deviation, centre).mean
            before, self.levels = self.levels, np.argmax(self.by_level(transform @ mean), axis=0)
            if (before == self.levels).all():
                break

    def by_level(self, weights: np.ndarray) -> np.ndarray:
        """Log likelihood of each block at each level, (levels, blocks), for weights of the columns (columns,)."""
        left = np.concatenate([[1.0], -weights])
        squares = np.einsum("i,lbij,j->lb", left, self.gram, left, optimize=True)
        return np.asarray(-0.5 * (squares + self.constant))


def posterior_of(
    gram: np.ndarray, constant: float, transform: np.ndarray, deviation: np.ndarray, centre: np.ndarray
) -> Posterior:
    """The posterior from summed inner products (1 + columns, 1 + columns), errors first."""
    scaled = transform * deviation
    weights = transform @ centre
    errors = gram[0, 0] - 2 * weights @ gram[1:, 0] + weights @ gram[1:, 1:] @ weights
    inner, cross = scaled.T @ gram[1:, 1:] @ scaled, scaled.T @ (gram[1:, 0] - gram[1:, 1:] @ weights)
    root = np.linalg.cholesky(np.eye(len(cross)) + inner)
    half = np.linalg.solve(root, cross)
    evidence = -0.5 * (errors - half @ half + constant) - np.log(np.diag(root)).sum()
    back = np.linalg.inv(root)
    covariance = (back.T @ back) * deviation[:, None] * deviation
    return Posterior(float(evidence), centre + deviation * (back.T @ half), covariance)


def inner_products(
    whitened: Sequence[np.ndarray],
    determinants: Sequence[np.ndarray],
    valid: np.ndarray,
    log_of_chunk: np.ndarray,
    per_block: int,
) -> Evidence:
    """Inner products of whitened columns (chunks, longest, channels, 1 + columns) of each level, block by block."""
    lengths = valid.sum(axis=1).tolist()
    places = [
        (chunk, int(part[0]), int(part[-1]) + 1)
        for chunk, length in enumerate(lengths)
        for part in np.array_split(np.arange(length), max(1, round(length / per_block)))
    ]
    columns = whitened[0].shape[3]
    gram = np.zeros((len(whitened), len(places), columns, columns))
    constant = np.zeros((len(whitened), len(places)))
    for level, (values, logs) in enumerate(zip(whitened, determinants, strict=True)):
        for k, (chunk, first, end) in enumerate(places):
            own = values[chunk, first:end].reshape(-1, columns)
            gram[level, k] = own.T @ own
            constant[level, k] = logs[chunk, first:end].sum()
    log_of_block = log_of_chunk[[chunk for chunk, _, _ in places]]
    return Evidence(gram, constant, log_of_block, places, np.full(len(places), len(whitened) // 2))


def exchanged(
    before: Evidence, kept: np.ndarray, kept_columns: Sequence[np.ndarray], changed: Sequence[np.ndarray]
) -> Evidence:
    """Evidence of other errors and further columns (column 0 and those behind it of ``changed``) beside kept ones.

    ``kept`` are indices in the inner products of the whitened ``kept_columns``; their products among themselves stay.
    """
    number, new = len(kept), changed[0].shape[3]
    gram = np.zeros((*before.gram.shape[:2], number + new, number + new))
    gram[:, :, 1 : 1 + number, 1 : 1 + number] = before.gram[:, :, kept[:, None], kept]
    at = np.concatenate([[0], np.arange(1 + number, number + new)])
    for level, (others, own) in enumerate(zip(kept_columns, changed, strict=True)):
        for k, (chunk, first, end) in enumerate(before.places):
            mine = own[chunk, first:end].reshape(-1, new)
            cross = mine.T @ others[chunk, first:end].reshape(-1, number)
            gram[level, k, at, 1 : 1 + number] = cross
            gram[level, k, 1 : 1 + number, at] = cross
            gram[level, k, at[:, None], at] = mine.T @ mine
    return replace(before, gram=gram, levels=before.levels.copy())
