"""Short rollouts: errors of short replays from the log in every logged channel, whitened by sensor noise.

Each log is cut to pieces. A piece is replayed from its own smoothed first state, and compared with the log at several
ages. The covariance of such an error has two parts: noise of the start, propagated by the robot's dynamics (finite
differences), and white noise of the log. It whitens the errors of a piece.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial

import mujoco
import numpy as np

from leapgap.diagnosis.channels import Channel, logged_channels, tangent_difference, with_fast_parts
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_in_rows, noise_of
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import QUATERNION_SLICE, Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts

Effects = tuple[Effect, ...]
RolloutRequest = tuple[int, Effects, Starts]  # Replays of pieces of one log: index of the log, effects, starts

SMOOTHED_S = 0.009  # Starts are smoothed by a parabola through the rows up to this time before and after them
FINE, ROUGH = 0.255, 2.0
"""Largest simulation steps as shares of the replayer's. Replays of short steps show the error of the nominal step. Long
steps are accurate enough for differences, but for those of nuisances in the search one by one."""
LEAST_NOISE = {
    "base_pos": 1e-4,
    "base_turn": 1e-4,
    "base_linvel": 1e-3,
    "base_angvel": 1e-3,
    "joint_pos": 1e-4,
    "joint_vel": 1e-3,
    "imu_acc": 1e-2,
    "foot_force": 0.1,
}
"""Lower bound of a quantity's noise, m, rad, m/s, rad/s, m/s², N, since logs are rounded to a last digit."""
ROLLOUTS_AT_ONCE = 200  # Largest number of rollouts in one batch of a thread; it bounds memory
SHARES = 3  # Number of batches for each thread; several, so that no thread waits long for another


@dataclass(frozen=True)
class StateChannels:
    """Channels that every log has, those of the robot's state first, and their differences between two motions."""

    robot: Robot
    channels: tuple[Channel, ...]

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot, sensors: Sequence[str] = ()) -> "StateChannels":
        """Channels that every log has, with some columns of sensors beside the state."""
        return StateChannels(robot, logged_channels(logs, robot, sensors))

    @cached_property
    def entries(self) -> np.ndarray:
        """Indices of the channels in the tangent of the state (2 nv,) and the sensors behind it, (channels,)."""
        return np.array([channel.entry for channel in self.channels])

    @cached_property
    def state_entries(self) -> np.ndarray:
        """Those of the state alone, which can be displaced; they stand first."""
        return np.array([channel.entry for channel in self.channels if channel.is_state], dtype=int)

    def differences(self, simulated: Motion, logged: Motion) -> np.ndarray:
        """Simulated − logged in the channels, (rows, channels)."""
        return tangent_difference(simulated, logged, self.robot)[:, self.entries]

    def displace(self, state: np.ndarray, entry: int, by: float) -> np.ndarray:
        """Displace a state (nq + nv,) by ``by`` in one entry of its tangent (2 nv)."""
        nq, nv = self.robot.model.nq, self.robot.model.nv
        tangent = np.zeros(2 * nv)
        tangent[entry] = by
        qpos = state[:nq].copy()
        mujoco.mj_integratePos(self.robot.model, qpos, tangent[:nv], 1.0)
        return np.concatenate([qpos, state[nq:] + tangent[nv:]])

    def noise(self, logged: Motion, log: Log) -> np.ndarray:
        """Standard deviation of each channel's sensor noise, (channels,)."""
        period_s = log.info.sample_period_s
        found = noise_of(self.differences(logged[1:], logged[:-1]), period_s, log.uneven_steps)
        found = with_fast_parts(found, logged, period_s, self.channels)
        return np.maximum(found, [LEAST_NOISE[channel.quantity] for channel in self.channels])

    def noise_in_rows(self, logged: Motion, log: Log) -> np.ndarray:
        """The same in each row, (rows, channels): where rows are uneven, samples are off in time."""
        noise = self.noise(logged, log)
        if log.is_even:
            return np.broadcast_to(noise, (len(log), len(noise)))
        steps = self.differences(logged[1:], logged[:-1])
        return noise_in_rows(log.time, np.concatenate([0 * steps[:1], steps.cumsum(axis=0)]), noise)


def check_length(logs: Sequence[Log], horizon_s: float) -> None:
    """Raise ``InputError`` where no log lasts longer than a horizon."""
    if all(len(log) <= log.info.rows(horizon_s) for log in logs):
        longest = max(len(log) * log.info.sample_period_s for log in logs)
        raise InputError("logs", f"{longest:g} s at most", f"more than {horizon_s:g} s", "log longer motions")


def thin_evenly(rows: Sequence[np.ndarray], most: int) -> list[np.ndarray]:
    """Thin the rows of all logs together evenly to at most ``most``, so that logs keep different rows."""
    lengths = [len(own) for own in rows]
    total = sum(lengths)
    kept = np.zeros(total, bool)
    kept[np.unique((np.arange(min(most, total)) * total / min(most, total)).astype(int))] = True
    return [own[k] for own, k in zip(rows, np.split(kept, np.cumsum(lengths)[:-1]), strict=True)]


def smooth_start(logged: Motion, row: int, ages: np.ndarray, reach: int) -> tuple[np.ndarray, float]:
    """State at a row by a parabola through its neighbours, (nq + nv,), and the share of their noise that stays.

    ``ages`` of all rows after this one are in mean rows, (rows,); neighbours are those at most ``reach`` rows away.
    """
    first, last = max(0, row - reach), min(len(ages), row + reach + 1)
    age = ages[first:last]
    degree = 2 if first < row else 1  # at the log's beginning a parabola would swing
    weights = np.linalg.pinv(np.vander(age, degree + 1, increasing=True))[0]
    qpos, qvel = weights @ logged.qpos[first:last], weights @ logged.qvel[first:last]
    return np.concatenate([qpos, qvel]), float(np.linalg.norm(weights))


@dataclass(frozen=True)
class SmoothCourse:
    """Smoothed states of a log at any instant."""

    logged: Motion
    when: np.ndarray  # Instants of the rows, in mean rows, (rows,)
    reach: int

    def at(self, instant: float) -> tuple[np.ndarray, float]:
        """State at an instant in mean rows, the log's end at most, and the share of the rows' noise that stays."""
        instant = min(instant, float(self.when[-1]))
        return smooth_start(self.logged, int(np.abs(self.when - instant).argmin()), self.when - instant, self.reach)

    def __call__(self, rows: Sequence[int], after: float) -> np.ndarray:
        """By how much the state changes in ``after`` mean rows from some rows on, (rows, nq + nv)."""
        changes = [self.at(self.when[row] + after)[0] - self.at(self.when[row])[0] for row in rows]
        return np.reshape(changes, (len(rows), self.logged.qpos.shape[1] + self.logged.qvel.shape[1]))


def smooth_starts(logged: Motion, rows: Sequence[int], log: Log, robot: Robot) -> tuple[Starts, np.ndarray]:
    """Smoothed states at some rows of a log, and the share of the noise that remains in each, (rows,)."""
    when = np.arange(len(log)) if log.is_even else log.time / log.info.sample_period_s
    course = SmoothCourse(logged, when, log.info.rows(SMOOTHED_S))
    found = [course.at(when[row]) for row in rows]
    states = np.array([start for start, _ in found]).reshape(len(rows), robot.model.nq + robot.model.nv)
    if robot.has_free_base:
        states[:, QUATERNION_SLICE] /= np.linalg.norm(states[:, QUATERNION_SLICE], axis=1, keepdims=True)
    return Starts(rows, states, course), np.array([kept for _, kept in found])


def every(motions: Sequence[Motion], rows: int) -> Motion:
    """Every ``rows``-th row after the first of several motions, one motion after the other."""
    sensors = [motion.sensors[rows::rows] for motion in motions if motion.sensors is not None]
    return Motion(
        np.concatenate([motion.qpos[rows::rows] for motion in motions]),
        np.concatenate([motion.qvel[rows::rows] for motion in motions]),
        np.concatenate(sensors) if sensors else None,
    )


@dataclass(frozen=True)
class Pieces:
    """The pieces of one log."""

    log: Log
    logged: Motion
    starts: Starts
    noise: np.ndarray  # Standard deviation of the log's sensor noise, (channels,)
    start_noise: np.ndarray  # Share of the noise that remains in the smoothed starts, (pieces,)
    fitted_noise: np.ndarray
    """Standard deviation of states of the starts that were not logged, in their tangent, (pieces, 2 nv)."""
    ages: np.ndarray
    """Rows after the start of a piece at which it is compared, whole numbers of the first, (ages,); equally many in
    every log."""

    @staticmethod
    def of(states: States, rows: Sequence[int], ages: np.ndarray, state: StateChannels) -> "Pieces":
        """Pieces of a log that start at these rows, and are compared after ``ages`` rows."""
        log, logged = states.log, states.motion
        starts, kept = smooth_starts(logged, rows, log, state.robot)
        noise = state.noise(logged, log)
        return Pieces(log, logged, starts, noise, kept, states.deviation[list(rows)], ages)

    def for_steps(self, largest_step_s: float) -> "Pieces":
        """The same pieces with rows as far apart as a step, compared at the same instants; estimated noise stays."""
        step = max(1, round(largest_step_s / self.log.info.sample_period_s))
        rows = math.gcd(*self.ages.tolist(), *self.starts.rows, step)
        log, logged = self.log.downsample(rows), self.logged[::rows]
        return replace(self, log=log, logged=logged, starts=self.starts.every(rows), ages=self.ages // rows)

    def errors(self, motions: Sequence[Motion], starts: Starts, state: StateChannels) -> np.ndarray:
        """Simulated − logged values of replays from some starts, (starts, ages × channels)."""
        values = len(self.ages) * len(state.channels)
        if not motions:
            return np.zeros((0, values))
        rows = (np.array(starts.rows)[:, None] + self.ages).ravel()
        return state.differences(every(motions, int(self.ages[0])), self.logged[rows]).reshape(-1, values)


@dataclass(frozen=True)
class ShortRollouts:
    """Short rollouts of pieces of logs, with the whitening of their errors."""

    state: StateChannels
    replayer: Replayer
    pieces: tuple[Pieces, ...]
    whitening: tuple[np.ndarray, ...]
    """For each log, (pieces, values, values): whitened = W @ error, values = ages × channels."""

    @staticmethod
    def of(
        states: Sequence[States], replayer: Replayer, horizon_s: float, every_s: float, most: int
    ) -> "ShortRollouts":
        """Cut logs to at most ``most`` pieces of a horizon, compared every ``every_s``; without whitening yet."""
        logs = [of_log.log for of_log in states]
        check_length(logs, horizon_s)
        state = StateChannels.of(logs, replayer.robot, replayer.sensors)
        number = np.arange(1, round(horizon_s / every_s) + 1)
        ages = [number * log.info.rows(every_s) for log in logs]
        rows = thin_evenly([np.arange(0, len(log) - a[-1], a[-1]) for log, a in zip(logs, ages, strict=True)], most)
        pieces = [Pieces.of(of, own.tolist(), a, state) for of, own, a in zip(states, rows, ages, strict=True)]
        return ShortRollouts(state, replayer, tuple(pieces), ())

    def whiten_for(self, effects: Sequence[Effects]) -> "ShortRollouts":
        """The same with the whitening for a robot with these effects, one tuple for each log."""
        return replace(self, whitening=tuple(self._whitening(effects)))

    def on_every_log(self, effects: Effects) -> list[Effects]:
        """The same effects for every log."""
        return [effects] * len(self.pieces)

    def with_steps(self, largest_step_s: float) -> "ShortRollouts":
        """The same pieces with another largest step, which may be several rows; compared at the same instants."""
        pieces = tuple(of.for_steps(largest_step_s) for of in self.pieces)
        return replace(self, replayer=self.replayer.with_steps(largest_step_s), pieces=pieces)

    def errors(self, trials: Sequence[RolloutRequest], whitened: bool = False) -> Iterator[np.ndarray]:
        """Simulated − logged values of each request, (pieces, values), computed by all threads."""
        sizes = [len(starts.rows) for _, _, starts in trials]
        most = min(ROLLOUTS_AT_ONCE, -(-sum(sizes) // (SHARES * self.replayer.threads)))
        batches: list[list[RolloutRequest]] = []
        room = 0
        for trial, size in zip(trials, sizes, strict=True):
            if room <= 0:
                batches.append([])
                room = most
            batches[-1].append(trial)
            room -= size
        with ThreadPoolExecutor(self.replayer.threads) as pool:
            yield from itertools.chain.from_iterable(pool.map(partial(self._batch, whitened), batches))

    def _batch(self, whitened: bool, batch: Sequence[RolloutRequest]) -> list[np.ndarray]:
        trials = [Rollout(self.pieces[log].log, effects) for log, effects, _ in batch]
        rows = [int(self.pieces[log].ages[-1]) + 1 for log, _, _ in batch]
        motions = self.replayer.replay_pieces(trials, [starts for _, _, starts in batch], rows)
        found = []
        for (log, _, starts), of_trial in zip(batch, motions, strict=True):
            error = self.pieces[log].errors(of_trial, starts, self.state)
            found.append(self.whiten(log, error) if whitened else error)
        return found

    def residuals(
        self, candidates: Sequence[Sequence[Effects]], logs: Sequence[int] | None = None
    ) -> list[list[np.ndarray]]:
        """Whitened errors ``[candidate][log]``, (pieces, values), of effects ``candidates[candidate][any log]``.

        Of some ``logs``; None: of all.
        """
        logs = range(len(self.pieces)) if logs is None else logs
        errors = self.errors([(log, of[log], self.pieces[log].starts) for of in candidates for log in logs], True)
        return [[next(errors) for _ in logs] for _ in candidates]

    def whiten(self, log: int, error: np.ndarray) -> np.ndarray:
        """Whiten the errors of one log, (pieces, values)."""
        finite = error if np.isfinite(error).all() else np.nan_to_num(error, nan=0.0, posinf=1e3, neginf=-1e3)
        return np.asarray((self.whitening[log] @ finite[:, :, None])[:, :, 0])

    def _whitening(self, effects: Sequence[Effects]) -> Iterator[np.ndarray]:
        """Inverse Cholesky factors of each piece's error covariance, from noise of its start and of the log.

        What the noise of a start grows to is the difference of replays by long steps, whose error cancels.
        """
        rough = self
        if all(own.log.is_even for own in self.pieces):
            rough = self.with_steps(ROUGH * self.replayer.largest_step_s)
        trials = [
            (log, effects[log], starts)
            for log, own in enumerate(rough.pieces)
            for starts in (own.starts, *self._displace_starts(own))
        ]
        errors = rough.errors(trials)
        for own in self.pieces:
            base = next(errors)
            fitted, measured = int(own.fitted_noise.any(axis=0).sum()), len(self.state.state_entries)
            displaced = measured + 2 * fitted
            growth = np.nan_to_num(np.stack([next(errors) - base for _ in range(displaced)], axis=2))
            growth[:, :, measured:] /= np.sqrt(2)  # two directions of one state
            white = np.tile(own.noise, len(own.ages)) ** 2  # growth: (pieces, values, channels)
            covariance = growth @ growth.transpose(0, 2, 1) + np.diag(white)
            yield np.linalg.inv(np.linalg.cholesky(covariance))

    def _displace_starts(self, own: Pieces) -> Iterator[Starts]:
        """The starts of a log, displaced in one entry after the other by a standard deviation of their noise.

        First in the channels, then in both directions in states that were not logged: their noise is large enough to
        change when a foot lands.
        """
        sign = np.where(np.arange(len(own.starts.rows)) % 2, -1.0, 1.0)
        sizes = [(int(e), own.start_noise * own.noise[c]) for c, e in enumerate(self.state.state_entries)]
        fitted = np.flatnonzero(own.fitted_noise.any(axis=0))
        sizes += [(int(e), way * own.fitted_noise[:, e]) for e in fitted for way in (1, -1)]
        for entry, size in sizes:
            states = [self.state.displace(s, entry, b) for s, b in zip(own.starts.states, sign * size, strict=True)]
            yield replace(own.starts, states=np.array(states).reshape(own.starts.states.shape))
