"""The engine's evidence of two sets of logs: columns that both share, and columns of the later set alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.engine.evidence import Evidence, Posterior, posterior_of
from leapgap.diagnosis.engine.points import ABSENT, Acting, Bench, Point, prior_of
from leapgap.diagnosis.hypotheses import Hypothesis

SHARE = 3.0
"""Prior standard deviation of the share of a change that acts in a log."""


@dataclass(frozen=True)
class Paired:
    """A point with the evidence of both sets: shared columns, and columns of the later set alone."""

    bench: Bench
    point: Point
    """Its evidence is of errors, all columns of the basis, and numbers of the acting differences."""
    after: np.ndarray
    """Which blocks are of the later set, bool, (blocks,)."""
    folds: np.ndarray
    """Fold of each block, (blocks,)."""
    products: np.ndarray
    """Inner products of the columns of the basis, (levels, blocks, columns, columns)."""

    @staticmethod
    def of(bench: Bench, point: Point, after: np.ndarray, folds: np.ndarray) -> "Paired":
        """Evidence of two sets of logs from a point of all of them."""
        basis = point.basis
        products = basis.blocks.products(basis.whitened, basis.whitened)
        return Paired(bench, with_all_columns(point, products), after, folds, products)

    @property
    def shared(self) -> int:
        """Number of columns of the basis, all of which both sets share."""
        return self.products.shape[2]

    def moved(self, acting: Acting) -> "Paired":
        """The same with other differences that act."""
        point = self.bench.moved(self.point.intervals, self.point.basis, acting)
        return replace(self, point=with_all_columns(point, self.products))

    def extended(self, total: tuple[np.ndarray, float], later: np.ndarray) -> np.ndarray:
        """Inner products of errors, all columns, and the basis in the later set alone."""
        gram, n = total[0], self.shared
        size = len(gram)
        found = np.zeros((size + n, size + n))
        found[:size, :size] = gram
        found[:size, size:] = later[:, 1 : 1 + n]
        found[size:, :size] = later[1 : 1 + n]
        found[size:, size:] = later[1 : 1 + n, 1 : 1 + n]
        return found

    def sums(self, further: Sequence[Hypothesis] = (), without: Sequence[int] = ()) -> tuple[np.ndarray, ...]:
        """Transform, prior deviations and means: shared columns, narrow nuisances, acting and further differences."""
        point, n, narrow = self.point, self.shared, self.point.nuisances
        of_acting, centre_of_acting = (own[narrow:] for own in point.priors((), without))
        size = point.evidence.gram.shape[2] - 1
        unit = np.eye(size + n)
        blocks = [unit[:, :n], unit[:, size + point.basis.nuisances], unit[:, n:size]]
        deviation = [self.wide, point.basis.deviation, of_acting]
        centre = [np.zeros(n), np.zeros(narrow), centre_of_acting]
        for h in further:
            part = np.zeros((size + n, len(h.parameters)))
            for k in range(len(h.parameters)):
                part[[size + i for i in point.basis.columns.at(h, k)], k] = 1
            blocks.append(part)
            deviation.append(np.abs(h.moderate))
            centre.append(np.zeros(len(h.parameters)))
        return np.concatenate(blocks, axis=1), np.concatenate(deviation), np.concatenate(centre)

    @cached_property
    def wide(self) -> np.ndarray:
        """Prior deviations of the shared columns: of anything that the model may be wrong by, (columns,)."""
        found, basis = np.ones(self.shared), self.point.basis
        found[basis.nuisances] = basis.deviation  # of late logs and finer steps
        for i, key in enumerate(self.point.basis.columns.keys):
            found[i] = prior_of(replace(self.bench.kinds[key.effect], location=key.place))[key.number]
        return found

    def posterior(self, sums: tuple[np.ndarray, ...], blocks: np.ndarray | None = None) -> Posterior:
        """Evidence and numbers by some of the blocks; all, if None."""
        evidence = self.point.evidence
        chosen = np.ones(len(self.after), bool) if blocks is None else blocks
        total, later = evidence.total(chosen), evidence.total(chosen & self.after)[0]
        return transformed(self.extended(total, later), total[1], *sums)

    def with_levels(self, sums: tuple[np.ndarray, ...], rounds: int = 3) -> "Paired":
        """The same at the level of the force without a name that suits each block best."""
        evidence: Evidence = replace(self.point.evidence)
        found = replace(self, point=replace(self.point, evidence=evidence))
        for _ in range(rounds):
            before, evidence.levels = evidence.levels, np.argmax(found.by_level(sums), axis=0)
            if (before == evidence.levels).all():
                break
        return found

    def by_level(self, sums: tuple[np.ndarray, ...]) -> np.ndarray:
        """Log likelihood of each block at each level, (levels, blocks), at the numbers that all blocks tell."""
        evidence = self.point.evidence
        weights = sums[0] @ self.posterior(sums).mean
        size = evidence.gram.shape[2] - 1
        early, late = weights[:size], weights[:size].copy()
        late[: self.shared] += weights[size:]
        return np.where(self.after, evidence.by_level(late), evidence.by_level(early))

    def by_log(self, weights: np.ndarray, held: slice) -> np.ndarray:
        """How much of a sum of columns acts in each log, (logs,), while all that both sets share is free.

        ``weights`` of the basis' columns, (columns,); numbers ``held`` among the acting ones stay as they are.
        """
        evidence, n = self.point.evidence, self.shared
        transform, deviation, centre = (one.copy() for one in self.sums())
        first = n + len(self.point.basis.deviation)
        deviation[first:][held], centre[first:][held] = ABSENT, 0.0
        gram, constant = evidence.total()
        base = self.extended((gram, constant), evidence.total(self.after)[0])
        logs, size = int(evidence.blocks.log.max()) + 1, len(base)
        whole = np.zeros((size + logs, size + logs))
        whole[:size, :size] = base
        for log in range(logs):
            of = evidence.blocks.log == log
            own = evidence.total(of)[0]
            with_all = own[:, 1 : 1 + n] @ weights
            column = np.zeros(size)
            column[: len(gram)] = with_all
            if self.after[of].all():
                column[len(gram) :] = with_all[1 : 1 + n]
            whole[:size, size + log] = whole[size + log, :size] = column
            whole[size + log, size + log] = weights @ own[1 : 1 + n, 1 : 1 + n] @ weights
        wider = np.zeros((size - 1 + logs, transform.shape[1] + logs))
        wider[: size - 1, : transform.shape[1]] = transform
        wider[size - 1 :, transform.shape[1] :] = np.eye(logs)
        priors = np.concatenate([deviation, np.full(logs, SHARE)]), np.concatenate([centre, np.zeros(logs)])
        return transformed(whole, constant, wider, *priors).mean[-logs:]


def with_all_columns(point: Point, products: np.ndarray) -> Point:
    """A point whose evidence has all columns of its basis, with these inner products, in place of nuisances alone."""
    first = 1 + point.nuisances
    columns = [
        np.concatenate([own[..., :1], of_basis, own[..., first:]], axis=3)
        for own, of_basis in zip(point.whitened, point.basis.whitened, strict=True)
    ]
    evidence = Evidence.of(point.basis.blocks, columns, products)
    return replace(point, evidence=replace(evidence, levels=point.evidence.levels))


def transformed(
    gram: np.ndarray, constant: float, transform: np.ndarray, deviation: np.ndarray, centre: np.ndarray
) -> Posterior:
    """The posterior of sums of columns, ``transform`` (columns, sums)."""
    size = transform.shape[1]
    joined = np.zeros((len(gram), 1 + size))
    joined[0, 0], joined[1:, 1:] = 1, transform
    return posterior_of(joined.T @ gram @ joined, constant, deviation, centre)
