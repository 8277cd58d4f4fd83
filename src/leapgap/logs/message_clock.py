"""The clock of a log that shows the latest message of each kind: one system of equations for all rows and samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from leapgap.logs.log import Log
from leapgap.logs.row_clock import BASE, CURVATURE, NOISE_WINDOW, OUTLIER, VELOCITY, RowClock, Stream, mean_row

FREE = 25.0  # standard deviation of a row's length that is assumed beforehand, in sample periods: next to no assumption
LAG, LAG_SPREAD = 0.3, 0.4  # how late a sample is in the row that first shows it: mean and deviation, in sample periods
ROUNDS = 3  # solutions, each with the weights and the delay of velocities that the one before gives
ORIGIN = 1e5  # weight, 1/s, with which the first row is put at instant 0
PRECISE = 0.15  # instants known to this share of a step of a whole-number clock are precise


WHOLE, REAL = ("plus", "minus", "stream"), ("by", "right", "spread", "bend")
EQUATION = np.dtype([*((key, np.int64) for key in WHOLE), *((key, np.float64) for key in REAL)])
"""An equation ``by · (plus − minus) = right ± spread`` between two unknowns. Where it tells the motion of a message,
``stream`` is that message, −1 elsewhere, and ``bend`` the change of velocity, by which a delay acts on the right."""


def equations(plus: np.ndarray, minus: np.ndarray, **others: np.ndarray | float) -> np.ndarray:
    """So many equations, as ``EQUATION``."""
    found = np.zeros(len(plus), EQUATION)
    for key, values in {"by": 1.0, "stream": -1, **others, "plus": plus, "minus": minus}.items():
        found[key] = values
    return found


@dataclass(frozen=True)
class System:
    """What is known of the instants of rows and samples; unknown are those of the rows, then those of each message."""

    equations: np.ndarray  # as ``EQUATION``, (equations,)
    first: np.ndarray  # index of each message's first sample among the unknowns, behind the rows; and their number
    sharpness: tuple[np.ndarray, ...]  # of each message's times between samples, by motion alone, standard deviation, s


def clock_of_messages(log: Log, streams: Sequence[Stream]) -> RowClock:
    """The clock of a log that shows the latest message of each kind, whether it is new or not.

    Unknown are the instants of all rows and of all samples. Motion between the samples of a message says how much time
    passed; a row is written a little after the samples that it shows first.
    """
    period = mean_row(log, streams)
    system = system_of(streams, period)
    rows, samples = solve(system, streams, period)
    step = whole_step(samples, system.sharpness, period)
    if step is not None:
        # The equations with one more for each time between samples that is precisely so many steps
        more = []
        for first, own, sharp in zip(system.first, samples, system.sharpness, strict=False):
            number = np.round(np.diff(own) / step)
            near = (np.abs(np.diff(own) / step - number) < PRECISE) & (sharp < PRECISE * step) & (number >= 1)
            after = first + 1 + np.flatnonzero(near)
            more.append(equations(after, after - 1, right=step * number[near], spread=step / 100))
        rows, samples = solve(replace(system, equations=np.concatenate([system.equations, *more])), streams, period)
    shown = {stream.name: samples[k][np.cumsum(stream.fresh) - 1] for k, stream in enumerate(streams)}
    # When each row was written, s, never decreasing, (rows,): at the latest sample that it shows
    resolution = step or period
    columns = []
    for stream, sharp in zip(streams, system.sharpness, strict=True):
        precise = np.concatenate([[False], sharp < PRECISE * resolution])[np.cumsum(stream.fresh) - 1]
        columns.append(np.where(precise, shown[stream.name], -np.inf))
    latest = np.sort(np.stack(columns, axis=1), axis=1)[:, -min(2, len(columns))]
    instants = np.maximum.accumulate(np.where(np.isfinite(latest), latest, rows - LAG * resolution))
    if step is not None:
        instants = step * np.round((instants - instants[0]) / step)
    return RowClock(
        instants - instants[0],
        {name: shown[stream.name] - instants[0] for stream in streams for name in stream.columns},
        step,
        {stream.name: stream.repeats(log.info.sample_period_s) for stream in streams},
        {} if step is None else velocity_filters(streams, samples, step),
    )


def system_of(streams: Sequence[Stream], period: float) -> System:
    """All equations of a log of so many rows; ``period`` is the mean length of a row, s."""
    rows = len(streams[0].fresh)
    first = rows + np.concatenate([[0], np.cumsum([int(stream.fresh.sum()) for stream in streams])])
    parts, sharpness = [], []
    for k, stream in enumerate(streams):
        # What the motion of each channel says of the times between samples, and how precisely the best one does, s
        at = np.flatnonzero(stream.fresh)
        after, between = int(first[k]) + np.arange(1, len(at)), np.diff(at)
        found, sharp = [], np.full(len(between), np.inf)
        for q, v, noise in zip(stream.position[at].T, stream.velocity[at].T, stream.noise, strict=True):
            mean, bend = (v[1:] + v[:-1]) / 2, np.diff(v)
            curved = CURVATURE * period * np.abs(bend) * np.hypot(1.0, between / 5)
            spread = np.hypot(np.sqrt(2) * noise, curved)
            found.append(equations(after, after - 1, by=mean, right=np.diff(q), spread=spread, bend=bend, stream=k))
            sharp = np.minimum(sharp, spread / np.maximum(np.abs(mean), 1e-9))
        shown, late = first[k] + np.cumsum(stream.fresh) - 1, np.where(stream.fresh, LAG_SPREAD, 3 * LAG_SPREAD)
        parts += [
            *found,
            equations(after, after - 1, right=period * between, spread=FREE * period),
            equations(np.arange(rows), shown, right=LAG * period, spread=late * period),
        ]
        sharpness.append(sharp)
    origin = equations(np.zeros(1), first[-1:], spread=1 / ORIGIN)
    return System(np.concatenate([*parts, origin]), first, tuple(sharpness))


def solve(system: System, streams: Sequence[Stream], period: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """When each row was written, (rows,), and when the samples of each message were taken, s, by robust least squares.

    A velocity may be that of a moment before its position; this delay of each message is found on the way.
    """
    known, rows = system.equations, int(system.first[0])
    # Left sides, (equations, unknowns); the number after the last unknown stands for 0
    number, unknowns = np.arange(len(known)), np.concatenate([known["plus"], known["minus"]])
    values = np.concatenate([known["by"], -known["by"]])
    whole = sp.csr_matrix((values, (np.tile(number, 2), unknowns)), shape=(len(number), int(system.first[-1]) + 1))
    matrix = whole[:, :-1]
    of, bend, before = np.maximum(known["stream"], 0), known["bend"], 1 / known["spread"]  # no bend, no delay
    delay, weight, found = np.full(len(streams), period / 2), before, np.zeros(0)
    row_of_unknown = [np.arange(rows) + 0.5, *(np.flatnonzero(stream.fresh) for stream in streams)]
    order = np.argsort(np.concatenate(row_of_unknown), kind="stable")
    for _ in range(ROUNDS):
        moved = known["right"] - delay[of] * bend
        weighted = sp.diags(weight) @ matrix
        # Solve a symmetric positive definite system whose unknowns, in this order, depend on near ones alone
        square_matrix, right = weighted.T @ weighted, weighted.T @ (weight * moved)
        how: dict[str, Any] = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        found = np.empty(len(right))
        found[order] = splu(square_matrix[order][:, order].tocsc(), **how).solve(right[order])
        missed = matrix @ found - moved
        weight = before / np.sqrt(1 + (missed * before / OUTLIER) ** 2)
        pull, square = (np.bincount(of, weight**2 * bend * by, len(streams)) for by in (missed, bend))
        delay = delay - pull / np.where(square > 0, square, 1.0)
    return found[:rows], np.split(found, system.first[:-1])[1:]


STEPS_S = (0.02, 0.01, 0.005, 0.004, 0.0025, 0.002, 0.001, 0.0005, 0.00025)
"""Steps of simulations and control loops that are looked for, s, longest first."""


LEAST_OBEYED = 0.8  # share of the pairs of samples from which a rule counts as that which made them
DIGITS = 0.02  # a pair obeys where it asks for a share kept that differs by less
LEAST_PAIRS = 20  # fewer pairs of samples tell no rule


def velocity_filters(streams: Sequence[Stream], taken: Sequence[np.ndarray], step: float) -> dict[str, float]:
    """Velocity columns of joints that were computed from positions → the share that they keep of the one before."""
    joints = [(stream, samples) for stream, samples in zip(streams, taken, strict=True) if stream.name != BASE]
    kept = obeyed_filters(
        {
            stream.name: filter_of(stream.position[stream.fresh], stream.velocity[stream.fresh], samples, step)
            for stream, samples in joints
        }
    )
    columns = [(column, stream.name) for stream, _ in joints if stream.name in kept for column in stream.columns]
    return {column: kept[name] for column, name in columns if column.startswith(VELOCITY)}


def filter_of(
    position: np.ndarray, velocity: np.ndarray, instants: np.ndarray, step: float
) -> tuple[float, float] | None:
    """The rule by which velocities (samples, channels) were computed from positions; None where there are few pairs.

    They are a share, which is kept, of the one before, and the rest of the last difference of positions over a step.
    That share, and the share of the pairs of samples that obey it to their last digits. ``instants`` (samples,), s.
    Pairs of samples one step apart are looked at, the half of them in which the velocity changes most.
    """
    next_step = np.round(np.diff(instants) / step) == 1
    moved = np.diff(position, axis=0)[next_step] / step
    before, after = velocity[:-1][next_step], velocity[1:][next_step]
    change = np.abs(moved - before)
    tells = change > np.median(change, axis=0) if len(change) else change > 0
    if tells.sum() < LEAST_PAIRS:
        return None
    kept = (moved - after)[tells] / (moved - before)[tells]
    usual = float(np.median(kept))
    return usual, float((np.abs(kept - usual) < DIGITS).mean())


def obeyed_filters(filters: Mapping[str, tuple[float, float] | None]) -> dict[str, float]:
    """Shares that messages keep by the rules, as ``filter_of``, that surely made their velocities.

    None where no message obeys its own. A message with more noise counts where its pairs ask, in the median, for what
    the others obey.
    """
    told = {name: one for name, one in filters.items() if one is not None and -DIGITS < one[0] < 1 - DIGITS}
    sure = [kept for kept, share in told.values() if share > LEAST_OBEYED]
    return {name: max(own, 0.0) for name, (own, _) in told.items() if any(abs(own - kept) < DIGITS for kept in sure)}


LEAST_WHOLE = 0.85  # share of the precise times between samples that are one or more whole steps, from which all are


def whole_step(samples: Sequence[np.ndarray], sharpness: Sequence[np.ndarray], period: float) -> float | None:
    """The longest step of which the times between samples are whole multiples; None where there is none.

    ``period`` is the mean length of a row, s; steps much shorter than it would fit anything.
    """
    for step in (step for step in STEPS_S if step > period / 5):
        sharp = [np.diff(own)[spread < PRECISE * step] for own, spread in zip(samples, sharpness, strict=True)]
        steps = np.concatenate(sharp) / step
        whole = (np.abs(steps - np.round(steps)) < PRECISE) & (steps > 0.5)
        if len(steps) >= NOISE_WINDOW and whole.mean() > LEAST_WHOLE:
            return step
    return None
