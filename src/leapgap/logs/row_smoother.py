"""Lengths of the rows of a noisy log, by all of its joints at once: a Kalman smoother whose unknown is time.

A joint's true position goes on from row to row by its velocity times the length of the row, which all joints share.
Each sample shows the true position with noise. Between two samples that both err, what one row seems to gain its
neighbour loses; the smoother knows that, so that noise does not add up over the log. Lengths are drawn from a
distribution around their mean whose width is found from the log: narrow for an even loop, with far tails for stalls.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from leapgap.logs.streams import CURVATURE

BLOCK, OVERLAP = 400, 25
"""Rows that are smoothed together, and those at each end of them that are smoothed twice."""
TOGETHER = 64
"""Blocks that are smoothed side by side, which bounds the memory."""
ROUNDS = 8
"""Passes over the log, each with the width of lengths that the one before gives."""
FREEDOM = 3.0
"""Degrees of freedom of Student's distribution of lengths: stalls are rare and far away."""
BEST_KNOWN = 0.75
"""The mean length of a row is taken from rows that are better known than this share of them."""
NARROWEST = 0.01
"""Least width of lengths, as a share of their mean."""
FIRST_WIDTH = 0.3
"""Width with which the first pass begins."""
DELAY_ROWS, LONGEST_DELAY = 20, 3.0
"""Rows over which changes of velocity are held against motion, and the longest delay of velocities, in mean rows."""
START = 0.05
"""Standard deviation of a position before its first sample, rad or m."""
LEAST_NOISE = 1e-6
"""Least standard deviation of the noise of a position, rad or m."""
UNKNOWN = 1e3
"""Standard deviation of a sample that a row does not have, rad or m."""


@dataclass(frozen=True)
class Samples:
    """What rows show of some channels."""

    position: np.ndarray
    """(rows, channels), rad or m."""
    velocity: np.ndarray
    """(rows, channels), per s."""
    fresh: np.ndarray
    """Whether a row shows a new sample, bool, (rows, channels)."""
    noise: np.ndarray
    """Standard deviation of the noise of positions, (channels,)."""
    velocity_noise: np.ndarray
    """Standard deviation of the noise of velocities, (channels,)."""

    def with_delay(self, delay_s: float) -> "Samples":
        """The same motion with velocities of the instants of its positions, which were so much older."""
        return replace(self, position=self.position - delay_s * self.velocity)


@dataclass(frozen=True)
class SmoothedLengths:
    """Lengths of rows with what is not known of them."""

    mean: np.ndarray
    """s, (rows − 1,)."""
    spread: np.ndarray
    """Standard deviation, s, (rows − 1,)."""


def smooth_lengths(samples: Samples, claimed: np.ndarray) -> SmoothedLengths:
    """Lengths of all rows but the last around the ``claimed`` ones, s, (rows − 1,), times one factor."""
    mean = float(claimed.mean())
    scale, width = 1.0, FIRST_WIDTH * mean
    weight, lasted, delay = np.ones(len(claimed)), claimed, velocity_delay(samples, claimed)
    for _ in range(ROUNDS):
        before = width / np.sqrt(weight)
        found = Blocks.of(samples.with_delay(delay), lasted).smooth(scale * claimed, before)
        off = found.mean - scale * claimed
        square = off**2 + found.spread**2
        weight = (FREEDOM + 1) / (FREEDOM + square / width**2)
        delay = velocity_delay(samples, found.mean)
        lasted, usual = np.maximum(found.mean, claimed), scale * claimed
        scale += float((weight * off * claimed).sum() / (weight * claimed**2).sum())
        width = max(float(np.sqrt((weight * square).mean())), NARROWEST * mean)
    # Stalls have no counterpart: where samples would not show one, a row lasts as long as the mean, not the usual one.
    told = (1 / np.maximum(found.spread, 1e-12) ** 2 - 1 / before**2) * float(square.mean())
    known = told / (1 + told)
    longer = float(off[known >= np.quantile(known, BEST_KNOWN)].mean())
    return SmoothedLengths(np.maximum(usual + off + (1 - known) * longer, 0.0), found.spread)


def velocity_delay(samples: Samples, lengths: np.ndarray) -> float:
    """How much older the velocities of all channels are than their positions, s; below zero where they are younger.

    Simulations advance positions by the velocities after a step, or before it. What the sums of velocities over rows of
    these lengths, s, (rows − 1,), leave of the motion is then a share of the change of velocity.
    """
    velocity = at_every_row(samples.velocity, samples.fresh)
    speed = (velocity[1:] + velocity[:-1]) / 2
    left = samples.position[1:] - np.cumsum(speed * lengths[:, None], axis=0)
    span = max(1, min(DELAY_ROWS, len(left) // 4))
    new = samples.fresh[1:]
    weight = (new[span:] & new[:-span]) / np.maximum(samples.noise, LEAST_NOISE) ** 2
    left, change = left[span:] - left[:-span], velocity[1 + span :] - velocity[1:-span]
    square = float((weight * change**2).sum())
    most = LONGEST_DELAY * float(lengths.mean())
    return float(np.clip((weight * change * left).sum() / square, -most, most)) if square > 0 else 0.0


@dataclass(frozen=True)
class Blocks:
    """Stretches of one log side by side, each with rows of its neighbours at both ends."""

    rows: np.ndarray
    """Row of the log, (blocks, rows of a block)."""
    own: np.ndarray
    """Whether the length of a row is taken from this block, bool, (blocks, rows of a block − 1)."""
    observed: np.ndarray
    """Positions, (blocks, rows of a block, channels)."""
    variance: np.ndarray
    """Of the positions, likewise."""
    speed: np.ndarray
    """Mean of the velocities at both ends of a row, (blocks, rows of a block − 1, channels)."""
    wander: np.ndarray
    """Variance of the motion within a row beside that speed, likewise."""

    @staticmethod
    def of(samples: Samples, lengths: np.ndarray) -> "Blocks":
        """Cut a log into blocks of equal numbers of rows; what a row adds to errors grows with its length, s."""
        count = len(samples.position)
        whole = min(count, BLOCK)
        inner = max(1, whole - 2 * OVERLAP)
        starts = np.unique(np.minimum(np.arange(0, max(1, count - 2 * OVERLAP), inner), count - whole))
        rows = starts[:, None] + np.arange(whole)
        own = np.zeros((len(starts), whole - 1), dtype=bool)
        taken = 0
        for block, start in enumerate(starts):
            end = count - 1 if block == len(starts) - 1 else int(start) + whole - OVERLAP
            own[block, taken - start : end - start] = True
            taken = end
        velocity = at_every_row(samples.velocity, samples.fresh)
        bend, speed = np.abs(np.diff(velocity, axis=0)), (velocity[1:] + velocity[:-1]) / 2
        wander = (CURVATURE * bend * lengths[:, None]) ** 2 + (samples.velocity_noise * lengths[:, None]) ** 2
        variance = np.where(samples.fresh, np.maximum(samples.noise, LEAST_NOISE), UNKNOWN) ** 2
        inside = rows[:, :-1]
        return Blocks(rows, own, samples.position[rows], variance[rows], speed[inside], wander[inside])

    def smooth(self, expected: np.ndarray, width: np.ndarray) -> SmoothedLengths:
        """Lengths of rows, each with its expectation and standard deviation beforehand, s, (rows − 1,) both."""
        every = np.empty((2, len(expected)))
        for first in range(0, len(self.rows), TOGETHER):
            some = Blocks(*(getattr(self, field.name)[first : first + TOGETHER] for field in fields(self)))
            inside = some.rows[:, :-1]
            around, before = expected[inside], width[inside] ** 2
            pull, sure = some.look_back(*some.filter(around, before))
            mean, spread = around + before * pull, np.sqrt(np.maximum(before - before**2 * sure, 0.0))
            every[:, inside[some.own]] = mean[some.own], spread[some.own]
        return SmoothedLengths(every[0], every[1])

    def filter(self, around: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Forward pass: weighted innovations, their inverse covariances, and what each update leaves of an error."""
        blocks, rows, channels = self.observed.shape
        unit = np.eye(channels)
        state = self.observed[:, 0].copy()
        covariance = np.broadcast_to(START**2 * unit, (blocks, channels, channels)).copy()
        weighted = np.empty((rows, blocks, channels))
        inverse = np.empty((rows, blocks, channels, channels))
        left = np.empty_like(inverse)
        for row in range(rows):
            inverse[row] = np.linalg.inv(covariance + self.variance[:, row, :, None] * unit)
            weighted[row] = np.einsum("bij,bj->bi", inverse[row], self.observed[:, row] - state)
            left[row] = unit - covariance @ inverse[row]
            if row == rows - 1:
                break
            state = state + np.einsum("bij,bj->bi", covariance, weighted[row])
            covariance = left[row] @ covariance
            covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
            speed = self.speed[:, row]
            state = state + speed * around[:, row, None]
            covariance = covariance + before[:, row, None, None] * speed[:, :, None] * speed[:, None, :]
            covariance = covariance + self.wander[:, row, :, None] * unit
        return weighted, inverse, left

    def look_back(self, weighted: np.ndarray, inverse: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Backward pass: how far later samples pull the length of each row, and how surely, (blocks, rows − 1) each."""
        rows = len(weighted)
        pull, sure = np.empty(self.own.shape), np.empty(self.own.shape)
        adjoint, square = weighted[-1], inverse[-1]
        for row in range(rows - 2, -1, -1):
            speed = self.speed[:, row]
            pull[:, row] = (speed * adjoint).sum(axis=1)
            sure[:, row] = np.einsum("bi,bij,bj->b", speed, square, speed, optimize=False)
            keep = np.swapaxes(left[row], 1, 2)
            adjoint = weighted[row] + np.einsum("bij,bj->bi", keep, adjoint)
            square = inverse[row] + keep @ square @ left[row]
        return pull, sure


def at_every_row(values: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Values (rows, channels) on straight lines between the rows that show new ones."""
    rows = np.arange(len(values))
    columns = [np.interp(rows, rows[new], column[new]) for column, new in zip(values.T, fresh.T, strict=True)]
    return np.stack(columns, axis=1)
