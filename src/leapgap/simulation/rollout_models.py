"""What the simulation of one replay needs: its model with all effects, its controls, and its first state."""

import copy
import threading
from collections.abc import Hashable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import mujoco
import numpy as np

from leapgap.effects.base import Commands, Effect, Load, constants_at_end, overrides, overriding
from leapgap.effects.drive import Drive
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot import actuators, dc_motors
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import add_sensors
from leapgap.robot.motion import Motion
from leapgap.robot.rotors import carried_torque, rest_rotors
from leapgap.robot.terrain import Box
from leapgap.simulation.rollout import LOAD, Rollout, joint_commands, put_loads, torques_by_velocity
from leapgap.simulation.working_models import WorkingModel, WorkingModels, without_warnings

LARGEST_STEP_S = 0.0011  # largest step of a robot that moves freely, s; contacts are known no better by longer ones
ROUNDING = 1.1  # a step may be longer by this factor, so that a period of whole steps is simulated in so many
UNEVEN_FINER, STEPS_OF_UNEVEN = 4, 8
"""Rows of uneven length last a whole number of steps: so many times finer ones, unless so many fit a row anyway."""
OF_MODELS = ("change_spec", "change_drive", "change_model")  # members of an effect by which it changes the model


def largest_step_of(robot: Robot) -> float:
    """Longest step in which a robot is simulated, s: that of its model file, as its owner simulates it."""
    own = ROUNDING * float(robot.model.opt.timestep)
    return min(LARGEST_STEP_S, own) if robot.has_free_base else own


def steps_of_row(log: Log, largest: float) -> float:
    """Steps of at most ``largest`` s of a control period of a log, as ``RolloutModels.substeps`` has them."""
    period, tick = log.info.sample_period_s, log.tick_s
    if tick is not None:
        return period / tick * max(1, int(np.ceil(tick / largest)))
    if not log.is_even:
        largest = max(largest / UNEVEN_FINER, min(largest, period / STEPS_OF_UNEVEN))
    return max(1, int(np.ceil(period / largest)))


def own_lag_s(log: Log, robot: Robot) -> float:
    """Time by which velocities of simulations of a log are behind their positions, s.

    Positions of a step follow from the velocity at its end, which is thus the mean of the step. RK4 has none.
    """
    if robot.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return 0.0
    return 0.5 * log.info.sample_period_s / steps_of_row(log, largest_step_of(robot))


class RolloutModels:
    """Models, controls and first states of rollouts on one robot; keeps compiled models between calls.

    ``terrain_slots`` boxes are in every model, so that logs on different terrain share one batch.
    """

    def __init__(
        self, robot: Robot, terrain_slots: int = 1, largest_step_s: float | None = None, sensors: Sequence[str] = ()
    ) -> None:
        self.robot, self.sensors = robot, tuple(sensors)
        self.largest_step_s = largest_step_of(robot) if largest_step_s is None else largest_step_s
        self.own_step_s = self.largest_step_s
        self.slots = terrain_slots
        self.bare = robot.on_terrain((), slots=terrain_slots)
        self.compiling = threading.Lock()
        self.specs: dict[tuple[Box, ...], mujoco.MjSpec] = {}
        self.working = WorkingModels()
        self.counts: dict[Hashable, tuple[int, int]] = {}  # What ``further_states`` has found

    def substeps(self, log: Log) -> float:
        """Simulation steps of one control period of the log, a whole number unless rows last uneven whole ticks.

        Such rows are simulated in steps that are whole parts of the tick.
        """
        return steps_of_row(log, self.largest_step_s)

    def row_steps(self, trial: Rollout) -> np.ndarray:
        """Simulation steps that each row of the log truly lasts, (rows,), to whole steps without drift."""
        lengths, acting = trial.log.row_lengths, overriding(trial.effects, "change_rows")
        if trial.log.is_even and not acting:
            return np.full(len(lengths), int(self.substeps(trial.log)))
        for effect in acting:
            lengths = effect.change_rows(lengths)
        ends = np.round(np.cumsum(lengths) * self.substeps(trial.log)).astype(int)
        return np.maximum(np.diff(ends, prepend=0), 1)

    def check_joints(self, log: Log) -> None:
        """Raise ``InputError`` for a log of another robot; it names the joints that differ.

        Only a robot whose model file says nothing of motors may have joints that the log does not command.
        """
        driven = self.robot.driven_joints
        if log.joints == driven:
            return
        missing, foreign = set(driven) - set(log.joints), set(log.joints) - set(driven)
        if not foreign and not self.robot.states_actuators:
            return
        passive = sorted(foreign & set(self.robot.joints))
        if passive and not missing and set(passive) == foreign:
            expected = f"commands of {', '.join(driven)}: {self.robot.name} has no actuator at the other joints"
            do = "add the actuators to the model, or leave out the columns of the commands"
            raise InputError(log.name, f"commands of {', '.join(passive)}", expected, do)
        if missing or foreign:
            found = f"joints {', '.join(sorted(foreign)) or 'fewer'} and no {', '.join(sorted(missing)) or '–'}"
            do = "name the model these logs were made with, or rename the columns"
            raise InputError(log.name, found, f"the joints of {self.robot.name}: {', '.join(driven)}", do)

    def model(self, trial: Rollout, row: int = 0) -> mujoco.MjModel:
        """The trial's own model: terrain of the log, joint gains of a row, period, motors, then its effects."""
        with self.working_model(trial, row) as working:
            return copy.copy(working.model)

    @contextmanager
    def working_model(self, trial: Rollout, row: int = 0) -> Iterator[WorkingModel]:
        """The same, with memory to simulate it, for the time of the block."""
        log = trial.log
        with self._lent(trial) as working:
            working.reset()
            model = working.model
            kp, kd = (joint_commands(log, self.robot, gain)[row] for gain in ("cmd_kp", "cmd_kd"))
            model.opt.timestep = trial.period_s / self.substeps(log)
            if overriding(trial.effects, "change_drive"):
                self.drive(trial).put_into(model, self.robot, kp, kd)
            else:
                actuators.set_joint_pd(model, self.robot.joint_actuators, kp, kd)
            with without_warnings(), constants_at_end(model, working.data):  # of bodies of nearly no inertia
                for effect in overriding(trial.effects, "change_model"):
                    effect.change_model(model, self.robot)
                put_loads(model, log, self.robot)
            yield working

    def further_states(self, trial: Rollout) -> tuple[int, int]:
        """Numbers of activations of a trial's model but torques and heat of motors, and of its positions."""
        key = trial.structure, tuple((type(effect), effect.location) for effect in trial.effects)
        if key not in self.counts:
            with self.working_model(trial) as working:
                model, motors = working.model, self.robot.joint_actuators
                told = [of(model, motors).sum() for of in (dc_motors.has_current, dc_motors.has_temperature)]
                self.counts[key] = int(model.na - sum(told)), int(model.nq)
        return self.counts[key]

    def alike(self, trial: Rollout, rows: Sequence[int]) -> list[Hashable]:
        """A key for each of some rows of a trial's log: models of equal keys are equal."""
        log = trial.log
        gains = [joint_commands(log, self.robot, gain)[rows] for gain in ("cmd_kp", "cmd_kd")]
        acting = tuple(e for e in trial.effects if any(overrides(type(e), method) for method in OF_MODELS))
        load = tuple(log.info.extra.get(LOAD, {}).items())
        of_trial = (log.info.terrain, trial.structure, trial.period_s / self.substeps(log), acting, load)
        return [(*of_trial, kp.tobytes(), kd.tobytes()) for kp, kd in zip(*gains, strict=True)]

    def _lent(self, trial: Rollout) -> AbstractContextManager[WorkingModel]:
        """A working model of the trial's terrain and structure, as another trial left it."""
        return self.working.lend((trial.log.info.terrain, trial.structure), lambda: self._compile(trial))

    def _compile(self, trial: Rollout) -> mujoco.MjModel:
        """The bare robot on the log's terrain with the parts its effects need."""
        terrain = trial.log.info.terrain
        if len(terrain) > self.slots:
            do = "make the replayer with more terrain slots"
            raise InputError(trial.log.name, f"{len(terrain)} boxes of terrain", f"at most {self.slots}", do)
        with self.compiling:
            if terrain not in self.specs:
                self.specs[terrain] = self.robot.spec_on_terrain(terrain, slots=self.slots)
            spec = self.specs[terrain].copy()
        if self.sensors:
            add_sensors(spec, self.robot, self.sensors)
        for effect in trial.effects:
            if effect.structure is not None:
                effect.change_spec(spec, self.robot)
        model = spec.compile()
        # The same dynamics a sixth faster: with so few joints MuJoCo would take dense matrices.
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        return model

    def drive(self, trial: Rollout) -> Drive:
        """Motors of the robot with the trial's effects."""
        drive = Drive.ideal(len(self.robot.joints))
        for effect in overriding(trial.effects, "change_drive"):
            drive = effect.change_drive(drive, self.robot)
        return drive

    def _controls(self, trial: Rollout, rows: int) -> np.ndarray:
        """Controls of the affine actuators in the first rows of an even log, (rows, actuators)."""
        return self.row_controls(trial, np.arange(rows), trial.period_s)

    def step_controls(self, trial: Rollout, steps: np.ndarray, at: np.ndarray | slice) -> np.ndarray:
        """Controls in some steps of the first rows, which last ``steps`` (rows,) each.

        (…, actuators), in the shape of ``at``. Commands reach the joints by rows of one length: those of the log where
        it is even, else the steps of the simulation.
        """
        row = np.repeat(np.arange(len(steps)), steps)
        if trial.log.is_even:
            return self.row_controls(trial, np.arange(len(steps)), trial.period_s, row[at])
        return self.row_controls(trial, row, trial.period_s / self.substeps(trial.log), at)

    def row_controls(
        self, trial: Rollout, row: np.ndarray, period_s: float, at: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Controls τ + kp q* + kd q̇* in some periods of equal length, (…, actuators), by the gains of each row.

        ``row`` (periods,) is the row of the log whose command was sent in each; ``at`` chooses among them.
        """
        by_load = overriding(trial.effects, "put_controls")
        asked = self._asked(trial, row, period_s, slice(None) if by_load else at)
        gain = self.drive(trial).control_gain if overriding(trial.effects, "change_drive") else 1.0
        with self._lent(trial) as working:
            model = working.model
            control = np.zeros((*asked.shape[:-1], model.nu))
            control[..., model.actuator_ctrladr[self.robot.joint_actuators]] = asked * gain
            if not by_load:
                return control
            working.reset()
            load = self._load(trial, asked, row)
            for effect in by_load:
                effect.put_controls(control, load, model, self.robot)
            return control[at]

    def _asked(
        self, trial: Rollout, row: np.ndarray, period_s: float, at: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Torque τ + kp q* + kd q̇* that is asked of the joints in some periods of equal length, (…, joints)."""
        log, robot = trial.log, self.robot
        acting, adding = overriding(trial.effects, "change_commands"), torques_by_velocity(trial, robot)
        if not (acting or adding):
            row, at = row[at], slice(None)
        torque, position, velocity, kp, kd = (
            joint_commands(log, robot, c)[row] for c in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
        )
        commands = Commands(torque, position, velocity, row)
        if not log.is_even:  # commands that are shifted in time no longer tell what each row sent
            acting.sort(key=lambda effect: effect.command_stage)
        for effect in acting:
            commands = replace(effect.change_commands(commands, period_s, robot), row=row)
        if overriding(trial.effects, "change_drive"):
            kp, kd = self.drive(trial).gains(kp, kd)
        asked = commands.torque + kp * commands.position + kd * commands.velocity
        for added in adding:
            asked = asked + added[row]
        return np.asarray(asked[at])

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
        sent = (joint_commands(trial.log, self.robot, gain)[row] for gain in ("cmd_kp", "cmd_kd"))
        drive = self.drive(trial)
        kp, kd = drive.gains(*sent)
        torque = asked - kp * position - kd * velocity
        limits = drive.torque_limits(robot) if limited else np.inf
        return Load(np.clip(torque, -limits, limits) * drive.gain, velocity, trial.period_s / self.substeps(log))

    def measure(self, trial: Rollout, motion: Motion, steps: np.ndarray | None = None) -> Motion:
        """A true motion as the sensors of the trial's robot report it.

        ``steps`` of the simulation lie between its rows, (rows − 1,); None: as from the log's first row on.
        """
        acting = overriding(trial.effects, "change_measured")
        if not acting:
            return motion
        sensors, time = motion.sensors, None
        if not trial.log.is_even:
            between = self.row_steps(trial)[: len(motion) - 1] if steps is None else steps
            time = np.concatenate([[0.0], np.cumsum(between)]) * (trial.period_s / self.substeps(trial.log))
        for effect in acting:
            timed = replace(motion, sensors=sensors, time=time)
            motion = effect.change_measured(timed, trial.period_s, self.robot)
        return replace(motion, sensors=sensors, time=None)

    def first_state(self, trial: Rollout) -> np.ndarray:
        """True positions and velocities at the log's first row, (nq + nv,), by what the log reports.

        What was not logged is fitted or estimated (``motion_of``); a floating robot needs its attitude.
        """
        measured = motion_of(trial.log, self.robot, slice(1)) if trial.measured is None else trial.measured
        return self.true_states(trial.effects, measured.first_state[None])[0]

    def true_states(
        self, effects: Sequence[Effect], states: np.ndarray, later: np.ndarray | None = None, later_s: float = 0.0
    ) -> np.ndarray:
        """True states behind those that were reported (starts, nq + nv), and behind those of ``later_s`` after them."""
        acting = overriding(effects, "true_start")
        if not acting:
            return states
        nq, found = self.bare.nq, []
        time = None if later is None else np.array([0.0, later_s])
        for both in states[:, None] if later is None else np.stack([states, later], axis=1):
            start = Motion(both[:, :nq].copy(), both[:, nq:].copy(), time=time)
            for effect in reversed(acting):
                start = effect.true_start(start, self.robot)
            found.append(start.first_state)
        return np.array(found).reshape(states.shape)

    def full_state(self, trial: Rollout, model: mujoco.MjModel, control: np.ndarray) -> np.ndarray:
        """MuJoCo's full state at the trial's first row, as ``full_states`` has it, under controls (rows, actuators)."""
        state = self.first_state(trial) if trial.first_state is None else trial.first_state
        return self.full_states(trial, model, state[None], control[None])[0]

    def full_states(
        self,
        trial: Rollout,
        model: mujoco.MjModel,
        states: np.ndarray,
        controls: np.ndarray,
        warmth: np.ndarray | None = None,
        lagged: np.ndarray | None = None,
    ) -> np.ndarray:
        """MuJoCo's full states: time, positions, velocities, and the states of motors that have one, (starts, values).

        Of true states (starts, nq + nv), under controls (starts, rows, actuators). The torque of a motor is the one
        that the first command asks for, or where it lags ``lagged``, N·m, (starts, joints), if that is known; friction
        with a memory is that of the motion. ``warmth`` is by how much the resistance of each joint's motor has risen,
        (starts, joints); None: not at all.
        """
        whole = self.whole_states(trial, model, states, controls)
        parts = [np.zeros((len(states), 1)), whole]
        if model.na:
            parts.append(self._activations(model, states, controls[:, 0], warmth, lagged))
        return np.concatenate(parts, axis=1)

    def _activations(
        self,
        model: mujoco.MjModel,
        states: np.ndarray,
        control: np.ndarray,
        warmth: np.ndarray | None,
        lagged: np.ndarray | None,
    ) -> np.ndarray:
        """States of the motors, (starts, activations), under the first controls (starts, actuators)."""
        found = np.zeros((len(states), model.na))
        late = dc_motors.filtered_dampers(model, self.robot.joints)
        joints = np.array([*range(len(self.robot.joints)), *(joint for joint, _ in late)])
        motors = np.array([*self.robot.joint_actuators, *(actuator for _, actuator in late)])
        warm = np.zeros((len(states), len(motors)))
        heated = dc_motors.has_temperature(model, motors)
        if warmth is not None:
            warm[:, heated] = warmth[:, joints[heated]]
        found[:, dc_motors.state_of_temperature(model, motors[heated])] = warm[:, heated]
        kp, kd = dc_motors.dc_joint_pd(model, motors)
        position = states[:, self.robot.joint_qpos[joints]]
        velocity = states[:, self.bare.nq + self.robot.joint_dofs[joints]]
        asked = control[:, model.actuator_ctrladr[motors]] - kp * position - kd * velocity
        limits = (
            np.where(model.actuator_forcelimited[motors], end, asked) for end in model.actuator_forcerange[motors].T
        )
        torque, lagging = np.clip(asked / (1 + warm), *limits), dc_motors.has_current(model, motors)
        if lagged is not None:
            torque[:, : lagged.shape[1]] = lagged
        found[:, dc_motors.state_of_current(model, motors[lagging])] = torque[:, lagging]
        bristles, deflection = dc_motors.bristles_in_motion(model, states[:, self.bare.nq :])
        found[:, bristles] = deflection
        return found

    def warmth(self, trial: Rollout, rows: Sequence[int], steps: np.ndarray) -> np.ndarray | None:
        """Warmth of the motors at some rows of a trial's log, in which each row lasts so many steps.

        (chosen rows, joints); None where no motor heats.
        """
        drive = self.drive(trial) if overriding(trial.effects, "change_drive") else None
        if drive is None or not drive.heating.any():
            return None
        return drive.warmth(*self._torque_of_rows(trial, steps), rows)

    def lagged_torque(self, trial: Rollout, rows: Sequence[int], steps: np.ndarray) -> np.ndarray | None:
        """Torque that motors give at the beginning of some rows of such a log, N·m, (chosen rows, joints).

        None where no motor lags.
        """
        drive = self.drive(trial) if overriding(trial.effects, "change_drive") else None
        if drive is None or not drive.lag_s.any():
            return None
        return drive.lagged(*self._torque_of_rows(trial, steps), rows)

    def _torque_of_rows(self, trial: Rollout, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torque that is asked in rows of a log that last so many steps, (rows, joints), and their lengths, s."""
        row_s = steps * trial.period_s / self.substeps(trial.log)
        row = np.arange(len(steps))
        return self._load(trial, self._asked(trial, row, trial.period_s), row, limited=False).torque, row_s

    def whole_states(
        self, trial: Rollout, model: mujoco.MjModel, states: np.ndarray, controls: np.ndarray | None
    ) -> np.ndarray:
        """Positions and velocities of a model with what effects have added, from those of the robot (starts, nq + nv).

        Rotors are where they carry the torque of the first rows of controls (starts, rows, actuators), as stiff joints
        would; None: where their joints are.
        """
        if model.nq == self.bare.nq:
            return states
        kp, kd = dc_motors.gains_of(model, self.robot.joint_actuators)
        carried = np.zeros((len(states), 2, len(self.robot.joints)))
        if controls is not None and any(effect.has_rotors for effect in trial.effects):
            stiff = self.model(replace(trial, effects=tuple(e for e in trial.effects if not e.has_rotors)))
            dc_motors.set_gains(stiff, self.robot.joint_actuators, kp, kd)
            steps = max(1, round(trial.period_s / stiff.opt.timestep))
            with without_warnings():
                carried = carried_torque(stiff, self.robot, states, controls, steps)
        return rest_rotors(model, self.robot, states, carried, kp)

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
