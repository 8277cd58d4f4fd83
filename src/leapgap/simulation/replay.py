"""Open-loop replay: the log's own commands, from its first state, in the simulated robot.

The joint PD is the affine part of MuJoCo's actuators and the commands are their controls, so that whole logs roll
out without a Python loop, many at once on all cores, bit-identical at any number of threads.
"""

import copy
import itertools
import os
from collections.abc import Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import mujoco
import mujoco.rollout
import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.state import columns_of
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import sensor_addresses
from leapgap.robot.motion import QUATERNION_SLICE, Motion
from leapgap.simulation.rollout import Rollout, Starts, joint_gains
from leapgap.simulation.rollout_models import RolloutModels
from leapgap.simulation.working_models import WorkingModel, without_warnings

FINER = 0.255  # largest step of the finer of two replays that tell what a step does, as a share of the usual one


@dataclass(frozen=True)
class Pieces:
    """Pieces of one trial, ready to be simulated."""

    trial: Rollout
    states: np.ndarray  # (pieces, nq + nv): true first states
    controls: np.ndarray  # (pieces, steps, actuators); pieces of fewer steps than the longest hold their last
    steps: np.ndarray  # steps of the simulation in each row, (pieces, rows − 1)
    warmth: np.ndarray | None  # warmth of the motors at the start, (pieces, joints); None where no motor heats

    def chosen(self, which: Sequence[int]) -> "Pieces":
        """Some of the pieces, in the order of ``which``."""
        if len(which) == len(self.states):
            return self
        at = list(which)
        warmth = None if self.warmth is None else self.warmth[at]
        return Pieces(self.trial, self.states[at], self.controls[at], self.steps[at], warmth)


def batch_controls(controls: Sequence[np.ndarray]) -> np.ndarray:
    """Controls (pieces, steps, actuators) of several trials in one array; shorter ones hold their last."""
    longest = max(of.shape[1] for of in controls)
    missing = [longest - of.shape[1] for of in controls]
    return np.concatenate(
        [np.pad(of, ((0, 0), (0, n), (0, 0)), "edge") if n else of for of, n in zip(controls, missing, strict=True)]
    )


class Replayer(RolloutModels):
    """Replays logs on one robot; keeps compiled models and working memory between calls.

    A control period longer than ``largest_step_s`` is simulated in several equal steps. Motions hold ``sensors``, which
    are columns of a log (``robot.model_sensors``). Several threads may call ``replay_pieces`` at once.
    """

    def __init__(
        self,
        robot: Robot,
        terrain_slots: int = 1,
        threads: int | None = None,
        largest_step_s: float | None = None,
        sensors: Sequence[str] = (),
    ) -> None:
        super().__init__(robot, terrain_slots, largest_step_s, sensors)
        self.finer: Replayer | None = None
        self.threads = threads or os.cpu_count() or 1

    def with_steps(self, largest_step_s: float) -> "Replayer":
        """A replayer of the same class with another largest step; both share compiled models."""
        other = copy.copy(self)
        other.largest_step_s = largest_step_s
        other.finer = None
        return other

    def with_robot(self, robot: Robot) -> "Replayer":
        """A replayer of the same class for another description of the robot."""
        return type(self)(robot, self.slots, self.threads, sensors=self.sensors)

    def motions(self, trials: Sequence[Rollout], rows: int | None = None) -> list[Motion]:
        """Replay every trial over the first ``rows`` rows of its log (all, where it is None), as a log reports it.

        Where joint gains change within a log, the trial continues with the new gains.
        """
        return [self.measure(t, m) for t, m in zip(trials, self.true_motions(trials, rows), strict=True)]

    def true_motions(self, trials: Sequence[Rollout], rows: int | None = None) -> list[Motion]:
        """True motions of the same replays, without the delay and bias of sensors."""
        motions = self._by_own_steps(trials, rows)
        chosen = [i for i, trial in enumerate(trials) if trial.step_ratio != 1]
        if chosen:
            finer = self.with_finer_steps()._by_own_steps([trials[i] for i in chosen], rows)
            for i, fine in zip(chosen, finer, strict=True):
                motions[i] = self.by_step_ratio(trials[i], motions[i], fine)
        return motions

    def _by_own_steps(self, trials: Sequence[Rollout], rows: int | None) -> list[Motion]:
        for trial in trials:
            self.check_joints(trial.log)
        kinds = [(min(len(t.log), rows or len(t.log)), self.substeps(t.log), t.structure) for t in trials]
        motions: dict[int, Motion] = {}
        for kind in dict.fromkeys(kinds):
            chosen = [i for i, own in enumerate(kinds) if own == kind]
            motions |= zip(chosen, self._same_kind([trials[i] for i in chosen], *kind[:2]), strict=True)
        return [motions[i] for i in range(len(trials))]

    def replay_pieces(
        self, trials: Sequence[Rollout], starts: Sequence[Starts], rows: int | Sequence[int]
    ) -> list[list[Motion]]:
        """Replay pieces, each from a state of its own, in the calling thread: one motion a start.

        They have ``rows`` rows, the same in all trials or one number a trial. Commands are those of the whole log, so
        that what was sent before a piece still arrives in it; each piece keeps the joint gains of its first row.
        Motions are as a log reports them.
        """
        lengths = [rows] * len(trials) if isinstance(rows, int) else rows
        pieces = self._pieces_by_own_steps(trials, starts, lengths)
        chosen = [i for i, trial in enumerate(trials) if trial.step_ratio != 1]
        if chosen:
            finer = self.with_finer_steps()._pieces_by_own_steps(
                [trials[i] for i in chosen], [starts[i] for i in chosen], [lengths[i] for i in chosen]
            )
            for i, fine in zip(chosen, finer, strict=True):
                own = zip(pieces[i], fine, strict=True)
                pieces[i] = [self.by_step_ratio(trials[i], *of_piece) for of_piece in own]
        return pieces

    def with_finer_steps(self) -> "Replayer":
        """The replayer of finer steps, kept between calls."""
        if self.finer is None:
            self.finer = self.with_steps(FINER * self.largest_step_s)
        return self.finer

    def by_step_ratio(self, trial: Rollout, own: Motion, fine: Motion) -> Motion:
        """The motion by steps of the trial's length, from those by own and by finer steps.

        The error of a step of length h is taken as proportional to h, as Euler's method has it, between the two
        replays and beyond them (Richardson's extrapolation).
        """
        steps = self.substeps(trial.log)
        nominal = self.with_steps(self.own_step_s).substeps(trial.log)
        share = (1 - trial.step_ratio) * steps / nominal / (1 - steps / self.with_finer_steps().substeps(trial.log))

        def between(coarse: np.ndarray, refined: np.ndarray) -> np.ndarray:
            return np.asarray(coarse + share * (refined - coarse))

        qpos = between(own.qpos, fine.qpos)
        if self.robot.has_free_base:
            qpos[:, QUATERNION_SLICE] /= np.linalg.norm(qpos[:, QUATERNION_SLICE], axis=1, keepdims=True)
        sensors = None if own.sensors is None or fine.sensors is None else between(own.sensors, fine.sensors)
        return Motion(qpos, between(own.qvel, fine.qvel), sensors)

    def _pieces_by_own_steps(
        self, trials: Sequence[Rollout], starts: Sequence[Starts], rows: Sequence[int]
    ) -> list[list[Motion]]:
        motions: list[dict[int, Motion]] = [{} for _ in trials]
        alike: dict[Hashable, list[tuple[int, list[int]]]] = {}
        """By what pieces of equal models have in common: the trial, and which of its pieces."""
        for i, (trial, of, length) in enumerate(zip(trials, starts, rows, strict=True)):
            self.check_joints(trial.log)
            which: dict[Hashable, list[int]] = {}
            for k, key in enumerate(self.alike(trial, of.rows)):
                which.setdefault((key, length), []).append(k)
            for key, own in which.items():
                alike.setdefault(key, []).append((i, own))
        cut = [self._cut(*of) for of in zip(trials, starts, rows, strict=True)]
        for members in alike.values():
            i, own = members[0]
            with self.working_model(trials[i], starts[i].rows[own[0]]) as working:
                found = self._roll_out(working, [cut[i].chosen(own) for i, own in members])
            for (i, own), of_trial in zip(members, found, strict=True):
                motions[i] |= zip(own, of_trial, strict=True)
        return [[of[k] for k in range(len(of))] for of in motions]

    def _cut(self, trial: Rollout, starts: Starts, rows: int) -> Pieces:
        """The pieces of ``rows`` rows of one trial."""
        first, last = np.array(starts.rows, int), max(starts.rows, default=0) + rows - 1
        steps = self.row_steps(trial)[:last]
        before = np.concatenate([[0], np.cumsum(steps)])
        begin, end = before[first][:, None], before[first + rows - 1][:, None]
        at = np.minimum(begin + np.arange((end - begin).max(initial=1)), end - 1)
        late_s = trial.reported_late_s
        later = starts.later(late_s / trial.period_s) if late_s else None
        states = self.true_states(trial.effects, starts.states, later, late_s)
        of_rows = steps[first[:, None] + np.arange(rows - 1)]
        controls, warmth = self.step_controls(trial, steps, at), self.warmth(trial, starts.rows, steps)
        return Pieces(trial, states, controls, of_rows, warmth)

    def _roll_out(self, working: WorkingModel, pieces: Sequence[Pieces]) -> list[list[Motion]]:
        """Motions of pieces of several trials, whose models are all equal to one, as their robots would log them."""
        model = working.model
        states = [self.full_states(of.trial, model, of.states, of.controls, of.warmth) for of in pieces]
        controls = batch_controls([of.controls for of in pieces])
        with without_warnings():
            out, read = mujoco.rollout.rollout(model, working.data, np.concatenate(states), controls)
        found, last = [], 0
        for of, state in zip(pieces, states, strict=True):
            first, last = last, last + len(state)
            whole, sensors = self._in_rows(model, state, out[first:last], read[first:last], of.steps)
            found.append(
                [
                    self.measure(of.trial, self._of_robot(model, *of_piece), steps)
                    for *of_piece, steps in zip(whole, sensors, of.steps, strict=True)
                ]
            )
        return found

    def _in_rows(
        self, model: mujoco.MjModel, first: np.ndarray, out: np.ndarray, read: np.ndarray, steps: np.ndarray
    ) -> tuple[np.ndarray, Sequence[np.ndarray | None]]:
        """Full states and sensors of pieces in their rows, from those in every step of the simulation.

        (pieces, rows, values) each; sensors are those of the last step before each row, and of the first step for the
        first row. ``first`` (pieces, values) are the first states, ``steps`` those of each row, (pieces, rows − 1).
        """
        ends, piece = np.cumsum(steps, axis=1) - 1, np.arange(len(first))[:, None]
        whole = np.concatenate([first[:, None], out[piece, ends]], axis=1)
        if not self.sensors:
            return whole, [None] * len(first)
        at = np.concatenate([np.zeros_like(piece), ends], axis=1)
        return whole, read[piece, at][:, :, sensor_addresses(model, self.sensors)]

    def _of_robot(self, model: mujoco.MjModel, states: np.ndarray, sensors: np.ndarray | None) -> Motion:
        """The robot's own positions and velocities in full states (rows, …); what effects have added stands behind."""
        first = 1 + model.nq
        return Motion(states[:, 1 : 1 + self.bare.nq], states[:, first : first + self.bare.nv], sensors)

    def _same_kind(self, trials: Sequence[Rollout], rows: int, substeps: float) -> list[Motion]:
        """Replay trials of one structure, equally many rows and steps a row, each in one of the threads."""
        gains = [joint_gains(t.log, self.robot)[:rows] for t in trials]
        # Rows 0 … rows−2 are each held for one period; the last row's command is not needed.
        switches = sorted(
            {0, rows - 1}.union(*(set((np.flatnonzero((g[1:-1] != g[:-2]).any(axis=1)) + 1).tolist()) for g in gains))
        )
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(lambda trial: self._whole(trial, rows, switches), trials))

    def _whole(self, trial: Rollout, rows: int, switches: Sequence[int]) -> Motion:
        """Replay a trial between rows at which the gains of some trial change."""
        steps = self.row_steps(trial)[: rows - 1]
        controls = self.step_controls(trial, steps, slice(None))[None]
        before = np.concatenate([[0], np.cumsum(steps)])
        states: list[np.ndarray] = []
        sensors: list[np.ndarray] = []
        for start, end in itertools.pairwise(switches):
            with self.working_model(trial, start) as working, without_warnings():
                model = working.model
                first = states[-1][-1:] if states else self.full_state(trial, model, controls[0])[None]
                control = controls[:, before[start] : before[end]]
                out, read = mujoco.rollout.rollout(model, working.data, first, control)
            whole, own = self._in_rows(model, first, out, read, steps[None, start:end])
            states.append(whole[0, min(start, 1) :])
            sensors += [one[min(start, 1) :] for one in own if one is not None]
        return self._of_robot(model, np.concatenate(states), np.concatenate(sensors) if sensors else None)

    def as_log(self, motion: Motion, log: Log) -> Log:
        """The motion as a log: measured columns from the simulation, commands from the replayed log."""
        columns = {
            name: values[: len(motion)].copy()
            for name, values in log.columns.items()
            if name == "time" or name.startswith("cmd_")
        }
        if motion.sensors is not None:
            columns |= dict(zip(self.sensors, motion.sensors.T, strict=True))
        info = replace(log.info, source=f"replay of {log.name}")
        return Log(log.name, columns | columns_of(motion, self.robot), info)
