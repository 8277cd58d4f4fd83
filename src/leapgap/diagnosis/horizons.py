"""Replays that start anew from the log after a horizon, and the longest horizon at which they say anything.

A robot under tight joint control is replayed over a whole log. One that is driven by torques, or falls, soon does
something else for reasons as small as noise; over a shorter time its replay still says what the model lacks.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.diagnosis.channels import channel_errors, displaced
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts

StartNoise = np.ndarray  # Small steps of each start in the tangent of its state, (starts, 2 nv)
HORIZONS_S = (0.1, 0.3, 1.0)  # Horizons at which errors are told, beside whole logs
INFORMATIVE = 0.5  # A replay is informative while its error is below this share of that of a robot that does not move


@dataclass(frozen=True)
class RestartedReplayer:
    """Replays logs as ``Replayer`` does, but starts anew from the log after each horizon."""

    replayer: Replayer
    horizon_s: float
    smoothed: dict[int, tuple[Log, tuple[Starts, np.ndarray]]] = field(default_factory=dict, repr=False, compare=False)
    """Starts of each log that was replayed, by its ``id``; the log is kept so that the number stays its own."""

    def with_steps(self, largest_step_s: float) -> "RestartedReplayer":
        """The same with another largest step of the simulation."""
        return replace(self, replayer=self.replayer.with_steps(largest_step_s))

    def with_robot(self, robot: Robot) -> "RestartedReplayer":
        """The same for another description of the robot."""
        return RestartedReplayer(self.replayer.with_robot(robot), self.horizon_s)

    def motions(self, trials: Sequence[Rollout], noise: Sequence[StartNoise | None] | None = None) -> list[Motion]:
        """Motion of every trial over all rows of its log, made of pieces; equal at any number of threads.

        ``noise`` disturbs the starts of each trial's pieces.
        """
        with ThreadPoolExecutor(self.replayer.threads) as pool:
            return list(pool.map(self._motion, trials, noise or [None] * len(trials)))

    def starts(self, trial: Rollout) -> tuple[Starts, np.ndarray]:
        """Smoothed starts of the pieces of a log, and the share of the sensor noise that remains in each."""
        log, robot = trial.log, self.replayer.robot
        if id(log) not in self.smoothed:
            measured = motion_of(log, robot) if trial.measured is None else trial.measured
            found = smooth_starts(measured, restarts(len(log), log.info.rows(self.horizon_s)), log, robot)
            self.smoothed[id(log)] = log, found
        return self.smoothed[id(log)][1]

    def _motion(self, trial: Rollout, noise: StartNoise | None) -> Motion:
        log, rows = trial.log, trial.log.info.rows(self.horizon_s)
        starts, _ = self.starts(trial)
        if noise is not None:
            states = Motion.of_states(starts.states, self.replayer.robot.model.nq)
            moved = displaced(states, noise, self.replayer.robot)
            starts = replace(starts, states=np.concatenate([moved.qpos, moved.qvel], axis=1))
        whole = [k for k, begin in enumerate(starts.rows) if begin + rows < len(log)]
        pieces = self._pieces(trial, starts, whole, rows + 1)
        if len(whole) < len(starts.rows):  # the last one ends with the log
            pieces += self._pieces(trial, starts, [len(starts.rows) - 1], len(log) - starts.rows[-1])
        kept = [piece[:rows] for piece in pieces[:-1]] + pieces[-1:]
        sensors = [one.sensors for one in kept if one.sensors is not None]
        return Motion(
            np.concatenate([one.qpos for one in kept]),
            np.concatenate([one.qvel for one in kept]),
            np.concatenate(sensors) if sensors else None,
        )

    def _pieces(self, trial: Rollout, starts: Starts, which: Sequence[int], rows: int) -> list[Motion]:
        return self.replayer.replay_pieces([trial], [starts.chosen(which)], rows)[0] if which else []


def restarts(length: int, rows: int) -> list[int]:
    """First rows of the pieces of ``rows`` rows of a log; the grid does not depend on where the log ends."""
    return list(range(0, max(length - 1, 1), rows))


def replayer_at(replayer: Replayer, horizon_s: float | None) -> Replayer | RestartedReplayer:
    """A replayer of whole logs, or one that restarts."""
    return replayer if horizon_s is None else RestartedReplayer(replayer, horizon_s)


@dataclass(frozen=True)
class HorizonError:
    """The headline gap of replays that restart from the log after a horizon."""

    horizon_s: float | None  # None: whole logs
    nominal: float
    corrected: float  # On held-out logs
    unmoved: float  # That of a robot that does not move at each start

    @property
    def is_informative(self) -> bool:
        """Whether the nominal replay is clearly nearer than a robot that does nothing."""
        return self.nominal < INFORMATIVE * self.unmoved


def horizons_of(judged: JudgedLogs) -> list[float | None]:
    """Horizons that are shorter than the longest log, longest first, whole logs before them; of jumps the latter alone.

    The gap of jumps is that of whole logs by definition, so that no other horizon is worth the time of its replays.
    """
    if judged.preset == "jump":
        return [None]
    longest = max(float(log.time[-1]) for log in judged.logs)
    return [None, *(horizon for horizon in sorted(HORIZONS_S, reverse=True) if horizon < longest)]


def gap_of(errors: Sequence[np.ndarray]) -> float:
    """Root mean square of scaled errors (rows, channels) of all logs."""
    return float(np.sqrt(sum((e**2).sum() for e in errors) / sum(e.size for e in errors)))


def unmoved_errors(judged: JudgedLogs, horizon_s: float | None) -> list[np.ndarray]:
    """Scaled errors (rows, channels) of each log for a robot that does not move at each start."""
    found = []
    for log, motion in zip(judged.logs, judged.motions, strict=True):
        rows = len(log) if horizon_s is None else log.info.rows(horizon_s)
        begins = np.array(restarts(len(log), rows))
        held = begins[np.searchsorted(begins, np.arange(len(log)), side="right") - 1]
        found.append(channel_errors(motion[held], motion, judged.channels, judged.robot) / judged.scales)
    return found


def longest_informative(gaps: Sequence[HorizonError]) -> HorizonError:
    """The longest horizon at which the nominal robot is informative; the shortest where it never is."""
    return next((gap for gap in gaps if gap.is_informative), gaps[-1])
