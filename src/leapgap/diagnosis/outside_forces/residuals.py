"""Forces that the motions needed and the model does not have: of each joint, and of a free base.

Where nothing is touched they follow from inverse dynamics. What the masses, inertias, friction and delays of the model
may be wrong by is fitted to all logs together and taken away. Where feet or other parts touch something, short replays
tell them: the momentum that a replay of 20 ms lacks at its end, divided by that time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.diagnosis.outside_forces.model_errors import (
    BODY_NUMBERS,
    Instants,
    ModelErrors,
    heavy_bodies,
    inverse_dynamics,
    without_constraints,
)
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.logs.log import Log
from leapgap.logs.state import States, motor_torques
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, TWIST_SLICE, VELOCITY_SLICE
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import LOAD, Rollout, put_loads

EVERY_S, MOST_EVALUATIONS = 0.01, 150_000
"""Forces are computed at this interval, or at a longer one that needs no more inverse dynamics of all logs together."""
WINDOW_S, WINDOW_ROWS = 0.06, 7
"""Positions, velocities and torques are those of parabolas over this time, or over so many rows."""
AT_STOP = 0.005  # A joint is at a stop where it is nearer to the end of its range than this share of it
REPLAY_S = 0.02  # Length of the replays that stand in place of inverse dynamics where something is touched


@dataclass(frozen=True)
class Residual:
    """Forces of one log that the model does not have."""

    time: np.ndarray  # s, (instants,), evenly spaced
    force: np.ndarray
    """N or N·m, (instants, nv), in MuJoCo's axes: of a free base along the world's axes, about the base's."""
    state: np.ndarray
    """Positions, velocities and torques, each divided by its spread over all logs, (instants, columns)."""
    quiet: np.ndarray  # Instants in which no force from outside is known to act, bool, (instants,)

    @property
    def every_s(self) -> float:
        """Time from one instant to the next, s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class Residuals:
    """Forces of all logs that the model does not have."""

    of_logs: tuple[Residual, ...]
    scale: np.ndarray
    """Root mean square of the forces that the motions need, or that the motors gave where those are larger.

    There is one for each degree of freedom that is searched for pushes.

    Where there is a free base, they are its own alone: what legs lack while feet slip or stick is no push. Its forces
    have one scale; its moments have that of forces at the robot's radius of gyration.
    """
    friction: np.ndarray  # Dry friction of the same degrees of freedom, as the logs show it; it is never quite constant


Pushed = Sequence[Sequence[tuple[float, float]]]
"""Begin and end of the moments of each log in which a force from outside is known to act, s."""


@dataclass(frozen=True)
class ByInverseDynamics:
    """By inverse dynamics of smoothed motions, without what a wrong model explains in all logs together."""

    errors: ModelErrors
    at_stop: tuple[np.ndarray, ...]
    """Where a joint is at a stop of the model, by log: −1 at the lower one, 1 at the upper one, (instants, nv)."""

    @staticmethod
    def of(states: Sequence[States], robot: Robot) -> "ByInverseDynamics":
        """Torques that the motions of some logs need."""
        model, every_s = without_constraints(robot.on_terrain(())), spacing(states, robot)
        motions = [without_loads(instants_of(of, robot, every_s), of.log, robot) for of in states]
        return ByInverseDynamics(ModelErrors.of(model, motions), tuple(stops(of.qpos, robot) for of in motions))

    def residuals(self, pushed: Pushed) -> Residuals:
        """Forces that the model lacks, where the moments of known forces are not fitted."""
        motions = self.errors.motions
        quiet = [quiet_rows(of.time, moments) for of, moments in zip(motions, pushed, strict=True)]
        needed, given = (np.concatenate(of) for of in (self.errors.needed, [of.torque for of in motions]))
        scale = np.sqrt(np.maximum(np.mean(needed**2, axis=0), np.mean(given**2, axis=0)))
        rows = [np.concatenate([of.qpos, of.qvel, of.torque], axis=1) for of in motions]
        left, friction = self.errors.unexplained(quiet)
        # A stop of the model pushes back from its side.
        forces = [np.where(force * at < 0, 0.0, force) for force, at in zip(left, self.at_stop, strict=True)]
        return Residuals(together([of.time for of in motions], forces, rows, quiet), scale, friction)


def without_loads(motion: Instants, log: Log, robot: Robot) -> Instants:
    """The motion with the torque that is left for the robot itself beside the known loads of its log."""
    if LOAD not in log.info.extra:
        return motion
    loaded = robot.model.__copy__()
    put_loads(loaded, log, robot)
    bare, whole = (inverse_dynamics(without_constraints(model), motion) for model in (robot.model, loaded))
    return replace(motion, torque=motion.torque - (whole - bare))


@dataclass(frozen=True)
class ByReplay:
    """By replays of ``REPLAY_S``: momentum that they lack at their end, divided by that time."""

    times: tuple[np.ndarray, ...]
    forces: tuple[np.ndarray, ...]
    rows: tuple[np.ndarray, ...]
    scale: np.ndarray

    def residuals(self, pushed: Pushed) -> Residuals:
        """Forces that the model lacks; moments of known forces are compared with nothing."""
        quiet = [quiet_rows(time, moments) for time, moments in zip(self.times, pushed, strict=True)]
        return Residuals(together(self.times, self.forces, self.rows, quiet), self.scale, np.zeros_like(self.scale))

    @staticmethod
    def of(states: Sequence[States], robot: Robot, replayer: Replayer) -> "ByReplay":
        """Replay all logs by the nominal robot."""
        times, forces, rows, needed = [], [], [], []
        for of in states:
            log, length = of.log, max(1, of.log.info.rows(REPLAY_S))
            begins = list(range(0, len(log), length))
            starts, _ = smooth_starts(of.motion, begins, log, robot)
            some = starts.chosen(range(len(begins) - 1))
            (motions,) = replayer.replay_pieces([Rollout(log, measured=of.motion)], [some], length + 1)
            qpos, qvel = np.split(starts.states, [robot.model.nq], axis=1)
            ends = np.array([motion.qvel[-1] for motion in motions])
            span = np.diff(log.time[begins])[:, None]
            lacking = np.nan_to_num((qvel[1:] - ends) / span, posinf=0.0, neginf=0.0)  # a replay may diverge
            forces.append(momentum(robot.model, qpos[:-1], lacking))
            changes = momentum(robot.model, qpos[:-1], np.diff(qvel, axis=0) / span)
            needed.append(changes + weight(robot.model, qpos[:-1]))
            torque = motor_torques(log, robot, of.motion)[begins[:-1]]
            times.append((log.time[begins[:-1]] + log.time[begins[1:]]) / 2)
            rows.append(np.concatenate([qpos[:-1], qvel[:-1], torque], axis=1))
        scale = np.sqrt(np.mean(np.concatenate(needed) ** 2, axis=0))
        if robot.has_free_base:
            scale[VELOCITY_SLICE] = scale[VELOCITY_SLICE].max()
            scale[ANGULAR_VELOCITY_SLICE] = scale[0] * radius_of_gyration(robot.model)
            scale = scale[TWIST_SLICE]
        return ByReplay(tuple(times), tuple(forces), tuple(rows), scale)


def measure(states: Sequence[States], robot: Robot, replayer: Replayer) -> ByInverseDynamics | ByReplay:
    """What tells the forces that the model lacks in some logs."""
    if robot.has_free_base or robot.model.neq or any(touches(of, robot) for of in states):
        return ByReplay.of(states, robot, replayer)
    return ByInverseDynamics.of(states, robot)


def touches(states: States, robot: Robot) -> bool:
    """Whether anything of the model touches anything in a tenth of the rows of a log, spread evenly."""
    data = mujoco.MjData(robot.model)
    for pose in states.motion.qpos[::10]:
        data.qpos[:] = pose
        mujoco.mj_kinematics(robot.model, data)
        mujoco.mj_collision(robot.model, data)
        if data.ncon:
            return True
    return False


def stops(qpos: np.ndarray, robot: Robot) -> np.ndarray:
    """Which joints are at the lower (−1) or upper (1) end of their range in some poses, (poses, nv); 0 elsewhere."""
    model, found = robot.model, np.zeros((len(qpos), robot.model.nv))
    for joint in np.flatnonzero(model.jnt_limited):
        low, high = model.jnt_range[joint]
        pose, near = qpos[:, model.jnt_qposadr[joint]], AT_STOP * (high - low)
        found[:, model.jnt_dofadr[joint]] = (pose > high - near).astype(float) - (pose < low + near)
    return found


def quiet_rows(time: np.ndarray, moments: Sequence[tuple[float, float]]) -> np.ndarray:
    """Instants outside of some moments, bool, (instants,)."""
    quiet = np.ones(len(time), bool)
    for begin_s, end_s in moments:
        quiet &= (time < begin_s) | (time > end_s)
    return quiet


def together(
    times: Sequence[np.ndarray],
    forces: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    quiet: Sequence[np.ndarray],
) -> tuple[Residual, ...]:
    """Residuals of all logs, with states divided by their spread; a column that never changes is left out."""
    spread = np.concatenate(list(rows)).std(axis=0)
    moves = spread > 1e-9
    return tuple(
        Residual(time, force, of[:, moves] / spread[moves], own)
        for time, force, of, own in zip(times, forces, rows, quiet, strict=True)
    )


def spacing(states: Sequence[States], robot: Robot) -> float:
    """Time between the instants at which forces are computed, s."""
    duration = sum(float(of.log.time[-1] - of.log.time[0]) for of in states)
    models = 1 + BODY_NUMBERS * len(heavy_bodies(robot.model))
    return max(EVERY_S, duration * models / MOST_EVALUATIONS, *(of.log.info.sample_period_s for of in states))


def instants_of(states: States, robot: Robot, every_s: float) -> Instants:
    """The smoothed motion of a log; its ends are left out, where no window fits."""
    log, motion = states.log, states.motion
    window_s = max(WINDOW_S, WINDOW_ROWS * log.info.sample_period_s)
    at = np.arange(log.time[0] + window_s / 2, log.time[-1] - window_s / 2, every_s)
    columns = np.concatenate([motion.qpos, motion.qvel, motor_torques(log, robot, motion)], axis=1)
    value, slope = local_parabolas(log.time, columns, at, window_s)
    nq, nv = robot.model.nq, robot.model.nv
    qpos, qvel, torque = np.split(value, [nq, nq + nv], axis=1)
    return Instants(at, qpos, qvel, slope[:, nq : nq + nv], torque, slope[:, nq + nv :])


def local_parabolas(
    time: np.ndarray, columns: np.ndarray, at: np.ndarray, window_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Value and slope, (instants, columns) each, of the parabolas that fit the rows about some instants best."""
    first, last = (np.searchsorted(time, at + side * window_s / 2 * (1 + 1e-9)) for side in (-1, 1))
    value, slope = np.empty((len(at), columns.shape[1])), np.empty((len(at), columns.shape[1]))
    for k, (begin, end) in enumerate(zip(first, last, strict=True)):
        begin, end = max(0, min(begin, end - 4)), max(end, min(begin + 4, len(time)))
        weights = np.linalg.pinv(np.vander(time[begin:end] - at[k], 3, increasing=True))
        value[k], slope[k] = weights[:2] @ columns[begin:end]
    return value, slope


def momentum(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Generalised momentum of velocities at some poses, (poses, nv)."""
    data, found = mujoco.MjData(model), np.empty_like(qvel)
    for k, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_mulM(model, data, found[k], qvel[k])
    return found


def weight(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Forces that hold a robot against gravity at some poses, (poses, nv)."""
    data, found = mujoco.MjData(model), np.empty((len(qpos), model.nv))
    for k, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_rne(model, data, 0, found[k])
    return found


def radius_of_gyration(model: mujoco.MjModel) -> float:
    """Largest radius of gyration of a robot with a free base about its base, in the pose of its model file, m."""
    data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fullM(model, data, inertia)
    about_base = np.diag(inertia)[ANGULAR_VELOCITY_SLICE]
    return float(np.sqrt(about_base.max() / inertia[0, 0]))
