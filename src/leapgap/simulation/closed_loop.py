"""Closed-loop simulation: a controller sends commands to simulated hardware, one control tick after the other.

The same robot, effects and drive as in a replay, whose commands are known beforehand: replaying the log of a closed
loop from its true start gives the same motion.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from leapgap.effects.base import Commands, Effect, Load, overriding
from leapgap.logs.log import Log
from leapgap.logs.schema import COMMANDS, PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion
from leapgap.simulation.controller import Command, Controller, StateEstimate
from leapgap.simulation.open_loop import PreparedRun, log_of
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import NoiseRows, SensorNoise


@dataclass(frozen=True)
class Disturbance:
    """One action on the base of a robot that faces along the world's x axis."""

    begin_s: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Sudden change of forward velocity and of upward velocity, m/s, and of pitch rate, rad/s, at ``begin_s``."""
    force_n: tuple[float, float] = (0.0, 0.0)  # forward and upward, on the base's centre of mass from ``begin_s`` on
    duration_s: float = 0.0  # how long the force lasts

    def __str__(self) -> str:
        """Its parts that are not zero, with units, and when: ``+0.2 m/s at 0.3 s``, ``-45 N from 0.3 to 0.4 s``."""
        names = ("m/s", "m/s upward", "rad/s")
        kicks = [f"{value:+g} {name}" for value, name in zip(self.velocity, names, strict=True) if value]
        pushes = [f"{value:+g} {name}" for value, name in zip(self.force_n, ("N", "N upward"), strict=True) if value]
        said = [f"{', '.join(kicks)} at {self.begin_s:g} s"] if kicks else []
        said += [f"{', '.join(pushes)} from {self.begin_s:g} to {self.begin_s + self.duration_s:g} s"] if pushes else []
        return ", ".join(said)


def disturb(
    model: mujoco.MjModel, data: mujoco.MjData, base: int, actions: Sequence[Disturbance], time_s: float
) -> None:
    """Apply to a free base what acts from ``time_s`` until the next step of the simulation."""
    half = model.opt.timestep / 2
    force = np.zeros(3)
    for action in actions:
        if abs(time_s - action.begin_s) < half:
            forward, up, pitch_rate = action.velocity
            data.qvel[[0, 2]] += forward, up
            data.qvel[ANGULAR_VELOCITY_SLICE][1] += pitch_rate
        if -half <= time_s - action.begin_s < action.duration_s - half:
            force[[0, 2]] += action.force_n
    data.xfrc_applied[base, :3] = force


ROUNDING = 1e-6  # tolerance on a number of control periods, so that rounding does not add one to a whole number
ROOM = 8  # space for commands that were sent, in histories
MEMORY_S = 0.063  # least history that effects with a memory (delay, latency) see, s; see ``Effect.memory_s``


@dataclass(frozen=True)
class Sensing:
    """Measurements that the controller gets: those of the log, with the state of the base delayed."""

    noise: SensorNoise = field(default_factory=SensorNoise)
    base_delay_s: float = 0.002  # delay from a measurement of the base to the controller; joint measurements have none


@dataclass(frozen=True)
class ClosedLoopRun:
    """Result of one run: the log and the true motion."""

    log: Log
    truth: Motion
    touching: np.ndarray  # whether each foot touches at each row, bool, (rows, feet)
    ground_force: np.ndarray  # true force of the ground on each foot at each row, world axes, N, (rows, feet, 3)


class Plant:
    """One simulated robot with its effects on its terrain, stepped one control period at a time."""

    def __init__(self, replayer: Replayer, ready: PreparedRun, effects: tuple[Effect, ...]) -> None:
        self.trial = Rollout(ready.commanded, effects, first_state=ready.start)
        self.robot, self.replayer = replayer.robot, replayer
        self.nq, self.nv = self.robot.model.nq, self.robot.model.nv
        self.joint_controls = as_slice(self.robot.joint_actuators)
        self.model = replayer.model(self.trial)
        self.data = mujoco.MjData(self.model)
        self.substeps = replayer.substeps(ready.commanded)
        self.drive = replayer.drive(self.trial)
        self.control_gain = self.drive.control_gain
        self.period_s = self.trial.period_s
        self.effects_of_commands = overriding(effects, "change_commands")
        self.effects_of_sensors = overriding(effects, "change_measured")
        self.effects_by_velocity = overriding(effects, "torque_by_velocity")
        self.effects_by_load = overriding(effects, "put_controls")
        self.foot_of_geom = np.full(self.model.ngeom, -1)
        geoms = [self.model.geom(name).id for name in self.robot.foot_geom_names]
        self.foot_of_geom[geoms] = np.arange(len(geoms))
        (start,) = replayer.whole_states(self.trial, self.model, ready.start[None], None)
        self.data.qpos[:], self.data.qvel[:] = np.split(start, [self.model.nq])
        mujoco.mj_forward(self.model, self.data)  # contacts of the first tick
        self.gains: tuple[bytes, bytes] | None = None
        self.truth: list[tuple[np.ndarray, np.ndarray]] = [self.state]
        self.sent: list[Command] = []
        self.kept: tuple[np.ndarray, ...] = ()
        """Torques, positions and velocities that were sent, the first of all held before them, (ticks, joints) each."""
        self.kept_ticks = 0  # rows of them that are filled
        memory_s = max([MEMORY_S, *(effect.memory_s for effect in overriding(effects, "memory_s"))])
        self.memory = 1 + math.ceil(memory_s / self.period_s - ROUNDING)
        """Ticks from the oldest one that still counts to the newest."""

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """True positions and velocities now."""
        return self.data.qpos[: self.nq].copy(), self.data.qvel[: self.nv].copy()

    def measure(self) -> Motion:
        """The newest row as the robot's sensors report it, without noise, one row."""
        if not self.effects_of_sensors:
            qpos, qvel = self.truth[-1]
            return Motion(qpos[None], qvel[None])
        rows = self.truth[-self.memory :]
        motion = Motion(*(np.array(part) for part in zip(*rows, strict=True)))
        for effect in self.effects_of_sensors:
            motion = effect.change_measured(motion, self.period_s, self.robot)
        return Motion(motion.qpos[-1:], motion.qvel[-1:])

    def feel_ground(self) -> tuple[np.ndarray, np.ndarray]:
        """Whether each foot touches now, bool, (feet,), and the force of the ground on it during the last substep.

        Forces in world axes, N, (feet, 3).
        """
        feet = len(self.robot.feet)
        touching, force, wrench = np.zeros(feet, dtype=bool), np.zeros((feet, 3)), np.zeros(6)
        if not self.data.ncon:
            return touching, force
        contact = self.data.contact  # each of its fields is put together anew where it is asked for
        frames, along = contact.frame.reshape(-1, 3, 3), wrench[:3]
        for number, (first, second) in enumerate(self.foot_of_geom[contact.geom].tolist()):
            if first < 0 and second < 0:
                continue
            mujoco.mj_contactForce(self.model, self.data, number, wrench)
            if first >= 0:
                touching[first] = True
                force[first] += -along @ frames[number]
            if second >= 0:  # MuJoCo's force acts on the second geom
                touching[second] = True
                force[second] += along @ frames[number]
        return touching, force

    def send(self, command: Command) -> None:
        """Apply a command for one control period."""
        self.sent.append(command)
        gains = command.kp.tobytes(), command.kd.tobytes()  # compared in a tenth of the time of the arrays
        if gains != self.gains:
            self.drive.set_joint_pd(self.model, self.robot, command.kp, command.kd)
            self.gains = gains
        commands, (kp, kd) = self._arriving(), self.drive.gains(command.kp, command.kd)
        control = commands.torque[-1] + kp * commands.position[-1] + kd * commands.velocity[-1]
        for effect in self.effects_by_velocity:
            added = effect.torque_by_velocity(self.data.qvel[None, self.robot.joint_dofs], self.robot)
            control = control if added is None else control + added[0]
        self.data.ctrl[self.joint_controls] = control * self.control_gain
        if self.effects_by_load:
            load = self._load(control, command)
            for effect in self.effects_by_load:
                effect.put_controls(self.data.ctrl[None], load, self.model, self.robot)
        if len(self.truth) == 1:
            # Let motors with a state of their own start at what is asked of them first
            model, ends = self.model, np.cumsum([1, self.model.nq, self.model.nv])
            if model.na or model.nq > self.robot.model.nq:
                start = self.replayer.full_state(self.trial, model, self.data.ctrl[None])
                _, self.data.qpos[:], self.data.qvel[:], self.data.act[:] = np.split(start, ends)
        mujoco.mj_step(self.model, self.data, self.substeps)
        self.truth.append(self.state)

    def _load(self, control: np.ndarray, command: Command) -> Load:
        """What the joints carry now, under a control (joints,) and the gains of a command."""
        position, velocity = self.data.qpos[self.robot.joint_qpos], self.data.qvel[self.robot.joint_dofs]
        limits, (kp, kd) = self.drive.torque_limits(self.robot), self.drive.gains(command.kp, command.kd)
        torque = np.clip(control - kp * position - kd * velocity, -limits, limits) * self.drive.gain
        return Load(torque[None], velocity[None], float(self.model.opt.timestep))

    def _arriving(self) -> Commands:
        """The newest commands as they reach the joints."""
        sent = self.sent[-1]
        rows = (sent.torque, sent.position, sent.velocity)
        if not self.effects_of_commands:
            return Commands(*(row[None] for row in rows))
        commands, (*first, last) = self._keep(rows), self.effects_of_commands
        for effect in first:
            commands = effect.change_commands(commands, self.period_s, self.robot)
        return last.change_newest_commands(commands, self.period_s, self.robot)

    def _keep(self, rows: tuple[np.ndarray, ...]) -> Commands:
        """Commands of the last ``memory`` ticks with these as the newest; the first of all held before them.

        They are written one after the other and moved to the front when there is no room left, not at every tick.
        """
        if not self.kept:
            self.kept = tuple(np.repeat(row[None], ROOM * self.memory, axis=0) for row in rows)
            self.kept_ticks = self.memory - 1
        elif self.kept_ticks == ROOM * self.memory:
            for known in self.kept:
                known[: self.memory - 1] = known[1 - self.memory :]
            self.kept_ticks = self.memory - 1
        for known, row in zip(self.kept, rows, strict=True):
            known[self.kept_ticks] = row
        self.kept_ticks += 1
        return Commands(*(known[self.kept_ticks - self.memory : self.kept_ticks] for known in self.kept))


def as_slice(indices: np.ndarray) -> "slice | np.ndarray":
    """Indices that follow each other as a slice, with which arrays are read and written in a tenth of the time."""
    first, count = int(indices[0]), len(indices)
    return slice(first, first + count) if np.array_equal(indices, np.arange(first, first + count)) else indices


def run_closed_loop(
    ready: PreparedRun,
    controller: Controller,
    replayer: Replayer,
    effects: tuple[Effect, ...],
    sensing: Sensing,
    rng: np.random.Generator,
    disturbances: Sequence[Disturbance] = (),
    disturbed_from: Callable[[], float | None] = lambda: 0.0,
) -> ClosedLoopRun:
    """Run a controller for as many rows as the prepared commands have.

    ``disturbed_from`` gives the time from which the times of ``disturbances`` count, s since the first row; None: it is
    not known yet.
    """
    robot, rows, period = replayer.robot, len(ready.commanded), ready.commanded.info.sample_period_s
    errors = NoiseRows.draw(sensing.noise, rows, len(robot.joints), rng)
    late = round(sensing.base_delay_s / period)
    plant = Plant(replayer, ready, effects)
    measure, estimate = errors.by_tick(robot), estimates(robot)
    measured: list[Motion] = []
    touching: list[np.ndarray] = []
    force: list[np.ndarray] = []
    for row in range(rows):
        measured.append(measure(plant.measure(), row))
        for kept, now in zip((touching, force), plant.feel_ground(), strict=True):
            kept.append(now)
        of_base = measured[max(0, row - late)]
        command = controller.command(estimate(row * period, of_base, measured[row], touching[row]))
        since = disturbed_from() if disturbances else None
        if since is not None:
            disturb(plant.model, plant.data, robot.base_body, disturbances, row * period - since)
        plant.send(command)
    measured_motion = Motion(np.concatenate([m.qpos for m in measured]), np.concatenate([m.qvel for m in measured]))
    truth = Motion(*(np.array(part) for part in zip(*plant.truth[:rows], strict=True)))
    log = log_of(ready.plan.name, with_commands(ready.commanded, plant.sent, robot), measured_motion, robot)
    return ClosedLoopRun(log, truth, np.array(touching), np.array(force))


def estimates(robot: Robot) -> Callable[[float, Motion, Motion, np.ndarray], StateEstimate]:
    """The function from a time, a measured row for the base, one for the joints, and touching feet to an estimate."""
    positions, velocities = as_slice(robot.joint_qpos), as_slice(robot.joint_dofs)

    def estimate(time_s: float, of_base: Motion, of_joints: Motion, touching: np.ndarray) -> StateEstimate:
        qpos, qvel = of_base.qpos[0], of_base.qvel[0]
        return StateEstimate(
            time_s,
            qpos[POSITION_SLICE],
            qpos[QUATERNION_SLICE],
            qvel[VELOCITY_SLICE],
            qvel[ANGULAR_VELOCITY_SLICE],
            of_joints.qpos[0, positions].copy(),
            of_joints.qvel[0, velocities].copy(),
            touching,
        )

    return estimate


def with_commands(commanded: Log, sent: list[Command], robot: Robot) -> Log:
    """The log with the commands that were sent, and the planned ground forces behind them."""
    columns = {"time": commanded.time}
    for quantity, name in zip(COMMANDS, ("torque", "position", "velocity", "kp", "kd"), strict=True):
        values = np.array([getattr(command, name) for command in sent])
        columns |= {f"{quantity}/{joint}": values[:, i] for i, joint in enumerate(robot.joints)}
    force = np.array([c.planned_force for c in sent])
    columns |= {f"mpc_force/{axis}": force[:, i] for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(commanded, columns=columns)
