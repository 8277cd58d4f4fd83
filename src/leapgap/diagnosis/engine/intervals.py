"""Logs cut into short intervals, each replayed from the state that the log has at its beginning.

A replay that starts anew every few milliseconds stays at the log's own contacts, and what it misses by the end of an
interval is what the model lacks there. Effects change that by amounts that are linear in nearly all of their numbers.
All states are as the log reports them: what acts in the sensors alone is a change of the reported state.
"""

from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import mujoco
import mujoco.rollout
import numpy as np

from leapgap.diagnosis.channels import displaced, tangent_difference
from leapgap.diagnosis.short_rollouts import FINE, StateChannels, smooth_starts
from leapgap.diagnosis.simulation_settings import SimulationSettings
from leapgap.effects.base import ACTING, Effect, overrides, overriding
from leapgap.logs.log import Log
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, joint_gains
from leapgap.simulation.working_models import without_warnings

Effects = tuple[Effect, ...]
T = TypeVar("T")
Result = TypeVar("Result")

WITH_FORCE = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
DIVERGED = 1e4
"""A replay with a larger state than this has left the world of numbers; it counts as one that stays where it began."""
SEGMENT, LEAST_SEGMENT = 64, 16  # Largest number of intervals of a segment, and the smallest of many logs
MOST_S, MOST_WITH_FEET_S = 12.0, 6.0
"""About how much is kept of all logs together, s; replays of a robot with feet take longer."""
ENDS = 0.05  # Share of a log's motion at its ends within which the first and the last of its segments lie
LONG = 1.25  # Intervals of more steps than this many times those of the shortest are replayed apart
MEMORY = 4
"""Number of intervals that a replay with states of its own (a lag, an elastic gear) lasts after its first one."""


@dataclass(frozen=True)
class Shares:
    """The rows of some intervals, one interval after the other."""

    counts: np.ndarray  # Rows of each interval, (intervals,)
    starts: np.ndarray  # The first of them, (intervals,)
    lengths: np.ndarray  # Of each row, in any unit, (rows,)

    @property
    def each(self) -> np.ndarray:
        """Number of the interval of each row, (rows,)."""
        return np.repeat(np.arange(len(self.counts)), self.counts)

    @property
    def middles(self) -> np.ndarray:
        """The middle of each row as a share of its interval, (rows,)."""
        before = np.cumsum(self.lengths) - self.lengths
        within = before - before[self.starts][self.each] + 0.5 * self.lengths
        return np.asarray(within / np.add.reduceat(self.lengths, self.starts)[self.each])

    def means(self, of_rows: np.ndarray) -> np.ndarray:
        """Means (…, intervals, columns) over the time of each interval, from (…, rows, columns)."""
        sums = np.add.reduceat(of_rows * self.lengths[:, None], self.starts, axis=-2)
        return np.asarray(sums / np.add.reduceat(self.lengths, self.starts)[:, None])


@dataclass(frozen=True)
class Course:
    """Some segments of one log, cut into intervals, with the states from which these are replayed.

    Instants are the ends of all intervals and the begin of each segment, segment by segment.
    """

    states: States
    segments: tuple[int, ...]  # Number of intervals of each segment
    rows: np.ndarray  # Rows of the instants, (instants,)
    reference: Motion  # States at the instants, as reported
    noise: np.ndarray  # Standard deviation of the sensor noise of each channel at the instants, (instants, channels)
    close: np.ndarray
    """Intervals that are replayed by short steps: a foot meets the ground or leaves it, bool (intervals,)."""

    @staticmethod
    def of(states: States, segments: Sequence[np.ndarray], channels: StateChannels) -> "Course":
        """Segments, arrays of the rows that begin and end their intervals; references are smoothed states."""
        rows = np.concatenate(segments)
        starts, _ = smooth_starts(states.motion, rows.tolist(), states.log, channels.robot)
        reference = Motion.of_states(starts.states, channels.robot.model.nq)
        noise = channels.noise_in_rows(states.motion, states.log)[rows]
        lengths = tuple(len(own) - 1 for own in segments)
        return Course(states, lengths, rows, reference, noise, np.zeros(sum(lengths), bool))

    def part(self, chosen: np.ndarray) -> "Course":
        """Some of the segments, bool (segments,)."""
        lengths = np.array(self.segments)
        instants = np.repeat(chosen, lengths + 1)
        segments, reference = tuple(lengths[chosen].tolist()), self.reference[np.flatnonzero(instants)]
        rows, noise, close = self.rows[instants], self.noise[instants], self.close[np.repeat(chosen, lengths)]
        return replace(self, segments=segments, rows=rows, reference=reference, noise=noise, close=close)

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return sum(self.segments)

    @cached_property
    def begins(self) -> np.ndarray:
        """Instant at which each interval begins; it ends at the next one, (intervals,)."""
        lengths = np.array(self.segments)
        return np.arange(self.intervals) + np.repeat(np.arange(len(lengths)), lengths)

    @cached_property
    def lengths_s(self) -> np.ndarray:
        """Length of each interval, to 1 ns as in time stamps, s, (intervals,)."""
        instants = self.states.log.time[self.rows]
        return np.round(instants[self.begins + 1] - instants[self.begins], 9)

    def rows_within(self, which: np.ndarray) -> tuple[np.ndarray, "Shares"]:
        """The rows of some intervals, one after the other, and their shares in these."""
        first, after = self.rows[self.begins[which]], self.rows[self.begins[which] + 1]
        counts = after - first
        starts = np.cumsum(counts) - counts
        rows = np.arange(counts.sum()) + np.repeat(first - starts, counts)
        return rows, Shares(counts, starts, self.states.log.row_lengths[rows])

    @cached_property
    def segment_ends(self) -> np.ndarray:
        """Last instant of the segment of each interval, (intervals,)."""
        lengths = np.array(self.segments)
        return np.repeat(np.cumsum(lengths + 1) - 1, lengths)

    @cached_property
    def measured(self) -> Motion:
        """What the log reports at the instants."""
        return self.states.motion[self.rows]

    @cached_property
    def start_states(self) -> np.ndarray:
        """Reference at the beginning of each interval, (intervals, nq + nv)."""
        return np.concatenate([self.reference.qpos, self.reference.qvel], axis=1)[self.begins]


@dataclass(frozen=True)
class Intervals:
    """The intervals of all logs, by a robot with some effects."""

    channels: StateChannels
    replayer: Replayer
    courses: tuple[Course, ...]
    acting: tuple[Effects, ...]  # Effects of the robot on each log
    simulation: tuple[SimulationSettings, ...] = ()
    """Settings of the simulation, which act beside any set; ``acting`` has them as well."""
    residual: np.ndarray | None = None
    """Force without a name by which the references follow the logs, in its units, (instants of all chunks, nv)."""

    @staticmethod
    def of(states: Sequence[States], replayer: Replayer, interval_s: float) -> "Intervals":
        """Logs cut into intervals of about a length, or of one row where that is longer, by the nominal robot.

        Of long logs segments are kept, about ``MOST_S`` in all: spread over how far the robot moves, on feet over time.
        """
        channels = StateChannels.of([own.log for own in states], replayer.robot)
        courses = []
        for own in states:
            ends = interval_ends(own.log, interval_s)
            count = len(ends) - 1
            most_s = MOST_WITH_FEET_S if replayer.robot.stands else MOST_S
            most = most_s / len(states) / np.round(np.diff(own.log.time[ends]).mean(), 9)
            length = int(np.clip(most, LEAST_SEGMENT, SEGMENT))
            parts = np.array_split(np.arange(count), max(1, -(-count // length)))
            kept = max(1, min(len(parts), round(most / length)))
            segments = [ends[np.append(part, part[-1] + 1)] for part in parts]
            evenly = np.linspace(0, len(parts) - 1, kept).round().astype(int).tolist()
            chosen = evenly if replayer.robot.stands else where_it_moves(own, segments, kept)
            courses.append(Course.of(own, [segments[k] for k in chosen], channels))
        return Intervals(channels, replayer, tuple(courses), ((),) * len(states))

    def part(self, chosen: Sequence[np.ndarray]) -> "Intervals":
        """Some of the segments of each log, bool (segments,) of each; logs of which none is left are left out."""
        kept = [log for log, own in enumerate(chosen) if own.any()]
        courses, acting = (self.courses[log].part(chosen[log]) for log in kept), (self.acting[log] for log in kept)
        return replace(self, courses=tuple(courses), acting=tuple(acting), residual=None)

    def simulated_by(self, simulation: tuple[SimulationSettings, ...]) -> "Intervals":
        """The same by other settings of the simulation."""
        acting = tuple((*simulation, *own[len(self.simulation) :]) for own in self.acting)
        return replace(self, simulation=simulation, acting=acting)

    @property
    def robot(self) -> Robot:
        """The robot of the logs."""
        return self.replayer.robot

    @property
    def interval_s(self) -> float:
        """Usual length of an interval, s."""
        return float(np.median(np.concatenate([own.lengths_s for own in self.courses])))

    def with_references(self, references: Sequence[Motion], residual: np.ndarray) -> "Intervals":
        """The same intervals from other states, which follow the logs by a force."""
        courses = tuple(replace(own, reference=new) for own, new in zip(self.courses, references, strict=True))
        return replace(self, courses=courses, residual=residual)

    def with_close(self, close: Sequence[np.ndarray]) -> "Intervals":
        """The same intervals, of which others are replayed by short steps."""
        courses = tuple(replace(own, close=new) for own, new in zip(self.courses, close, strict=True))
        return replace(self, courses=courses)

    @property
    def by_short_steps(self) -> "Intervals":
        """The intervals by short steps of the simulation."""
        return replace(self, replayer=self.replayer.with_steps(FINE * self.replayer.largest_step_s))

    @cached_property
    def predicted(self) -> list[Motion]:
        """Reported states at the end of each interval by the robot with what acts and has no memory."""

        def of_log(log: int) -> Motion:
            plain = self.without_memory(log)
            return self._reached(log, plain, self.misreported(log, plain))

        return self.each(range(len(self.courses)), of_log)

    def defects(self, transitions: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Replay by what acts − reference at the end of each interval, in the tangent, (intervals, 2 nv) a log."""
        remembered = self.remembered(transitions)
        return [
            tangent_difference(reached, own.reference[own.begins + 1], self.robot) + more
            for reached, own, more in zip(self.predicted, self.courses, remembered, strict=True)
        ]

    def remembered(self, transitions: Sequence[np.ndarray]) -> list[np.ndarray]:
        """What those of the acting effects that have a memory change, (intervals, 2 nv) a log."""
        logs = range(len(self.courses))
        plain = [self.without_memory(log) for log in logs]
        if all(len(own) == len(all_of) for own, all_of in zip(plain, self.acting, strict=True)):
            return [np.zeros((own.intervals, 2 * self.robot.model.nv)) for own in self.courses]
        base = replace(self, acting=tuple(plain))
        _ = base._long_predicted  # before several threads ask for it
        return base.each(logs, lambda log: base.change(log, self.acting[log], transitions[log]))

    def innovations(self) -> list[np.ndarray]:
        """Measured − reference at the end of each interval, in the measured channels, (intervals, channels)."""
        entries = self.channels.state_entries
        missed = [tangent_difference(own.measured, own.reference, self.robot) for own in self.courses]
        return [of[own.begins + 1][:, entries] for of, own in zip(missed, self.courses, strict=True)]

    def changes(self, sets: Sequence[Sequence[Effects]], transitions: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        """By how much effects ``[set][log]``, in place of what acts, change the reported states: ``[set][log]``.

        At the end of each interval, (intervals, 2 nv). ``transitions`` (intervals, 2 nv, 2 nv) of each log tell what of
        a change has come from earlier intervals, where replays last several.
        """
        tasks = [(log, of[log]) for of in sets for log in range(len(self.courses))]
        if any(self.has_memory(*task) or self.has_memory(task[0], self.acting[task[0]]) for task in tasks):
            _ = self._long_predicted  # before several threads ask for it
        _ = self.predicted
        found = iter(self.each(tasks, lambda task: self.change(*task, transitions[task[0]])))
        return [[next(found) for _ in self.courses] for _ in sets]

    def each(self, tasks: Sequence[T], function: Callable[[T], Result]) -> list[Result]:
        """Results of a function of each task, by all threads."""
        with ThreadPoolExecutor(self.replayer.threads) as pool:
            return list(pool.map(function, tasks))

    def change(self, log: int, effects: Effects, transition: np.ndarray) -> np.ndarray:
        """By how much effects in place of what acts change the reported states of one log, (intervals, 2 nv).

        What sensors misreport moves the true states at the beginning of each interval. Of a robot with feet these are
        those of what acts, moved by ``transition``, exactly: feet stay as deep in the ground as they are.
        """
        acting, begins = self.acting[log], self.courses[log].begins
        late, before = self.misreported(log, effects), self.misreported(log, acting)
        memory = self.has_memory(log, effects) or self.has_memory(log, acting)
        if not memory and not self.robot.stands:
            return tangent_difference(self._reached(log, effects, late), self.predicted[log], self.robot)
        if moving(effects) == moving(acting):
            change = np.zeros((self.courses[log].intervals, 2 * self.robot.model.nv))
        elif memory:
            change = self._with_memory(log, effects, transition)
        else:
            change = tangent_difference(self._reached(log, effects, before), self.predicted[log], self.robot)
        further = late - before
        return np.asarray(change + further[begins + 1] - np.einsum("kij,kj->ki", transition, further[begins]))

    def has_memory(self, log: int, effects: Effects) -> bool:
        """Whether a robot with some effects has states beside its joints' that the log does not tell."""
        trial = Rollout(self.courses[log].states.log, effects)
        if not trial.structure:
            return False
        return self.replayer.further_states(trial) != self.replayer.further_states(replace(trial, effects=()))

    def without_memory(self, log: int) -> Effects:
        """The acting effects on a log but those with a memory."""
        return tuple(effect for effect in self.acting[log] if not self.has_memory(log, (effect,)))

    def _reached(self, log: int, effects: Effects, late: np.ndarray) -> Motion:
        """States at the end of every interval of a log, by effects from the reference less ``late``, and with it."""
        own, trial = self.courses[log], Rollout(self.courses[log].states.log, effects)
        starts = self._true_starts(own, late)
        reached = self._by_own_steps(log, effects, starts)
        if trial.step_ratio != 1:
            finer = replace(self, replayer=self.replayer.with_finer_steps())
            reached = self.replayer.by_step_ratio(trial, reached, finer._by_own_steps(log, effects, starts))
        return displaced(reached, late[own.begins + 1], self.robot) if late.any() else reached

    def _by_own_steps(self, log: int, effects: Effects, starts: np.ndarray) -> Motion:
        """True states at the end of every interval, from true states at its beginning, by the steps of each."""
        close = self.courses[log].close
        parts = [(self, np.flatnonzero(~close)), (self.by_short_steps, np.flatnonzero(close))]
        with ExitStack() as stack:
            prepared = [
                (own.prepare(log, effects, stack.enter_context(Models(own.replayer))), which)
                for own, which in parts
                if len(which)
            ]
            order = np.concatenate([which for _, which in prepared])
            return roll(prepared, starts[order])[np.argsort(order), 0]

    def _true_starts(self, own: Course, late: np.ndarray) -> np.ndarray:
        """True states at the beginning of each interval, (intervals, nq + nv), of sensors that report ``late`` more."""
        if not late.any():
            return own.start_states
        true = displaced(own.reference[own.begins], -late[own.begins], self.robot)
        return np.concatenate([true.qpos, true.qvel], axis=1)

    def misreported(self, log: int, effects: Effects) -> np.ndarray:
        """Reported − true state at the instants of a log, by sensors with some effects, (instants, 2 nv)."""
        own, sensing = self.courses[log], overriding(effects, "change_measured")
        found = np.zeros((len(own.rows), 2 * self.robot.model.nv))
        if not sensing:
            return found
        at = 0
        for length in own.segments:
            here = np.arange(at, at + length + 1)
            motion = reference = own.reference[here]
            if not own.states.log.is_even:
                motion = replace(reference, time=own.states.log.time[own.rows[here]])
            for effect in sensing:
                motion = effect.change_measured(motion, self.interval_s, self.robot)
            found[here] = tangent_difference(motion, reference, self.robot)
            at += length + 1
        return found

    def _with_memory(self, log: int, effects: Effects, transition: np.ndarray) -> np.ndarray:
        """Changes by effects with states of their own, which begin at rest: replays last several intervals.

        They overlap by one interval, since in its first one a replay has no memory yet.
        """
        begins, plain = self._long_predicted[log]
        changed = self._long_replays(log, effects, begins)
        found = np.zeros((self.courses[log].intervals, 2 * self.robot.model.nv))
        change = np.zeros((len(begins), found.shape[1]))
        for k in range(changed.span):
            before = np.einsum("bij,bj->bi", transition[begins + k], change)
            change = tangent_difference(changed[:, k], plain[:, k], self.robot)
            warm = slice(None) if k else self._first_of_segments(log, begins)
            found[(begins + k)[warm]] = (change - before)[warm]
        return found

    def _first_of_segments(self, log: int, begins: np.ndarray) -> np.ndarray:
        """Which of some intervals are the first of a segment, where no replay is warm."""
        lengths = self.courses[log].segments
        return np.isin(begins, np.cumsum([0, *lengths[:-1]]))

    @cached_property
    def _long_predicted(self) -> list[tuple[np.ndarray, "ReachedStates"]]:
        """First intervals of long replays of each log, and those replays by what acts."""
        found = []
        for log, own in enumerate(self.courses):
            span, first, begins = self._span(log), 0, []
            for length in own.segments:
                within = np.minimum(np.arange(0, max(1, length - 1), MEMORY), length - span)
                begins.append(first + within)
                first += length
            found.append((np.concatenate(begins), self._long_replays(log, self.acting[log], np.concatenate(begins))))
        return found

    def _span(self, log: int) -> int:
        """Intervals of a long replay of a log."""
        return min(MEMORY + 1, *self.courses[log].segments)

    def _long_replays(self, log: int, effects: Effects, begins: np.ndarray) -> "ReachedStates":
        """Replays of several intervals from the true states of what acts."""
        own = self.courses[log]
        starts = self._true_starts(own, self.misreported(log, self.acting[log]))[begins]
        with Models(self.replayer) as models:
            return roll([(self.prepare(log, effects, models, self._span(log)), begins)], starts)

    def prepare(self, log: int, effects: Effects, models: "Models", span: int = 1) -> "PreparedIntervals":
        """The intervals of a log by a robot with some effects, ready for replays of ``span`` intervals each."""
        own, replayer = self.courses[log], self.replayer
        trial = Rollout(own.states.log, effects, measured=own.states.motion)
        steps = replayer.row_steps(trial)[: own.rows[-1]]
        until = np.concatenate([[0], np.cumsum(steps)])
        ends = np.minimum(own.begins[:, None] + np.arange(1, span + 1), own.segment_ends[:, None])
        first = until[own.rows[own.begins]]
        steps_until = until[own.rows[ends]] - first[:, None]
        longest = np.arange(steps_until[:, -1].max())
        when = np.minimum(first[:, None] + longest, first[:, None] + steps_until[:, -1:] - 1)
        controls = replayer.step_controls(trial, steps, when)
        gains = joint_gains(trial.log, self.robot)[own.rows[own.begins]]
        _, rows, which = np.unique(gains, axis=0, return_index=True, return_inverse=True)
        lent = [models.of(trial, int(own.rows[own.begins[row]])) for row in rows]
        states = (of(trial, own.rows[own.begins].tolist(), steps) for of in (replayer.warmth, replayer.lagged_torque))
        return PreparedIntervals(replayer, trial, lent, which.ravel(), controls, steps_until, *states)


def where_it_moves(states: States, segments: Sequence[np.ndarray], kept: int) -> list[int]:
    """Some segments of a log that are spread evenly over how far the robot moves, their indices.

    At rest it tells little of its dynamics. How far it moves in a segment is the range of its positions, rad and m.
    """
    extents = [np.linalg.norm(np.ptp(states.motion.qpos[own[0] : own[-1] + 1], axis=0)) for own in segments]
    moved = np.cumsum(extents)
    chosen: list[int] = []
    for at in np.searchsorted(moved, np.linspace(ENDS, 1 - ENDS, kept) * moved[-1]).tolist():
        left = [k for k in range(len(segments)) if k not in chosen]
        chosen.append(min(left, key=lambda k: abs(k - at)))
    return sorted(chosen)


def interval_ends(log: Log, interval_s: float) -> np.ndarray:
    """Rows at which intervals of about a length begin and end, of at least one row each, (intervals + 1,)."""
    if log.is_even:
        return np.arange(0, len(log), log.info.rows(interval_s))
    ends, time = [0], log.time
    while ends[-1] < len(log) - 1:
        after = int(np.searchsorted(time, time[ends[-1]] + interval_s))
        earlier = max(after - 1, ends[-1] + 1)
        later = min(max(after, earlier), len(log) - 1)
        is_later = abs(time[later] - time[ends[-1]] - interval_s) < abs(time[earlier] - time[ends[-1]] - interval_s)
        ends.append(later if is_later else earlier)
    return np.array(ends)


def moving(effects: Effects) -> Effects:
    """Those effects that change the true motion."""
    return tuple(effect for effect in effects if any(overrides(type(effect), method) for method in ACTING))


class Models(ExitStack):
    """Working models that are lent for the time of a block, one for all trials whose models are equal."""

    def __init__(self, replayer: Replayer) -> None:
        super().__init__()
        self.replayer = replayer
        self.kept: dict[Hashable, mujoco.MjModel] = {}

    def of(self, trial: Rollout, row: int) -> mujoco.MjModel:
        """The model of a trial in a row of its log."""
        (key,) = self.replayer.alike(trial, [row])
        if key not in self.kept:
            self.kept[key] = self.enter_context(self.replayer.working_model(trial, row)).model
        return self.kept[key]


@dataclass(frozen=True)
class PreparedIntervals:
    """The intervals of one log by one robot."""

    replayer: Replayer
    trial: Rollout
    models: list[mujoco.MjModel]  # One for each set of joint gains
    model_of: np.ndarray  # Index of the model of each interval, (intervals,)
    controls: np.ndarray  # (intervals, steps, actuators)
    steps: np.ndarray  # Number of steps until the end of each of the intervals that a replay lasts, (intervals, span)
    warmth: np.ndarray | None
    """Of the motors at the beginning of each interval, (intervals, joints); None where none heats."""
    lagged: np.ndarray | None  # Torque of the motors there, N·m, (intervals, joints); None where none lags

    def full_states(self, which: np.ndarray, states: np.ndarray) -> np.ndarray:
        """MuJoCo's full states at the beginning of some intervals, from positions and velocities (some, nq + nv)."""
        found = []
        for k, model in enumerate(self.models):
            own = self.model_of[which] == k
            at = which[own]
            of_motors = (None if of is None else of[at] for of in (self.warmth, self.lagged))
            of_model = self.replayer.full_states(self.trial, model, states[own], self.controls[at], *of_motors)
            found.append((own, of_model))
        full = np.zeros((len(states), found[0][1].shape[1]))
        for own, of_model in found:
            full[own] = of_model
        return full


class Pool:
    """Threads that replay together, with their working memory."""

    def __init__(self, model: mujoco.MjModel, threads: int) -> None:
        self.threads = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
        self.data = [mujoco.MjData(model) for _ in range(threads)]


def roll(
    parts: Sequence[tuple[PreparedIntervals, np.ndarray]],
    states: np.ndarray,
    forces: np.ndarray | None = None,
    pool: "Pool | None" = None,
) -> "ReachedStates":
    """True states at the ends of intervals of several logs, from true states (some, nq + nv).

    ``parts`` are the first intervals of each log, in the order of ``states`` and of ``forces`` (some, nv), N or N·m.
    The threads of a ``pool`` share the work.
    """
    robot = parts[0][0].replayer.robot
    models = [own.models[own.model_of[k]] for own, which in parts for k in which]
    ends = np.cumsum([len(which) for _, which in parts])[:-1]
    split = np.split(states, ends)
    full = np.concatenate([own.full_states(which, of) for (own, which), of in zip(parts, split, strict=True)])
    longest = max(own.controls.shape[1] for own, _ in parts)
    controls = np.zeros((len(states), longest, parts[0][0].controls.shape[2]))
    for place, (own, which) in zip(np.split(np.arange(len(states)), ends), parts, strict=True):
        steps = own.controls.shape[1]
        controls[place, :steps], controls[place, steps:] = own.controls[which], own.controls[which, -1:]
    spec = int(mujoco.mjtState.mjSTATE_CTRL)
    if forces is not None:
        applied = np.broadcast_to(forces[:, None], (len(forces), longest, forces.shape[1]))
        controls, spec = np.concatenate([controls, applied], axis=2), WITH_FORCE
    pool = pool or Pool(models[0], 1)
    until = np.concatenate([own.steps[which] for own, which in parts])
    lasts, ended = until[:, -1], np.zeros((*until.shape, full.shape[1]))
    left = np.ones(len(lasts), bool)
    while left.any():  # those of a length together: short steps, or a long row, are many times as many
        chosen = left & (lasts <= LONG * lasts[left].min())
        which, sent = np.flatnonzero(chosen), controls[chosen, : lasts[chosen].max()]
        left &= ~chosen
        with without_warnings():
            out, _ = pool.threads.rollout([models[k] for k in which], pool.data, full[which], sent, control_spec=spec)
        ended[which] = out[np.arange(len(which))[:, None], until[which] - 1]
    lost = ~(np.abs(ended) < DIVERGED).all(axis=(1, 2))
    ended[lost] = full[lost, None]
    nq, nv, first = robot.model.nq, robot.model.nv, 1 + parts[0][0].models[0].nq
    return ReachedStates(ended[:, :, 1 : 1 + nq], ended[:, :, first : first + nv])


@dataclass(frozen=True)
class ReachedStates:
    """States at the ends of the intervals of several replays."""

    qpos: np.ndarray  # (replays, span, nq)
    qvel: np.ndarray  # (replays, span, nv)

    @property
    def span(self) -> int:
        """Number of intervals of each replay."""
        return self.qpos.shape[1]

    def __getitem__(self, which: tuple[slice | np.ndarray, int]) -> Motion:
        return Motion(self.qpos[which], self.qvel[which])
