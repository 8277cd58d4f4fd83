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
    after: np.ndarray
    """Which blocks are of the later set, bool, (blocks,)."""
    folds: np.ndarray
    """Fold of each block, (blocks,)."""

    @property
    def shared(self) -> int:
        """Number of columns of the basis, all of which both sets share."""
        return int(self.point.basis.whitened[0].shape[3])

    def moved(self, acting: Acting) -> "Paired":
        """The same with other differences that act."""
        return replace(self, point=self.bench.moved(self.point.intervals, self.point.basis, acting)).with_all()

    def with_all(self) -> "Paired":
        """The same with the evidence of all columns of the basis, in place of those of the nuisances alone."""
        point, basis = self.point, self.point.basis
        parts = zip(point.own, basis.whitened, strict=True)
        columns = [np.concatenate([own[..., :1], of, own[..., 1:]], axis=3) for own, of in parts]
        evidence = Evidence.of(basis.blocks, columns, basis.all_products)
        evidence = replace(evidence, levels=point.evidence.levels)
        return replace(self, point=replace(point, evidence=evidence))

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
        (own, at), first = point.priors((), without), point.nuisances
        size, number = n + len(own) - first, len(own) - first
        acting = np.zeros((size + n, number))
        acting[n:size] = np.eye(number)
        narrow = np.zeros((size + n, first))
        narrow[size + point.basis.nuisances, range(first)] = 1
        blocks = [np.eye(size + n)[:, :n], narrow, acting]
        deviation = [self.wide, point.basis.deviation, own[first:]]
        centre = [np.zeros(n + first), at[first:]]
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
        return posterior_by(self.extended(total, later), total[1], *sums)

    def with_levels(self, sums: tuple[np.ndarray, ...], rounds: int = 3) -> "Paired":
        """The same at the level of the force without a name that suits each block best."""
        found = self
        for _ in range(rounds):
            evidence, levels = found.point.evidence, np.argmax(found.by_level(sums), axis=0)
            if (levels == evidence.levels).all():
                break
            found = replace(found, point=replace(found.point, evidence=replace(evidence, levels=levels)))
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
        return posterior_by(whole, constant, wider, *priors).mean[-logs:]


def posterior_by(
    gram: np.ndarray, constant: float, transform: np.ndarray, deviation: np.ndarray, centre: np.ndarray
) -> Posterior:
    """The posterior of sums of columns: ``transform`` (columns, used), prior deviations and means (used,)."""
    summed = np.zeros((len(gram), 1 + transform.shape[1]))
    summed[0, 0], summed[1:, 1:] = 1, transform
    return posterior_of(summed.T @ gram @ summed, constant, deviation, centre)
