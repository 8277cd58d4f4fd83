"""Evidence of sets of effects, from inner products of whitened errors and columns.

Errors e of a block of intervals are E x + noise: x holds the numbers of effects, each N(0, its prior), and nuisances,
each N(0, its tolerance). With G = EᵀE and b = Eᵀe the evidence of any set, its numbers and their covariance follow in
closed form. Each block has the level of the force without a name that suits it best, given the set.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

BLOCK_S = 0.1  # Length of a block, s: the force without a name has one level in it

ROUNDS = 8  # Most rounds in which levels and numbers are told in turn

Whitened = Sequence[np.ndarray]  # Columns at each level, (chunks, longest, channels, columns)


@dataclass(frozen=True)
class Posterior:
    """What logs say of a set of columns."""

    evidence: float  # Log of the marginal likelihood, nats
    mean: np.ndarray  # (columns,)
    covariance: np.ndarray  # (columns, columns)


@dataclass(frozen=True)
class Blocks:
    """The blocks of all logs."""

    places: Sequence[tuple[int, int, int]]  # Chunk, first interval and the one after the last
    log: np.ndarray  # (blocks,)
    constant: np.ndarray  # Log determinants of the innovations' covariances, (levels, blocks)

    @staticmethod
    def of(determinants: Sequence[np.ndarray], valid: np.ndarray, log_of_chunk: np.ndarray, per_block: int) -> "Blocks":
        """Blocks of about ``per_block`` intervals each, of the intervals that are ``valid`` (chunks, longest)."""
        places = [
            (chunk, int(part[0]), int(part[-1]) + 1)
            for chunk, length in enumerate(valid.sum(axis=1).tolist())
            for part in np.array_split(np.arange(length), max(1, round(length / per_block)))
        ]
        constant = [[logs[chunk, first:end].sum() for chunk, first, end in places] for logs in determinants]
        return Blocks(places, log_of_chunk[[chunk for chunk, _, _ in places]], np.array(constant))

    def part(self, chosen: np.ndarray) -> tuple["Blocks", np.ndarray]:
        """The blocks of some chunks (bool), which are counted by themselves, and their indices."""
        kept = np.flatnonzero(chosen[[chunk for chunk, _, _ in self.places]])
        number = np.cumsum(chosen) - 1
        places = [(int(number[chunk]), first, end) for chunk, first, end in (self.places[k] for k in kept.tolist())]
        return Blocks(places, self.log[kept], self.constant[:, kept]), kept

    def products(self, ours: Whitened, theirs: Whitened) -> np.ndarray:
        """Inner products of two sets of columns in each block, (levels, blocks, our columns, their columns)."""
        found = np.zeros((*self.constant.shape, ours[0].shape[3], theirs[0].shape[3]))
        for of_level, a, b in zip(found, ours, theirs, strict=True):
            for own, (chunk, first, end) in zip(of_level, self.places, strict=True):
                left = a[chunk, first:end].reshape(-1, a.shape[3])
                own[:] = left.T.astype(float) @ b[chunk, first:end].reshape(-1, b.shape[3])
        return found

    def at_levels(self, columns: Whitened, levels: np.ndarray) -> np.ndarray:
        """Columns (rows, columns) of all blocks, each block at its level."""
        of_blocks = [
            columns[level][chunk, first:end].reshape(-1, columns[0].shape[3])
            for level, (chunk, first, end) in zip(levels, self.places, strict=True)
        ]
        return np.concatenate(of_blocks, dtype=float)


@dataclass(frozen=True)
class Evidence:
    """Inner products of errors (column 0) and columns, for each level and block."""

    blocks: Blocks
    gram: np.ndarray  # (levels, blocks, 1 + columns, 1 + columns)
    levels: np.ndarray  # Index of the level of each block, (blocks,)

    @staticmethod
    def of(blocks: Blocks, columns: Whitened, known: np.ndarray) -> "Evidence":
        """Evidence of errors (column 0) and further columns beside known inner products of columns alone.

        ``columns`` are all: the errors, those with ``known`` products (levels, blocks, known, known), the further ones.
        """
        kept = known.shape[2]
        new = [0, *range(1 + kept, columns[0].shape[3])]
        gram = np.zeros((*known.shape[:2], columns[0].shape[3], columns[0].shape[3]))
        gram[:, :, 1 : 1 + kept, 1 : 1 + kept] = known
        products = blocks.products([of[..., new] for of in columns], columns)
        gram[:, :, new] = products
        gram[:, :, :, new] = products.transpose(0, 1, 3, 2)
        return Evidence(blocks, gram, np.full(len(blocks.places), len(columns) // 2))

    @staticmethod
    def of_error(blocks: Blocks, own: Whitened, cross: np.ndarray, known: np.ndarray) -> "Evidence":
        """Evidence of an error, one column, beside columns: products with these, ``cross``, and among them, ``known``.

        (levels, blocks, columns) and (levels, blocks, columns, columns); it has 50 MB.
        """
        gram = np.zeros((*known.shape[:2], 1 + known.shape[2], 1 + known.shape[2]))
        gram[:, :, 1:, 1:], gram[:, :, :1, :1] = known, blocks.products(own, own)
        gram[:, :, 0, 1:] = gram[:, :, 1:, 0] = cross
        return Evidence(blocks, gram, np.full(len(blocks.places), len(own) // 2))

    def extended(self, columns: Whitened, further: Whitened) -> "Evidence":
        """The same with further columns beside the errors and columns that it has, ``columns``."""
        more = further[0].shape[3]
        cross = self.blocks.products(columns, further)
        gram = np.pad(self.gram, ((0, 0), (0, 0), (0, more), (0, more)))
        gram[:, :, :-more, -more:] = cross
        gram[:, :, -more:, :-more] = cross.transpose(0, 1, 3, 2)
        gram[:, :, -more:, -more:] = self.blocks.products(further, further)
        return replace(self, gram=gram)

    def total(self, blocks: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Sum of inner products and of constants over some blocks (mask; all, if None), each at its level."""
        chosen = np.flatnonzero(np.ones(len(self.levels), bool) if blocks is None else blocks)
        at = self.levels[chosen], chosen
        return self.gram[at].sum(axis=0), float(self.blocks.constant[at].sum())

    def of_each(self, parts: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Sums as in ``total`` over the blocks of each part; ``parts`` are numbers, (blocks,)."""
        return [self.total(parts == part) for part in range(int(parts.max()) + 1)]

    def posterior(self, deviation: np.ndarray, centre: np.ndarray) -> Posterior:
        """The posterior of all columns, by prior deviations and means (columns,)."""
        return posterior_of(*self.total(), deviation, centre)

    def at_best_levels(self, deviation: np.ndarray, centre: np.ndarray) -> "Evidence":
        """The same with each block at its likeliest level, given the numbers that all blocks tell.

        Levels and numbers are told in turn, from the levels as they are and from the least one, at which a set that
        explains everything shows; the likelier end stays.
        """
        ends = []
        for levels in (self.levels, np.zeros_like(self.levels)):
            found = replace(self, levels=levels)
            for _ in range(ROUNDS):
                mean = found.posterior(deviation, centre).mean
                before, found = found.levels, replace(found, levels=np.argmax(found.by_level(mean), axis=0))
                if (before == found.levels).all():
                    break
            ends.append(found)
        return max(ends, key=lambda one: one.posterior(deviation, centre).evidence)

    def scatter(self, deviation: np.ndarray, centre: np.ndarray, numbers: np.ndarray) -> float:
        """How much more numbers differ from segment to segment than they should: a ratio of variances, mean, 1 or more.

        By the slopes of the segments' log likelihoods along each number, as the others follow it. Of a force without
        a name that is random in time it is 1; of one that repeats itself, for which a number stands in, it is more.
        """
        found = self.posterior(deviation, centre)
        own = found.covariance[np.ix_(numbers, numbers)]
        along = found.covariance[:, numbers] @ np.linalg.inv(own)
        segments = np.unique([chunk for chunk, _, _ in self.blocks.places], return_inverse=True)[1]
        sums = np.array([gram for gram, _ in self.of_each(segments)])
        slopes = (sums[:, 1:, 0] - sums[:, 1:, 1:] @ found.mean) @ along
        return max(1.0, float(np.trace(own @ slopes.T @ slopes)) / len(numbers))

    def by_level(self, weights: np.ndarray) -> np.ndarray:
        """Log likelihood of each block at each level, (levels, blocks), for weights of the columns (columns,)."""
        left = np.concatenate([[1.0], -weights])
        return np.asarray(-0.5 * ((self.gram @ left) @ left + self.blocks.constant))


def posterior_of(gram: np.ndarray, constant: float, deviation: np.ndarray, centre: np.ndarray) -> Posterior:
    """The posterior from summed inner products (1 + columns, 1 + columns), errors first."""
    errors = gram[0, 0] - 2 * centre @ gram[1:, 0] + centre @ gram[1:, 1:] @ centre
    inner = gram[1:, 1:] * deviation[:, None] * deviation
    cross = deviation * (gram[1:, 0] - gram[1:, 1:] @ centre)
    root = np.linalg.cholesky(np.eye(len(cross)) + inner)
    half = np.linalg.solve(root, cross)
    evidence = -0.5 * (errors - half @ half + constant) - np.log(np.diag(root)).sum()
    back = np.linalg.inv(root)
    covariance = (back.T @ back) * deviation[:, None] * deviation
    return Posterior(float(evidence), centre + deviation * (back.T @ half), covariance)


def predictive(gram: np.ndarray, constant: float, deviation: np.ndarray, told: Posterior) -> float:
    """Log probability of errors, by their inner products, where the last numbers are as ``told`` by others, nats.

    The first columns are nuisances with prior ``deviation``, of which no other errors tell anything: what is off a
    little everywhere may not be off by more here because it is elsewhere.
    """
    first = len(deviation)
    scale = np.eye(len(gram))
    scale[range(1, 1 + first), range(1, 1 + first)] = deviation
    scale[1 + first :, 1 + first :] = np.linalg.cholesky(told.covariance)
    scale[1 + first :, 0] = -told.mean
    scaled = scale.T @ gram @ scale
    return posterior_of(scaled, constant, np.ones(len(gram) - 1), np.zeros(len(gram) - 1)).evidence
