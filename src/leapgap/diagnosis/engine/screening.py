"""Which further effects the errors of a set ask for, in closed form, by their columns and by stretched tolerances."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.diagnosis.engine.evidence import Blocks, Whitened
from leapgap.diagnosis.engine.points import Point, prior_of
from leapgap.diagnosis.hypotheses import Hypothesis

STRETCHED = 3.0  # Standard deviations from nominal at which a tolerance may be a cause


@dataclass(frozen=True)
class Projection:
    """What further columns have to do with the errors of a point beyond its nuisances and its own numbers."""

    blocks: Blocks
    levels: np.ndarray  # Index of the level of each block, (blocks,)
    errors: np.ndarray  # (rows,), each block at its level
    known: np.ndarray  # Columns of nuisances and numbers, times their prior deviations, (rows, known)

    @staticmethod
    def of(point: Point, deviation: np.ndarray, centre: np.ndarray) -> "Projection":
        """By priors of what is known, as in ``Point.priors``."""
        blocks, levels = point.basis.blocks, point.evidence.levels
        stacked = blocks.at_levels(point.whitened, levels)
        return Projection(blocks, levels, stacked[:, 0] - stacked[:, 1:] @ centre, stacked[:, 1:] * deviation)

    @cached_property
    def root(self) -> np.ndarray:
        """Cholesky factor of what is known, (known, known)."""
        return np.linalg.cholesky(np.eye(self.known.shape[1]) + self.known.T @ self.known)

    @cached_property
    def explained(self) -> np.ndarray:
        """Inner products of what is known with the errors, by ``root``, (known,)."""
        return np.linalg.solve(self.root, self.known.T @ self.errors)

    def of_columns(self, whitened: Whitened) -> tuple[np.ndarray, np.ndarray]:
        """Inner products with the errors (columns,), and among each other (columns, columns), of what is left."""
        columns = self.blocks.at_levels(whitened, self.levels)
        cross = np.linalg.solve(self.root, self.known.T @ columns)
        return columns.T @ self.errors - cross.T @ self.explained, columns.T @ columns - cross.T @ cross


def screen(point: Point, without: Sequence[int] = (), again: bool = False) -> list[tuple[float, Hypothesis]]:
    """Evidence that each further hypothesis alone would gain at the levels as they are, nats, the best first.

    In closed form: columns and errors less what the nuisances and the point's own numbers can do for them. Members
    ``without`` are taken back to nominal, and others of their effect may take their place; ``again``: also beside them.
    """
    by_errors, by_each = Projection.of(point, *point.priors((), without)).of_columns(point.basis.whitened)
    present = set() if again else {h.name for m, (h, _) in enumerate(point.acting) if m not in without}
    same = {h.label for h, _ in point.acting}
    found = []
    for h in point.basis.hypotheses:
        if h.name in present or h.label in same:
            continue
        size = prior_of(h)
        part = np.zeros((len(by_errors), len(size)))
        for k, own in enumerate(size):
            part[point.basis.columns.at(h, k), k] = own
        normal, slope = np.eye(len(size)) + part.T @ by_each @ part, part.T @ by_errors
        allowed = (h.clip(h.nominal + np.linalg.solve(normal, slope) * size) - h.nominal) / size
        gain = slope @ allowed - 0.5 * allowed @ normal @ allowed - 0.5 * np.linalg.slogdet(normal)[1]
        found.append((float(gain), h))
    return sorted(found, key=lambda pair: -pair[0])


def stretched(point: Point) -> list[Hypothesis]:
    """Hypotheses whose numbers are off by more than their tolerances allow, the furthest first.

    As a tolerance such a number explains what is linear in it at the price of its prior alone, so that little is left
    for it to gain as a cause. One number at several places counts by what these have in common.
    """
    mean = point.evidence.posterior(*point.priors()).mean[: point.nuisances]
    departs = dict(zip(point.basis.nuisances.tolist(), mean / point.basis.deviation, strict=True))
    found, present = [], {h.name for h, _ in point.acting}
    for h in point.basis.hypotheses:
        at = [point.basis.columns.at(h, k) for k in range(len(h.parameters))]
        far = max(abs(sum(departs.get(i, 0.0) for i in own)) / np.sqrt(len(own)) for own in at)
        if far > STRETCHED and h.name not in present:
            found.append((far, h))
    return [h for _, h in sorted(found, key=lambda pair: -pair[0])]


def few_of_each(hypotheses: Sequence[Hypothesis], most: int) -> list[Hypothesis]:
    """The hypotheses in their order, at most so many of one effect."""
    seen: dict[str, int] = {}
    found = []
    for h in dict.fromkeys(hypotheses):
        seen[h.name] = seen.get(h.name, 0) + 1
        if seen[h.name] <= most:
            found.append(h)
    return found
