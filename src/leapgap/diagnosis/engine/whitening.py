"""The Kalman filter that makes errors, and the columns that may explain them, independent and of unit size.

The state is the departure from the reference and a force without a name at every degree of freedom, an
Ornstein–Uhlenbeck process of ``CORRELATION_S``. Its gains do not depend on what is filtered, so they are computed once
for each level of the force, and errors and columns pass through the same recursion.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from leapgap.diagnosis.channels import displaced, tangent_difference
from leapgap.diagnosis.engine.intervals import Intervals, Models, Pool, PreparedIntervals, roll
from leapgap.diagnosis.engine.responses import Displacements, Linearisation, force_units, joined, rough_steps
from leapgap.robot.motion import Motion

CORRELATION_S = 0.05  # Time over which the force without a name stays alike
LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # Standard deviations of the force without a name, in its units


BARELY = 5e-4
"""Depth of a foot in the ground, or distance from it, at which errors of sensors decide whether it touches, m."""
ALIKE_S = 0.021  # Two intervals of one length that last no longer than this together may share their derivatives
FOLLOWING = 0.3  # Level of the force at which references follow the logs


@dataclass(frozen=True)
class Chunks:
    """How the intervals of all logs are laid side by side: chunk, interval in it."""

    log: np.ndarray  # (chunks,)
    first: np.ndarray  # First interval in its log, (chunks,)
    length: np.ndarray  # Number of intervals, (chunks,)

    @staticmethod
    def of(intervals: Intervals) -> "Chunks":
        """The segments of all logs."""
        rows = []
        for log, own in enumerate(intervals.courses):
            first = np.cumsum([0, *own.segments])
            rows += [(log, int(at), length) for at, length in zip(first, own.segments, strict=False)]
        return Chunks(*(np.array(column) for column in zip(*rows, strict=True)))

    def by_log(self, of_chunks: np.ndarray) -> list[np.ndarray]:
        """What there is of each chunk, log by log."""
        return np.split(of_chunks, np.cumsum(np.bincount(self.log))[:-1])

    @property
    def longest(self) -> int:
        """Intervals of the longest chunk."""
        return int(self.length.max())

    def stack(self, of_logs: list[np.ndarray]) -> np.ndarray:
        """Arrays (intervals, …) of each log as (chunks, longest, …), zero behind the end of a chunk."""
        found = np.zeros((len(self.log), self.longest, *of_logs[0].shape[1:]))
        for c, (log, first, length) in enumerate(zip(self.log, self.first, self.length, strict=True)):
            found[c, :length] = of_logs[log][first : first + length]
        return found

    def places(self, k: int, order: np.ndarray) -> list[tuple[int, int]]:
        """Log and interval of the ``k``-th one of some chunks."""
        return list(zip(self.log[order].tolist(), (self.first[order] + k).tolist(), strict=True))

    @property
    def valid(self) -> np.ndarray:
        """Which intervals exist, (chunks, longest)."""
        return np.arange(self.longest)[None] < self.length[:, None]


@dataclass(frozen=True)
class Filter:
    """The gains of the filter at one level of the force."""

    transition: np.ndarray  # Of departure and force, (chunks, longest, N, N)
    gain: np.ndarray  # (chunks, longest, N, channels)
    inverse_root: np.ndarray
    """Inverse Cholesky factor of the innovations' covariance, (chunks, longest, channels, channels)."""
    log_determinant: np.ndarray  # Of that covariance, (chunks, longest)
    entries: np.ndarray

    @staticmethod
    def of(
        transitions: np.ndarray,
        forces: np.ndarray,
        missed: np.ndarray,
        noise: np.ndarray,
        start: np.ndarray,
        entries: np.ndarray,
        level: float,
        stay: np.ndarray,
    ) -> "Filter":
        """Gains for transitions (chunks, longest, n, n), force responses (…, n, nv), noise (…, channels).

        ``stay`` (chunks, longest) is the share of a force that is left at the end of each interval.
        ``start`` (chunks, n) is the standard deviation of the first departure; ``entries`` of the state are measured.
        """
        chunks, longest, n, nv = forces.shape
        size = n + nv
        full = np.zeros((chunks, longest, size, size))
        full[:, :, :n, :n], full[:, :, :n, n:] = transitions, forces
        full[:, :, range(n, size), range(n, size)] = stay[:, :, None]
        covariance = np.zeros((chunks, size, size))
        covariance[:, range(n), range(n)] = start**2
        covariance[:, range(n, size), range(n, size)] = level**2
        added = np.full((chunks, longest, size), 1e-14)
        added[:, :, n:] = level**2 * (1 - stay[:, :, None] ** 2)
        gains = np.zeros((chunks, longest, size, len(entries)))
        roots = np.zeros((chunks, longest, len(entries), len(entries)))
        determinants = np.zeros((chunks, longest))
        measured, eye = range(len(entries)), np.eye(len(entries))
        for k in range(longest):
            covariance = full[:, k] @ covariance @ full[:, k].transpose(0, 2, 1)
            covariance[:, range(size), range(size)] += added[:, k]
            covariance[:, :n, :n] += missed[:, k]
            innovation = covariance[:, entries[:, None], entries]
            innovation[:, measured, measured] += noise[:, k] ** 2
            root = np.linalg.cholesky(0.5 * (innovation + innovation.transpose(0, 2, 1)))
            inverse = np.linalg.solve(root, np.broadcast_to(eye, root.shape))
            gain = (covariance[:, :, entries] @ inverse.transpose(0, 2, 1)) @ inverse
            gains[:, k], roots[:, k] = gain, inverse
            determinants[:, k] = 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
            covariance = covariance - gain @ covariance[:, entries]
            covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
        return Filter(full, gains, roots, determinants, entries)

    def part(self, chosen: np.ndarray, longest: int) -> "Filter":
        """The filter of some chunks, bool (chunks,), of which the longest has so many intervals."""
        transition, gain, root, determinant = (
            own[chosen, :longest] for own in (self.transition, self.gain, self.inverse_root, self.log_determinant)
        )
        return Filter(transition, gain, root, determinant, self.entries)

    def whiten(self, steps: np.ndarray, measured: np.ndarray | None = None) -> np.ndarray:
        """Whitened innovations (chunks, longest, channels, columns).

        ``steps`` (chunks, longest, n, columns) is what a column adds to the departure in each interval; ``measured``
        (chunks, longest, channels, columns), for the errors, what is measured of the departure at its end.
        """
        chunks, longest, n, columns = steps.shape
        size = self.transition.shape[2]
        state = np.zeros((chunks, size, columns))
        found = np.zeros((chunks, longest, len(self.entries), columns))
        for k in range(longest):
            state = self.transition[:, k] @ state
            state[:, :n] += steps[:, k]
            innovation = -state[:, self.entries]
            if measured is not None:
                innovation += measured[:, k]
            found[:, k] = self.inverse_root[:, k] @ innovation
            state += self.gain[:, k] @ innovation
        return found


def start_deviation(intervals: Intervals, chunks: Chunks) -> np.ndarray:
    """Standard deviation of the first state of each chunk about its reference, (chunks, 2 nv)."""
    entries = intervals.channels.state_entries
    start = np.zeros((len(chunks.log), 2 * intervals.robot.model.nv))
    for c, (log, first) in enumerate(zip(chunks.log, chunks.first, strict=True)):
        own = intervals.courses[log]
        start[c] = own.states.deviation[own.rows[own.begins[first]]]
        start[c, entries] = own.noise[own.begins[first], : len(entries)]
    return np.maximum(start, 1e-6)


def noise_at_ends(intervals: Intervals, chunks: Chunks) -> np.ndarray:
    """Standard deviation of what is measured of the state at the end of each interval, (chunks, longest, channels)."""
    channels = len(intervals.channels.state_entries)
    noise = chunks.stack([own.noise[own.begins + 1, :channels] for own in intervals.courses])
    return np.where(chunks.valid[:, :, None], noise, 1.0)


def staying(intervals: Intervals, chunks: Chunks) -> np.ndarray:
    """Share of a force without a name that is left at the end of each interval, (chunks, longest)."""
    return np.asarray(np.exp(-chunks.stack([own.lengths_s for own in intervals.courses]) / CORRELATION_S))


def filters_of(intervals: Intervals, linearisation: Linearisation, chunks: Chunks) -> list[Filter]:
    """The filter at every level."""
    entries = intervals.channels.state_entries
    of = linearisation
    transitions, forces, missed = (chunks.stack(list(own)) for own in (of.transitions, of.forces, of.missed))
    start, noise, stay = (of(intervals, chunks) for of in (start_deviation, noise_at_ends, staying))
    return [Filter.of(transitions, forces, missed, noise, start, entries, level, stay) for level in LEVELS]


class Reaching:
    """Replays of single intervals of all logs from any states, by steps of one length."""

    def __init__(self, intervals: Intervals, chunks: Chunks, offsets: Sequence[np.ndarray], models: Models) -> None:
        """``offsets`` are what effects with a memory add at the end of each interval, (intervals, 2 nv) a log."""
        self.intervals, self.chunks, self.offsets, self.models = intervals, chunks, offsets, models

    @cached_property
    def prepared(self) -> list[PreparedIntervals]:
        """The intervals of each log, made when they are first asked for: not all robots need all lengths of steps."""
        own = self.intervals
        return [own.prepare(log, own.without_memory(log), self.models) for log in range(len(own.courses))]

    @cached_property
    def misreported(self) -> list[np.ndarray]:
        """Reported − true state at the instants of each log, (instants, 2 nv)."""
        own = self.intervals
        return [own.misreported(log, own.without_memory(log)) for log in range(len(own.courses))]

    @cached_property
    def pool(self) -> Pool:
        """Threads that replay together."""
        return Pool(self.prepared[0].models[0], self.intervals.replayer.threads)

    def touching(self, k: int, order: np.ndarray, states: Motion) -> list[tuple[frozenset[int], bool]]:
        """Feet that press on something in a state of each chunk, and whether one barely does, or barely does not."""
        found = []
        for (log, interval), qpos in zip(self.chunks.places(k, order), states.qpos, strict=True):
            prepared = self.prepared[log]
            found.append(touching(prepared.models[prepared.model_of[interval]], self.pool.data[0], qpos))
        return found

    def reach(self, k: int, order: np.ndarray, starts: np.ndarray, forces: np.ndarray) -> Motion:
        """Reported states at the end of the ``k``-th interval of some chunks, from several reported starts of each."""
        width, robot, at = len(starts) // len(order), self.intervals.robot, self.chunks.places(k, order)
        begins = [(log, self.intervals.courses[log].begins[interval]) for log, interval in at]
        before, after = (
            np.repeat([self.misreported[log][begin + later] for log, begin in begins], width, axis=0)
            for later in (0, 1)
        )
        if before.any():
            true = displaced(Motion.of_states(starts, robot.model.nq), -before, robot)
            starts = np.concatenate([true.qpos, true.qvel], axis=1)
        parts = [
            (self.prepared[log], np.repeat(np.array([i for g, i in at if g == log]), width))
            for log in dict.fromkeys(log for log, _ in at)
        ]
        reached = roll(parts, starts, forces, self.pool)[:, 0]
        added = after + np.repeat([self.offsets[log][interval] for log, interval in at], width, axis=0)
        return displaced(reached, added, robot) if added.any() else reached


def touching(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> tuple[frozenset[int], bool]:
    """Geoms that press into others in a pose, and whether any is less than ``BARELY`` away from touching."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    margin = model.geom_margin.copy()
    try:
        model.geom_margin[:] = BARELY
        mujoco.mj_collision(model, data)
    finally:
        model.geom_margin[:] = margin
    contact = data.contact
    deep, pairs = contact.dist < -BARELY, contact.geom
    return frozenset(pairs[deep].max(axis=1).tolist()), not deep.all()


def in_order(parts: Sequence[tuple[np.ndarray, Motion]]) -> Motion:
    """The motions of parts of some rows, each with the indices of its rows, in the order of the rows."""
    return joined([motion for _, motion in parts])[np.argsort(np.concatenate([rows for rows, _ in parts]))]


@dataclass
class Following:
    """References that follow the logs as a Kalman filter does: states that the robot could be in.

    Its feet are as deep in the ground as its weight presses them, which smoothed states do not give.
    """

    usual: Reaching
    short: Reaching  # The same intervals by short steps, for those in which a foot meets the ground or leaves it

    def __post_init__(self) -> None:
        """Lay the logs side by side, at the beginning of each chunk."""
        self.intervals, self.chunks = own, chunks = self.usual.intervals, self.usual.chunks
        self.nv = own.robot.model.nv
        self.references = [np.concatenate([c.reference.qpos, c.reference.qvel], axis=1) for c in own.courses]
        self.close = [c.close.copy() for c in own.courses]
        at = zip(chunks.log, chunks.first, strict=True)
        self.state = np.array([own.courses[log].start_states[first] for log, first in at])
        self.force = np.zeros((len(chunks.log), self.nv))
        self.forces: list[np.ndarray] = []
        # How states were moved at the end of each interval, and the force in it (units), (intervals, 3 nv) a log
        self.steps = [np.zeros((c.intervals, 3 * self.nv)) for c in own.courses]
        self.stay = staying(own, chunks)

    def chunks_at(self, k: int) -> np.ndarray:
        """Chunks that have a ``k``-th interval, log by log."""
        on = np.flatnonzero(k < self.chunks.length)
        return on[np.argsort(self.chunks.log[on], kind="stable")]

    def meet(self, k: int, order: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, Motion, np.ndarray]:
        """Chunks in whose ``k``-th interval a foot meets the ground or leaves it, bool, and what ``reach`` tells.

        And what short steps change there, (chunks, 2 nv): the log's own simulation, or the foot, has other ones.
        """
        reached, close = self.usual.reach(k, order, self.state[order], forces), np.zeros(len(order), bool)
        if self.intervals.robot.stands:
            before = Motion.of_states(self.state[order], self.intervals.robot.model.nq)
            pairs = zip(*(self.usual.touching(k, order, states) for states in (before, reached)), strict=True)
            close = np.array([a[0] != b[0] or a[1] or b[1] for a, b in pairs])
        for (log, interval), own in zip(self.chunks.places(k, order), close, strict=True):
            self.close[log][interval] = own
        usual, short = np.flatnonzero(~close), np.flatnonzero(close)
        parts, by_steps = [(usual, reached[usual])], np.zeros((len(order), 2 * self.nv))
        if len(short):
            parts.append((short, self.short.reach(k, order[short], self.state[order[short]], forces[short])))
            by_steps[short] = tangent_difference(parts[-1][1], reached[short], self.intervals.robot)
        return close, in_order(parts), by_steps

    def reach(self, k: int, order: np.ndarray, forces: np.ndarray) -> Motion:
        """Reported states at the end of the ``k``-th interval of some chunks, from where these are, by its steps."""
        close = np.array([self.close[log][interval] for log, interval in self.chunks.places(k, order)])
        parts = [(by, np.flatnonzero(own)) for by, own in ((self.usual, ~close), (self.short, close))]
        return in_order(
            [(own, by.reach(k, order[own], self.state[order[own]], forces[own])) for by, own in parts if len(own)]
        )

    def correct(self, k: int, order: np.ndarray, base: Motion, gain: np.ndarray) -> None:
        """Move states and forces by the gain (chunks, N, channels) times what the logs report, and keep the states."""
        own, n = self.intervals, 2 * self.nv
        places = self.chunks.places(k, order)
        at = [(log, int(own.courses[log].begins[interval]) + 1) for log, interval in places]
        seen = [own.courses[log].measured[np.array([instant])] for log, instant in at]
        measured = Motion(np.concatenate([one.qpos for one in seen]), np.concatenate([one.qvel for one in seen]))
        missed = tangent_difference(measured, base, own.robot)
        moved = (gain @ missed[:, own.channels.state_entries, None])[:, :, 0]
        steps = np.concatenate([moved[:, :n], self.force[order]], axis=1)
        self.force[order] = self.stay[order, k, None] * self.force[order] + moved[:, n:]
        self.forces.append(self.force[order])
        following = displaced(base, moved[:, :n], own.robot)
        self.state[order] = np.concatenate([following.qpos, following.qvel], axis=1)
        for (log, interval), (_, instant), state, step in zip(places, at, self.state[order], steps, strict=True):
            self.references[log][instant], self.steps[log][interval] = state, step

    def missed(self, linearisation: Linearisation) -> list[np.ndarray]:
        """Replay without the force − reference at the end of each interval, in the tangent, (intervals, 2 nv) a log.

        By the replay with the force, less what that does by its linearisation.
        """
        n, of_logs = 2 * self.nv, zip(linearisation.forces, self.steps, strict=True)
        return [-own[:, :n] - np.einsum("kij,kj->ki", response, own[:, n:]) for response, own in of_logs]

    @property
    def result(self) -> Intervals:
        """The intervals from the states that were followed."""
        references = [Motion.of_states(one, self.intervals.robot.model.nq) for one in self.references]
        return self.intervals.with_references(references, np.concatenate(self.forces)).with_close(self.close)


def linearise(intervals: Intervals, chunks: Chunks, offsets: Sequence[np.ndarray]) -> tuple[Intervals, Linearisation]:
    """Intervals whose references follow the logs, and the linearisation about them, by an extended Kalman filter.

    Derivatives are by long steps of the simulation, whose error cancels in a difference. Where a foot meets the ground
    or leaves it, short ones take their place; elsewhere every second of short intervals has those of the one before, if
    the robot stands on feet: for that of a held one, whose joints turn round under dry friction, they change too much.
    """
    short = intervals.by_short_steps
    with ExitStack() as stack:
        usual, close, rough, rough_close = (
            Reaching(own, chunks, offsets, stack.enter_context(Models(own.replayer)))
            for own in (intervals, short, rough_steps(intervals), rough_steps(short))
        )
        return linearised_along(Following(usual, close), (rough, rough_close))


def linearised_along(following: Following, rough: tuple[Reaching, Reaching]) -> tuple[Intervals, Linearisation]:
    """The same, by robots that follow the logs, and by ``rough`` ones whose steps are longer than usual and short."""
    intervals, chunks, robot = following.intervals, following.chunks, following.intervals.robot
    entries, nv = intervals.channels.state_entries, robot.model.nv
    n = 2 * nv
    size = n + nv
    of_force = np.arange(n, size)
    units = force_units(intervals)
    noise = noise_at_ends(intervals, chunks)
    covariance = np.zeros((len(chunks.log), size, size))
    covariance[:, range(n), range(n)] = start_deviation(intervals, chunks) ** 2
    covariance[:, of_force, of_force] = FOLLOWING**2
    gains = np.zeros((len(chunks.log), chunks.longest, size, len(entries)))
    found = [[np.zeros((own.intervals, n, columns)) for own in intervals.courses] for columns in (n, nv, n)]
    anew = np.zeros(len(chunks.log), bool)  # Chunks whose last interval has derivatives of its own that may serve again
    share = robot.stands and 2 * intervals.interval_s <= ALIKE_S
    for k in range(chunks.longest):
        order = following.chunks_at(k)
        places = chunks.places(k, order)
        force = following.force[order] * units
        close, base, by_steps = following.meet(k, order, force)
        full, bent = np.zeros((len(order), size, size)), np.zeros((len(order), n, n))
        stay = following.stay[order, k, None]
        full[:, of_force, of_force] = stay
        like_before = anew[order] & ~close & (stay[:, 0] == following.stay[order, k - 1])
        anew[order] = ~like_before & ~close & share
        for at in np.flatnonzero(like_before):
            log, interval = places[at]
            full[at, :n, :n], full[at, :n, n:], bent[at] = (of[log][interval - 1] for of in found)
        roots = np.linalg.cholesky(covariance[order])
        for short, by in enumerate(rough):
            own = np.flatnonzero((close == bool(short)) & ~like_before)
            if len(own):
                displacements = Displacements(roots[own], units)
                states = Motion.of_states(following.state[order[own]], robot.model.nq)
                starts, forces = displacements.starts(states, robot)
                forces += np.repeat(force[own], len(forces) // len(own), axis=0)
                reached = by.reach(k, order[own], starts, forces)
                full[own, :n, :n], full[own, :n, n:], bent[own] = displacements.derivatives(reached, robot)
        bent += by_steps[:, :, None] * by_steps[:, None]
        spread = full @ covariance[order] @ full.transpose(0, 2, 1)
        spread[:, of_force, of_force] += FOLLOWING**2 * (1 - stay**2)
        spread[:, range(n), range(n)] += 1e-14
        spread[:, :n, :n] += bent
        cross = spread[:, entries]
        innovation = cross[:, :, entries]
        innovation[:, range(len(entries)), range(len(entries))] += noise[order, k] ** 2
        gain = np.linalg.solve(innovation, cross).transpose(0, 2, 1)
        spread = spread - gain @ cross
        gains[order, k] = gain
        covariance[order] = 0.5 * (spread + spread.transpose(0, 2, 1))
        following.correct(k, order, base, gain)
        for c, (log, interval) in enumerate(places):
            for of, own in zip(found, (full[c, :n, :n], full[c, :n, n:], bent[c]), strict=True):
                of[log][interval] = own
    transitions, responses, errors = (tuple(of) for of in found)
    return following.result, Linearisation(transitions, responses, errors, units, gains)


def follow(
    intervals: Intervals, chunks: Chunks, offsets: Sequence[np.ndarray], linearisation: Linearisation
) -> Following:
    """References that follow the logs with the gains of a linearisation."""
    with ExitStack() as stack:
        by = (intervals, intervals.by_short_steps)
        reaching = [Reaching(own, chunks, offsets, stack.enter_context(Models(own.replayer))) for own in by]
        following = Following(*reaching)
        for k in range(chunks.longest):
            order = following.chunks_at(k)
            base = following.reach(k, order, following.force[order] * linearisation.units)
            following.correct(k, order, base, linearisation.gains[order, k])
        return following
