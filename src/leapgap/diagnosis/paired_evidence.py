"""The engine's evidence of two sets of logs: columns that both share, and columns of the later set alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.engine.evidence import Evidence, Posterior, posterior_of
from leapgap.diagnosis.engine.points import Acting, Bench, Point, prior_of
from leapgap.diagnosis.hypotheses import Hypothesis


@dataclass(frozen=True)
class Paired:
    """A point with the evidence of both sets: shared columns, and columns of the later set alone."""

    bench: Bench
    point: Point
    after: np.ndarray
    """Which blocks are of the later set, bool, (blocks,)."""
    folds: np.ndarray
    """Fold of each block, (blocks,)."""

    @property
    def shared(self) -> int:
        """Number of columns of the basis, all of which both sets share."""
        return len(self.point.basis.nuisances)

    def moved(self, acting: Acting) -> "Paired":
        """The same with other differences that act."""
        return replace(self, point=self.bench.moved(self.point, acting))

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
        point, n = self.point, self.shared
        own = point.sums((), without)
        acting = own.transform[:, own.nuisances :]
        size = len(own.transform)
        blocks = [np.eye(size + n)[:, :n], np.concatenate([np.zeros((size, own.nuisances)), point.basis.nuisances])]
        blocks.append(np.concatenate([acting, np.zeros((n, acting.shape[1]))]))
        deviation = [self.wide, point.basis.deviation, own.deviation[own.nuisances :]]
        centre = [np.zeros(n), np.zeros(own.nuisances), own.centre[own.nuisances :]]
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
        found = np.ones(self.shared)
        for i, key in enumerate(self.point.basis.columns.keys):
            found[i] = prior_of(replace(self.bench.kinds[key.effect], location=key.place))[key.number]
        return found

    def posterior(self, sums: tuple[np.ndarray, ...], blocks: np.ndarray | None = None) -> Posterior:
        """Evidence and numbers by some of the blocks; all, if None."""
        evidence = self.point.evidence
        chosen = np.ones(len(self.after), bool) if blocks is None else blocks
        total, later = evidence.total(chosen), evidence.total(chosen & self.after)[0]
        return posterior_of(self.extended(total, later), total[1], *sums)

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
