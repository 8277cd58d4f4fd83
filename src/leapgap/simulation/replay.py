"""Open-loop replay: the log's own commands, from its first state, in the simulated robot.

The joint PD is the affine part of MuJoCo's actuators and the commands are their controls, so that whole logs roll
out without a Python loop, many at once on all cores, bit-identical at any number of threads.
"""

import copy
import itertools
import os
import threading
from collections.abc import Hashable, Sequence
from dataclasses import replace

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
from leapgap.simulation.trial_log import without_warnings

FINER = 0.255
"""Largest step of the finer of two replays, as a share of the usual one, by which the effect of the step is known."""
MOST_BATCH_BYTES = 256 * 2**20
"""Memory of trials that are replayed at once: a maker's model with meshes is 8 MB and more, and a minute as much."""


def batch_controls(controls: Sequence[np.ndarray]) -> np.ndarray:
    """Controls of trials, (steps, actuators) each, as (trials, steps, actuators); short trials hold their last."""
    longest = max(len(control) for control in controls)
    return np.stack([c if len(c) == longest else np.pad(c, ((0, longest - len(c)), (0, 0)), "edge") for c in controls])


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
        self.data: dict[tuple[Hashable, ...], list[mujoco.MjData]] = {}
        self.own = threading.local()

    def with_steps(self, largest_step_s: float) -> "Replayer":
        """A replayer of the same class with another largest step; both share compiled models."""
        other = copy.copy(self)
        other.largest_step_s = largest_step_s
        other.data, other.own, other.finer = {}, threading.local(), None
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
            finer = self._finer()._by_own_steps([trials[i] for i in chosen], rows)
            for i, fine in zip(chosen, finer, strict=True):
                motions[i] = self._by_step_ratio(trials[i], motions[i], fine)
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

    def replay_pieces(self, trials: Sequence[Rollout], starts: Sequence[Starts], rows: int) -> list[list[Motion]]:
        """Replay pieces of ``rows`` rows, each from a state of its own, in the calling thread: one motion a start.

        Commands are those of the whole log, so that what was sent before a piece still arrives in it; each piece keeps
        the joint gains of its first row. Motions are as a log reports them.
        """
        pieces = self._pieces_by_own_steps(trials, starts, rows)
        chosen = [i for i, trial in enumerate(trials) if trial.step_ratio != 1]
        if chosen:
            finer = self._finer()._pieces_by_own_steps([trials[i] for i in chosen], [starts[i] for i in chosen], rows)
            for i, fine in zip(chosen, finer, strict=True):
                own = zip(pieces[i], fine, strict=True)
                pieces[i] = [self._by_step_ratio(trials[i], *of_piece) for of_piece in own]
        return pieces

    def _finer(self) -> "Replayer":
        """The replayer of finer steps, kept between calls."""
        if self.finer is None:
            self.finer = self.with_steps(FINER * self.largest_step_s)
        return self.finer

    def _by_step_ratio(self, trial: Rollout, own: Motion, fine: Motion) -> Motion:
        """The motion by steps of the trial's length, from those by own and by finer steps.

        The error of a step of length h is taken as proportional to h, as Euler's method has it, between the two
        replays and beyond them (Richardson's extrapolation).
        """
        steps = self.substeps(trial.log)
        nominal = self.with_steps(self.own_step_s).substeps(trial.log)
        share = (1 - trial.step_ratio) * steps / nominal / (1 - steps / self._finer().substeps(trial.log))

        def between(coarse: np.ndarray, refined: np.ndarray) -> np.ndarray:
            return np.asarray(coarse + share * (refined - coarse))

        qpos = between(own.qpos, fine.qpos)
        if self.robot.has_free_base:
            qpos[:, QUATERNION_SLICE] /= np.linalg.norm(qpos[:, QUATERNION_SLICE], axis=1, keepdims=True)
        sensors = None if own.sensors is None or fine.sensors is None else between(own.sensors, fine.sensors)
        return Motion(qpos, between(own.qvel, fine.qvel), sensors)

    def _pieces_by_own_steps(
        self, trials: Sequence[Rollout], starts: Sequence[Starts], rows: int
    ) -> list[list[Motion]]:
        prepared = [self._restarts(trial, of, rows) for trial, of in zip(trials, starts, strict=True)]
        kinds = [(self.substeps(trial.log), trial.structure) for trial in trials]
        found: dict[int, list[Motion]] = {}
        for kind in dict.fromkeys(kinds):
            chosen = [i for i, own in enumerate(kinds) if own == kind]
            models, states, controls, counts = (
                list(itertools.chain.from_iterable(prepared[i][k] for i in chosen)) for k in range(4)
            )
            if not states:
                found |= {i: [] for i in chosen}
                continue
            data = self._own_data(trials[chosen[0]])
            with without_warnings():
                out, read = mujoco.rollout.rollout(models, data, np.stack(states), batch_controls(controls))
            readings = [self._readings(*one) for one in zip(models, read, counts, strict=True)]
            pieces = zip(states, counts, out, readings, strict=True)
            for i in chosen:
                found[i] = [self._motion(trials[i], *next(pieces)) for _ in starts[i].rows]
        return [found[i] for i in range(len(trials))]

    def _restarts(
        self, trial: Rollout, starts: Starts, rows: int
    ) -> tuple[list[mujoco.MjModel], list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
        """Model, full first state, controls in every step and steps of the rows of each piece of one trial."""
        self.check_joints(trial.log)
        if not len(starts.rows):
            return [], [], [], []
        steps = self.row_steps(trial)[: starts.rows[-1] + rows - 1]
        control, step = self._step_controls(trial, steps), np.concatenate([[0], np.cumsum(steps)])
        gains = joint_gains(trial.log, self.robot)
        of_gains: dict[bytes, mujoco.MjModel] = {}
        models, states, controls, counts = [], [], [], []
        warmth = self._warmth(trial, starts.rows, steps)
        late_s = trial.reported_late_s
        later = starts.later(late_s / trial.period_s) if late_s else None
        for i, (row, state, warm) in enumerate(zip(starts.rows, starts.states, warmth, strict=True)):
            key = gains[row].tobytes()
            if key not in of_gains:
                of_gains[key] = self.model(trial, row=row)
            own = control[step[row] : step[row + rows - 1]]
            true = self.true_state(trial.effects, state, None if later is None else later[i], late_s)
            models.append(of_gains[key])
            states.append(self.full_state(replace(trial, first_state=true), of_gains[key], own, warm))
            controls.append(own)
            counts.append(steps[row : row + rows - 1])
        return models, states, controls, counts

    def _motion(
        self, trial: Rollout, state: np.ndarray, counts: np.ndarray, out: np.ndarray, readings: np.ndarray | None
    ) -> Motion:
        """A piece, of its full first state and those after every step, as the trial's robot would log it."""
        piece = np.concatenate([state[None], out[np.cumsum(counts) - 1]])
        return self.measure(trial, self._of_robot(trial, piece, readings), counts)

    def _of_robot(self, trial: Rollout, states: np.ndarray, readings: np.ndarray | None) -> Motion:
        """The robot's own positions and velocities in full states (rows, …); what effects have added stands behind."""
        first = 1 + self._compiled(trial).nq
        return Motion(states[:, 1 : 1 + self.bare.nq], states[:, first : first + self.bare.nv], readings)

    def _readings(self, model: mujoco.MjModel, read: np.ndarray, counts: np.ndarray) -> np.ndarray | None:
        """Sensors in the last step before each row, (rows + 1, sensors), in the first step for the first row.

        ``read`` are MuJoCo's readings in every step, (steps, values).
        """
        if not self.sensors:
            return None
        at = np.concatenate([[0], np.cumsum(counts) - 1])
        return np.asarray(read[at][:, sensor_addresses(model, self.sensors)])

    def _same_kind(self, trials: Sequence[Rollout], rows: int, substeps: float) -> list[Motion]:
        """Replay trials of one structure, equally many rows and steps a row, batch by batch."""
        gains = [joint_gains(t.log, self.robot)[:rows] for t in trials]
        # Rows 0 … rows−2 are each held for one period; the last row's command is not needed.
        switches = sorted(
            {0, rows - 1}.union(*(set((np.flatnonzero((g[1:-1] != g[:-2]).any(axis=1)) + 1).tolist()) for g in gains))
        )
        most = max(self.threads, MOST_BATCH_BYTES // self._bytes_of(trials[0], rows * substeps))
        batches = [trials[first : first + most] for first in range(0, len(trials), most)]
        return [motion for batch in batches for motion in self._batch(batch, rows, switches)]

    def _bytes_of(self, trial: Rollout, steps: float) -> int:
        """Memory that a trial of some steps takes while it is replayed: its model, and values of every step."""
        model = self._compiled(trial)
        state = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        # Controls are held as they are made, and side by side with those of other trials.
        values = state + model.nsensordata + 2 * model.nu
        return mujoco.mj_sizeModel(model) + int(steps * values * np.dtype(float).itemsize)

    def _batch(self, trials: Sequence[Rollout], rows: int, switches: Sequence[int]) -> list[Motion]:
        """Replay trials at once, each with a model of its own, between rows at which gains of some trial change."""
        data = self._data(trials[0])
        counts = [self.row_steps(trial)[: rows - 1] for trial in trials]
        controls = [self._step_controls(trial, steps) for trial, steps in zip(trials, counts, strict=True)]
        steps_before = [np.concatenate([[0], np.cumsum(steps)]) for steps in counts]
        history: list[list[np.ndarray]] = []
        readings: list[list[np.ndarray]] = [[] for _ in trials]
        for start, end in itertools.pairwise(switches):
            models = [self.model(trial, row=start) for trial in trials]
            if not history:
                history = [
                    [self.full_state(*of_trial)[None]] for of_trial in zip(trials, models, controls, strict=True)
                ]
            control = batch_controls(
                [c[step[start] : step[end]] for c, step in zip(controls, steps_before, strict=True)]
            )
            first = np.stack([h[-1][-1] for h in history])
            with without_warnings():
                out, read = mujoco.rollout.rollout(models, data, first, control, persistent_pool=True)
            for i, of_trial in enumerate(out):
                history[i].append(of_trial[np.cumsum(counts[i][start:end]) - 1])
                own = self._readings(models[i], read[i], counts[i][start:end])
                readings[i] += [] if own is None else [own[1 if readings[i] else 0 :]]
        wholes = [np.concatenate(h) for h in history]
        measured = [np.concatenate(r) if r else None for r in readings]
        return [self._of_robot(*of_trial) for of_trial in zip(trials, wholes, measured, strict=True)]

    def _data(self, trial: Rollout) -> list[mujoco.MjData]:
        """Working memory of each thread, for the trial's structure."""
        if trial.structure not in self.data:
            model = self._compiled(trial)
            self.data[trial.structure] = [mujoco.MjData(model) for _ in range(self.threads)]
        return self.data[trial.structure]

    def _own_data(self, trial: Rollout) -> mujoco.MjData:
        """Working memory of the calling thread, for the trial's structure."""
        memory: dict[tuple[Hashable, ...], mujoco.MjData] = self.own.__dict__  # type: ignore[assignment]
        if trial.structure not in memory:
            memory[trial.structure] = mujoco.MjData(self._compiled(trial))
        return memory[trial.structure]

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
