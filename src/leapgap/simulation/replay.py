"""Open-loop replay: the log's own commands, from its first state, in the simulated robot.

The joint PD is the affine part of MuJoCo's actuators and the commands are their controls, so that whole logs roll
out without a Python loop, many at once on all cores, bit-identical at any number of threads.
"""

import copy
import itertools
import os
import threading
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import mujoco.rollout
import numpy as np

from leapgap.effects.base import Commands, Effect, Load, overriding
from leapgap.effects.drive import Drive
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.state import columns_of, motion_of
from leapgap.robot import actuators
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import add_sensors, sensor_addresses
from leapgap.robot.motion import QUATERNION_SLICE, Motion
from leapgap.robot.rotors import carried_torque, rest_rotors
from leapgap.simulation.known_loads import put_loads

LARGEST_STEP_S = 0.0011
"""Largest step of the simulation, s; that of the model file where it is shorter."""
ROUNDING = 1.1
"""A step may be longer by this factor, so that a period of whole steps is simulated in so many."""
UNEVEN_FINER = 4
"""Rows of uneven length last a whole number of steps, which are so many times finer."""
FINER = 0.255
"""Largest step of the finer of two replays, as a share of the usual one, by which the effect of the step is known."""
MODELS_KEPT = 256
"""Number of compiled models that are kept, one for each terrain and structure."""


@dataclass(frozen=True)
class Rollout:
    """One replay: a log, and the effects to add to the nominal robot."""

    log: Log
    effects: tuple[Effect, ...] = ()
    first_state: np.ndarray | None = None
    """(nq + nv,): true first state; None: by the log's first row."""
    measured: Motion | None = None
    """The log's measured motion, where it is known already; None: read from the log."""

    @cached_property
    def structure(self) -> tuple[Hashable, ...]:
        """What the effects add to the model; only models of equal structure roll out in one batch."""
        structures = (effect.structure for effect in overriding(self.effects, "structure"))
        return tuple(own for own in structures if own is not None)

    @cached_property
    def period_s(self) -> float:
        """True control period, s."""
        period = self.log.info.sample_period_s
        for effect in overriding(self.effects, "change_period"):
            period = effect.change_period(period)
        return period

    @cached_property
    def step_ratio(self) -> float:
        """Length of the steps of the simulation that the motion is one of, over that of the replayer's own."""
        ratio = 1.0
        for effect in overriding(self.effects, "change_step"):
            ratio = effect.change_step(ratio)
        return ratio


def batch_controls(controls: Sequence[np.ndarray]) -> np.ndarray:
    """Controls of trials, (steps, actuators) each, as (trials, steps, actuators); short trials hold their last."""
    longest = max(len(control) for control in controls)
    return np.stack([c if len(c) == longest else np.pad(c, ((0, longest - len(c)), (0, 0)), "edge") for c in controls])


def joint_gains(log: Log, robot: Robot) -> np.ndarray:
    """Gains of the joint PD in every row, (rows, 2 joints): N·m/rad of all joints, then N·m·s/rad."""
    return np.concatenate([joint_commands(log, robot, gain) for gain in ("cmd_kp", "cmd_kd")], axis=1)


def joint_commands(log: Log, robot: Robot, quantity: str) -> np.ndarray:
    """A commanded quantity of every joint, (rows, joints); zero for joints that the log does not command."""
    commanded = [f"cmd_tau/{joint}" in log for joint in robot.joints]
    if all(commanded):
        return log.per_joint(quantity, robot.joints)
    values = np.zeros((len(log), len(robot.joints)))
    values[:, commanded] = log.per_joint(quantity, tuple(itertools.compress(robot.joints, commanded)))
    return values


def torques_by_velocity(trial: Rollout, robot: Robot) -> list[np.ndarray]:
    """Torques that effects add by the joint velocities which the log reports, (rows, joints) each."""
    adding = overriding(trial.effects, "torque_by_velocity")
    if not adding or all(effect.is_nominal for effect in adding):
        return []
    measured = motion_of(trial.log, robot) if trial.measured is None else trial.measured
    velocity = measured.qvel[:, robot.joint_dofs]
    found = (effect.torque_by_velocity(velocity, robot) for effect in adding)
    return [torque for torque in found if torque is not None]


@dataclass(frozen=True)
class Starts:
    """First rows of pieces of one log, and their first states."""

    rows: Sequence[int]
    states: np.ndarray
    """(pieces, nq + nv), as reported."""


class Replayer:
    """Replays logs on one robot; keeps compiled models and working memory between calls.

    ``terrain_slots`` boxes are in every model, so that logs on different terrain share one batch. A control period
    longer than ``largest_step_s`` is simulated in several equal steps. Motions hold ``sensors``, which are columns of a
    log (``robot.model_sensors``). Several threads may call ``replay_pieces`` at once.
    """

    def __init__(
        self,
        robot: Robot,
        terrain_slots: int = 1,
        threads: int | None = None,
        largest_step_s: float | None = None,
        sensors: Sequence[str] = (),
    ) -> None:
        self.robot, self.sensors = robot, tuple(sensors)
        own = ROUNDING * float(robot.model.opt.timestep)
        self.largest_step_s = min(LARGEST_STEP_S, own) if largest_step_s is None else largest_step_s
        self.own_step_s = self.largest_step_s
        self.finer: Replayer | None = None
        self.slots = terrain_slots
        self.bare = robot.on_terrain((), slots=terrain_slots)
        self.threads = threads or os.cpu_count() or 1
        self.data: dict[tuple[Hashable, ...], list[mujoco.MjData]] = {}
        self.own = threading.local()
        self.compiling = threading.Lock()
        self.compiled: dict[tuple[Hashable, ...], mujoco.MjModel] = {}

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

    def measure(self, trial: Rollout, motion: Motion) -> Motion:
        """A true motion as the sensors of the trial's robot report it."""
        for effect in overriding(trial.effects, "change_measured"):
            sensors = motion.sensors
            motion = replace(effect.change_measured(motion, trial.period_s, self.robot), sensors=sensors)
        return motion

    def replay_pieces(self, trials: Sequence[Rollout], starts: Sequence["Starts"], rows: int) -> list[list[Motion]]:
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
        self, trials: Sequence[Rollout], starts: Sequence["Starts"], rows: int
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
            out, read = mujoco.rollout.rollout(models, data, np.stack(states), batch_controls(controls))
            readings = [self._readings(*one) for one in zip(models, read, counts, strict=True)]
            pieces = zip(states, counts, out, readings, strict=True)
            for i in chosen:
                found[i] = [self._motion(trials[i], *next(pieces)) for _ in starts[i].rows]
        return [found[i] for i in range(len(trials))]

    def _restarts(
        self, trial: Rollout, starts: "Starts", rows: int
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
        for row, state, warm in zip(starts.rows, starts.states, warmth, strict=True):
            key = gains[row].tobytes()
            if key not in of_gains:
                of_gains[key] = self.model(trial, row=row)
            own = control[step[row] : step[row + rows - 1]]
            true = self.true_state(trial.effects, state)
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
        return self.measure(trial, self._of_robot(trial, piece, readings))

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

    def true_state(self, effects: Sequence[Effect], state: np.ndarray) -> np.ndarray:
        """The true state (nq + nv,) behind one that was reported."""
        nq = self.bare.nq
        start = Motion(state[None, :nq].copy(), state[None, nq:].copy())
        for effect in reversed(overriding(effects, "true_start")):
            start = effect.true_start(start, self.robot)
        return start.first_state

    def _same_kind(self, trials: Sequence[Rollout], rows: int, substeps: float) -> list[Motion]:
        """Replay trials of one structure, equally many rows and steps a row, batch by batch of constant gains."""
        gains = [joint_gains(t.log, self.robot)[:rows] for t in trials]
        # Rows 0 … rows−2 are each held for one period; the last row's command is not needed.
        switches = sorted(
            {0, rows - 1}.union(*(set((np.flatnonzero((g[1:-1] != g[:-2]).any(axis=1)) + 1).tolist()) for g in gains))
        )
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
            out, read = mujoco.rollout.rollout(
                models, data, np.stack([h[-1][-1] for h in history]), control, persistent_pool=True
            )
            for i, of_trial in enumerate(out):
                history[i].append(of_trial[np.cumsum(counts[i][start:end]) - 1])
                own = self._readings(models[i], read[i], counts[i][start:end])
                readings[i] += [] if own is None else [own[1 if readings[i] else 0 :]]
        wholes = [np.concatenate(h) for h in history]
        measured = [np.concatenate(r) if r else None for r in readings]
        return [self._of_robot(*of_trial) for of_trial in zip(trials, wholes, measured, strict=True)]

    def _warmth(self, trial: Rollout, rows: Sequence[int], steps: np.ndarray) -> Sequence[np.ndarray | None]:
        """Warmth of the motors, (joints,), at some rows of a trial's log, in which each row lasts so many steps."""
        drive = self.drive(trial)
        if not drive.heating.any():
            return [None] * len(rows)
        row_s = steps * trial.period_s / self.substeps(trial.log)
        row = np.arange(len(steps))
        load = self._load(trial, self._asked(trial, row, trial.period_s), row, limited=False)
        return list(drive.warmth(load.torque, row_s, rows))

    def full_state(
        self, trial: Rollout, model: mujoco.MjModel, control: np.ndarray, warmth: np.ndarray | None = None
    ) -> np.ndarray:
        """MuJoCo's full state: time, positions, velocities, and the states of motors that have one.

        The torque of a motor is the one that the first command asks for; friction with a memory is that of the motion.
        ``warmth`` is by how much the resistance of each joint's motor has risen, (joints,); None: not at all.
        """
        state = self.first_state(trial) if trial.first_state is None else trial.first_state
        activation = np.zeros(model.na)
        motors = [
            *enumerate(self.robot.joint_actuators.tolist()),
            *actuators.filtered_dampers(model, self.robot.joints),
        ]
        for joint, actuator in motors:
            warm = 0.0 if warmth is None or not actuators.has_temperature(model, actuator) else float(warmth[joint])
            if warm:
                activation[actuators.state_of_temperature(model, actuator)] = warm
            if actuators.has_current(model, actuator):
                kp, kd = (float(gain) for gain in actuators.dc_joint_pd(model, np.array(actuator)))
                q, v = state[self.robot.joint_qpos[joint]], state[self.bare.nq + self.robot.joint_dofs[joint]]
                asked = control[0, model.actuator_ctrladr[actuator]] - kp * q - kd * v
                limits = (
                    model.actuator_forcerange[actuator] if model.actuator_forcelimited[actuator] else (asked, asked)
                )
                activation[actuators.state_of_current(model, actuator)] = np.clip(asked / (1 + warm), *limits)
        if model.na:
            bristles, deflection = actuators.bristles_in_motion(model, state[self.bare.nq :])
            activation[bristles] = deflection
        return np.concatenate([[0.0], self.whole_state(trial, model, state, control), activation])

    def whole_state(
        self, trial: Rollout, model: mujoco.MjModel, state: np.ndarray, control: np.ndarray | None
    ) -> np.ndarray:
        """Positions and velocities of a model with what effects have added, from those of the robot (nq + nv,).

        Rotors are where they carry the torque of the first rows of controls (rows, actuators), as stiff joints would;
        None: where their joints are.
        """
        if model.nq == self.bare.nq:
            return state
        kp, kd = actuators.gains_of(model, self.robot.joint_actuators)
        carried = np.zeros((2, len(self.robot.joints)))
        if control is not None and any(effect.has_rotors for effect in trial.effects):
            stiff = self.model(replace(trial, effects=tuple(e for e in trial.effects if not e.has_rotors)))
            actuators.set_gains(stiff, self.robot.joint_actuators, kp, kd)
            steps = max(1, round(trial.period_s / stiff.opt.timestep))
            carried = carried_torque(stiff, self.robot, state, control, steps)
        return np.concatenate(rest_rotors(model, self.robot, state, carried, kp))

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

    def first_state(self, trial: Rollout) -> np.ndarray:
        """True positions and velocities at the log's first row, (nq + nv,), by what the log reports.

        What was not logged is fitted or estimated (``motion_of``); a floating robot needs its attitude.
        """
        measured = motion_of(trial.log, self.robot, slice(1)) if trial.measured is None else trial.measured
        return self.true_state(trial.effects, measured.first_state)

    def foot_depths(self, trial: Rollout) -> np.ndarray:
        """Penetration of each foot into the ground at the start, m, (feet,); 0 above it."""
        model = self.model(trial)
        data = mujoco.MjData(model)
        state = self.first_state(trial) if trial.first_state is None else trial.first_state
        nq, nv = self.bare.nq, self.bare.nv  # an effect may add bodies that move; they start where the model has them
        data.qpos[:nq], data.qvel[:nv] = state[:nq], state[nq:]
        mujoco.mj_forward(model, data)
        depth = np.zeros(len(self.robot.feet))
        for foot, name in enumerate(self.robot.foot_geom_names):
            geom = model.geom(name).id
            depth[foot] = max((-c.dist for c in data.contact if geom in c.geom), default=0.0)
        return depth.clip(min=0.0)

    def check_joints(self, log: Log) -> None:
        """Raise ``InputError`` for a log of another robot; it names the joints that differ.

        Only a robot whose model file says nothing of motors may have joints that the log does not command.
        """
        driven = self.robot.driven_joints
        missing, foreign = set(driven) - set(log.joints), set(log.joints) - set(driven)
        if not foreign and not self.robot.states_actuators:
            return
        passive = sorted(foreign & set(self.robot.joints))
        if passive and not missing and set(passive) == foreign:
            raise InputError(
                log.name,
                f"commands of {', '.join(passive)}",
                f"commands of {', '.join(driven)}: {self.robot.name} has no actuator at the other joints",
                "add the actuators to the model, or leave out the columns of the commands",
            )
        if missing or foreign:
            raise InputError(
                log.name,
                f"joints {', '.join(sorted(foreign)) or 'fewer'} and no {', '.join(sorted(missing)) or '–'}",
                f"the joints of {self.robot.name}: {', '.join(driven)}",
                "name the model these logs were made with, or rename the columns",
            )

    def substeps(self, log: Log) -> float:
        """Simulation steps of one control period of the log, a whole number unless rows last uneven whole ticks.

        Such rows are simulated in steps that are whole parts of the tick.
        """
        period, tick = log.info.sample_period_s, log.tick_s
        if tick is not None:
            return period / tick * max(1, int(np.ceil(tick / self.largest_step_s)))
        largest = self.largest_step_s if log.is_even else self.largest_step_s / UNEVEN_FINER
        return max(1, int(np.ceil(period / largest)))

    def row_steps(self, trial: Rollout) -> np.ndarray:
        """Simulation steps that each row of the log truly lasts, (rows,), to whole steps without drift."""
        lengths = trial.log.row_lengths
        for effect in overriding(trial.effects, "change_rows"):
            lengths = effect.change_rows(lengths)
        ends = np.round(np.cumsum(lengths) * self.substeps(trial.log)).astype(int)
        return np.maximum(np.diff(ends, prepend=0), 1)

    def _controls(self, trial: Rollout, rows: int) -> np.ndarray:
        """Controls of the affine actuators in the first rows of an even log, (rows, actuators)."""
        return self.row_controls(trial, np.arange(rows), trial.period_s)

    def _step_controls(self, trial: Rollout, steps: np.ndarray) -> np.ndarray:
        """Controls in every step of the first rows, which last ``steps`` (rows,) each.

        (steps, actuators). Commands reach the joints by rows of one length: those of the log where it is even, else
        the steps of the simulation.
        """
        if trial.log.is_even:
            return np.repeat(self._controls(trial, len(steps)), steps, axis=0)
        row = np.repeat(np.arange(len(steps)), steps)
        return self.row_controls(trial, row, trial.period_s / self.substeps(trial.log))

    def row_controls(self, trial: Rollout, row: np.ndarray, period_s: float) -> np.ndarray:
        """Controls τ + kp q* + kd q̇* in periods of equal length, (periods, actuators), by the gains of each row.

        ``row`` (periods,) is the row of the log whose command was sent in each.
        """
        model, asked = self._compiled(trial), self._asked(trial, row, period_s)
        control = np.zeros((len(row), model.nu))
        control[:, model.actuator_ctrladr[self.robot.joint_actuators]] = asked * self.drive(trial).control_gain
        by_load = overriding(trial.effects, "put_controls")
        if by_load:
            load = self._load(trial, asked, row)
            for effect in by_load:
                effect.put_controls(control, load, model, self.robot)
        return control

    def _asked(self, trial: Rollout, row: np.ndarray, period_s: float) -> np.ndarray:
        """Torque τ + kp q* + kd q̇* that is asked of the joints in periods of equal length, (periods, joints)."""
        log, robot = trial.log, self.robot
        torque, position, velocity = (joint_commands(log, robot, c)[row] for c in ("cmd_tau", "cmd_pos", "cmd_vel"))
        commands = Commands(torque, position, velocity, row)
        for effect in overriding(trial.effects, "change_commands"):
            commands = replace(effect.change_commands(commands, period_s, robot), row=row)
        kp, kd = (joint_commands(log, robot, gain)[row] for gain in ("cmd_kp", "cmd_kd"))
        asked = commands.torque + kp * commands.position + kd * commands.velocity
        for added in torques_by_velocity(trial, robot):
            asked = asked + added[row]
        return np.asarray(asked)

    def _load(self, trial: Rollout, asked: np.ndarray, row: np.ndarray, limited: bool = True) -> Load:
        """What the joints carry in periods of equal length, by the motion that the log reports.

        ``asked`` (periods, joints) is without the joint PD's feedback, which is that of the log's motion in its ``row``
        (periods,). Without ``limited`` the torque is what is asked for, whatever the motors can deliver.
        """
        log, robot = trial.log, self.robot
        measured = motion_of(log, robot) if trial.measured is None else trial.measured
        misread = (self.measure(trial, measured).qpos - measured.qpos)[:, robot.joint_qpos]  # biases of encoders
        position = (measured.qpos[:, robot.joint_qpos] - misread)[row]
        velocity = measured.qvel[row][:, robot.joint_dofs]
        kp, kd = (joint_commands(log, robot, gain)[row] for gain in ("cmd_kp", "cmd_kd"))
        torque = asked - kp * position - kd * velocity
        limits = robot.torque_limits if limited else np.inf
        return Load(
            np.clip(torque, -limits, limits) * self.drive(trial).gain, velocity, trial.period_s / self.substeps(log)
        )

    def drive(self, trial: Rollout) -> Drive:
        """Motors of the robot with the trial's effects."""
        drive = Drive.ideal(len(self.robot.joints))
        for effect in overriding(trial.effects, "change_drive"):
            drive = effect.change_drive(drive, self.robot)
        return drive

    def model(self, trial: Rollout, row: int = 0) -> mujoco.MjModel:
        """The trial's own model: terrain of the log, joint gains of a row, period, motors, then its effects."""
        log = trial.log
        model = copy.copy(self._compiled(trial))
        kp, kd = (joint_commands(log, self.robot, gain)[row] for gain in ("cmd_kp", "cmd_kd"))
        actuators.set_joint_pd(model, self.robot.joint_actuators, kp, kd)
        model.opt.timestep = trial.period_s / self.substeps(log)
        self.drive(trial).put_into(model, self.robot)
        for effect in overriding(trial.effects, "change_model"):
            effect.change_model(model, self.robot)
        put_loads(model, log, self.robot)
        return model

    def _compiled(self, trial: Rollout) -> mujoco.MjModel:
        """The bare robot on the log's terrain with the parts its effects need, compiled once and then shared."""
        terrain = trial.log.info.terrain
        if len(terrain) > self.slots:
            raise InputError(
                trial.log.name,
                f"{len(terrain)} boxes of terrain",
                f"at most {self.slots}",
                "make the replayer with more terrain slots",
            )
        key = (terrain, trial.structure)
        with self.compiling:
            if key not in self.compiled:
                spec = self.robot.spec_on_terrain(terrain, slots=self.slots)
                if self.sensors:
                    add_sensors(spec, self.robot, self.sensors)
                for effect in trial.effects:
                    if effect.structure is not None:
                        effect.change_spec(spec, self.robot)
                while len(self.compiled) >= MODELS_KEPT:
                    self.compiled.pop(next(iter(self.compiled)))
                self.compiled[key] = spec.compile()
                # The same dynamics a sixth faster: with so few joints MuJoCo would take dense matrices.
                self.compiled[key].opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
            return self.compiled[key]

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
