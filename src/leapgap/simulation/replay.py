"""Open-loop replay: the log's own commands, from its first state, in the simulated robot.

The joint PD is the affine part of MuJoCo's actuators and the commands are their controls, so that whole jumps roll
out without a Python loop, many at once on all cores, bit-identical at any number of threads.
"""

import copy
import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import mujoco.rollout
import numpy as np

from leapgap.effects.base import Commands, Effect
from leapgap.errors import InputError
from leapgap.recording.jump import (
    BASE_ANGULAR_VELOCITY,
    BASE_POSITION,
    BASE_QUATERNION,
    BASE_VELOCITY,
    Jump,
)
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box

LARGEST_STEP_S = 0.0011
"""A control period longer than this is simulated in several equal steps."""
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True)
class Trial:
    """One replay: a log, and the effects to add to the nominal robot."""

    jump: Jump
    effects: tuple[Effect, ...] = ()
    first_state: np.ndarray | None = None
    """(nq + nv,): start from here instead of the log's first row."""


@dataclass(frozen=True)
class Motion:
    """What the simulated robot did: rows at the log's times, SI units, world frame."""

    qpos: np.ndarray
    """(rows, nq): base position and quaternion w x y z (free base), joint positions."""
    qvel: np.ndarray
    """(rows, nv): base velocity in world, angular velocity in base axes (free base), joint velocities."""


class Replayer:
    """Replays logs on one robot; keeps compiled models and threads between calls.

    ``terrain_slots`` boxes are in every model, so that jumps over different terrain share one batch.
    """

    def __init__(self, robot: Robot, terrain_slots: int = 1, threads: int | None = None) -> None:
        self.robot = robot
        self.slots = terrain_slots
        self.bare = robot.on_terrain((), slots=terrain_slots)
        self.data = [mujoco.MjData(self.bare) for _ in range(threads or os.cpu_count() or 1)]
        self.compiled: dict[tuple[Box, ...], mujoco.MjModel] = {}

    def motions(self, trials: Sequence[Trial], rows: int | None = None) -> list[Motion]:
        """Replay every trial over the first ``rows`` rows of its log (all, where it is None).

        Trials whose gains change on the way go on in the robot with the new gains.
        """
        for trial in trials:
            self.check_joints(trial.jump)
        shapes = [(min(len(t.jump), rows or len(t.jump)), self._substeps(t.jump)) for t in trials]
        motions: dict[int, Motion] = {}
        for shape in sorted(set(shapes)):
            chosen = [i for i, own in enumerate(shapes) if own == shape]
            motions |= zip(chosen, self._same_shape([trials[i] for i in chosen], *shape), strict=True)
        return [motions[i] for i in range(len(trials))]

    def _same_shape(self, trials: Sequence[Trial], rows: int, substeps: int) -> list[Motion]:
        """Replay trials of equally many rows and steps a row, batch by batch of constant gains."""
        gains = [
            np.concatenate(
                [
                    t.jump.per_joint("cmd_kp", self.robot.joints)[:rows],
                    t.jump.per_joint("cmd_kd", self.robot.joints)[:rows],
                ],
                axis=1,
            )
            for t in trials
        ]
        # Rows 0 … rows−2 are each held for one period; the last row's command is not needed.
        switches = sorted(
            {0, rows - 1}.union(*(set((np.flatnonzero((g[1:-1] != g[:-2]).any(axis=1)) + 1).tolist()) for g in gains))
        )
        controls = [self._controls(trial, rows) for trial in trials]
        states = [
            np.concatenate([[0.0], self.first_state(t) if t.first_state is None else t.first_state]) for t in trials
        ]
        history = [[state[None]] for state in states]
        for start, end in itertools.pairwise(switches):
            models = [self.model(trial, row=start) for trial in trials]
            control = np.stack([np.repeat(c[start:end], substeps, axis=0) for c in controls])
            out, _ = mujoco.rollout.rollout(
                models, self.data, np.stack([h[-1][-1] for h in history]), control, persistent_pool=True
            )
            for i, of_trial in enumerate(out):
                history[i].append(of_trial[substeps - 1 :: substeps])
        nq = self.bare.nq
        wholes = [np.concatenate(h) for h in history]
        return [Motion(whole[:, 1 : 1 + nq], whole[:, 1 + nq : 1 + nq + self.bare.nv]) for whole in wholes]

    def first_state(self, trial: Trial) -> np.ndarray:
        """Positions and velocities of the log's first row, (nq + nv,).

        Velocities that were not logged start at zero; a robot whose base pose was not logged cannot be replayed.
        """
        jump, robot = trial.jump, self.robot
        qpos, qvel = self.bare.qpos0.copy(), np.zeros(self.bare.nv)
        if robot.has_free_base:
            qpos[:3], qpos[3:7] = jump.stack(BASE_POSITION)[0], jump.stack(BASE_QUATERNION)[0]
            for at, names in ((0, BASE_VELOCITY), (3, BASE_ANGULAR_VELOCITY)):
                qvel[at : at + 3] = [jump[name][0] if name in jump else 0.0 for name in names]
        qpos[robot.joint_qpos] = jump.per_joint("joint_pos", robot.joints)[0]
        if f"joint_vel/{robot.joints[0]}" in jump:
            qvel[robot.joint_dofs] = jump.per_joint("joint_vel", robot.joints)[0]
        return np.concatenate([qpos, qvel])

    def check_joints(self, jump: Jump) -> None:
        """Refuse a log of another robot, naming the joints that differ."""
        missing, foreign = (
            set(self.robot.joints) - set(jump.joints),
            set(jump.joints) - set(self.robot.joints),
        )
        if missing or foreign:
            raise InputError(
                jump.name,
                f"joints {', '.join(sorted(foreign)) or 'fewer'} and no {', '.join(sorted(missing)) or '–'}",
                f"the joints of {self.robot.name}: {', '.join(self.robot.joints)}",
                "name the model these logs were made with, or rename the columns",
            )

    def _substeps(self, jump: Jump) -> int:
        return max(1, int(np.ceil(jump.info.sample_period_s / LARGEST_STEP_S)))

    def _controls(self, trial: Trial, rows: int) -> np.ndarray:
        """Controls of the affine actuators, (rows, actuators): τ + kp q* + kd q̇*, by the gains of each row."""
        jump, joints = trial.jump, self.robot.joints
        commands = Commands(*(jump.per_joint(c, joints)[:rows] for c in ("cmd_tau", "cmd_pos", "cmd_vel")))
        for effect in trial.effects:
            commands = effect.change_commands(commands, jump.info.sample_period_s, self.robot)
        kp, kd = (jump.per_joint(gain, joints)[:rows] for gain in ("cmd_kp", "cmd_kd"))
        control = np.zeros((rows, self.bare.nu))
        control[:, self.robot.joint_actuators] = commands.torque + kp * commands.position + kd * commands.velocity
        return control

    def model(self, trial: Trial, row: int = 0) -> mujoco.MjModel:
        """The trial's own model: terrain of the log, joint gains of a row, control period, then its effects."""
        jump = trial.jump
        model = copy.copy(self._on_terrain(jump))
        actuators = self.robot.joint_actuators
        model.actuator_biasprm[actuators, 1] = -jump.per_joint("cmd_kp", self.robot.joints)[row]
        model.actuator_biasprm[actuators, 2] = -jump.per_joint("cmd_kd", self.robot.joints)[row]
        model.opt.timestep = jump.info.sample_period_s / self._substeps(jump)
        for effect in trial.effects:
            effect.change_model(model, self.robot)
        return model

    def _on_terrain(self, jump: Jump) -> mujoco.MjModel:
        """The bare robot on the log's terrain, compiled once a terrain: moving a compiled box would leave the
        collision tree and cached poses behind.
        """
        terrain = jump.info.terrain
        if len(terrain) > self.slots:
            raise InputError(
                jump.name,
                f"{len(terrain)} boxes of terrain",
                f"at most {self.slots}",
                "make the replayer with more terrain slots",
            )
        if terrain not in self.compiled:
            self.compiled[terrain] = self.robot.on_terrain(terrain, slots=self.slots)
        return self.compiled[terrain]

    def as_jump(self, motion: Motion, jump: Jump) -> Jump:
        """The motion as a jump log with the commands it was made with: measured columns are the simulation's."""
        robot, rows = self.robot, len(motion.qpos)
        columns = {
            name: values[:rows].copy()
            for name, values in jump.columns.items()
            if name == "time" or name.startswith("cmd_")
        }
        if robot.has_free_base:
            columns |= dict(zip(BASE_POSITION, motion.qpos[:, :3].T, strict=True))
            columns |= dict(zip(BASE_QUATERNION, motion.qpos[:, 3:7].T, strict=True))
            columns |= dict(zip(BASE_VELOCITY, motion.qvel[:, :3].T, strict=True))
            columns |= dict(zip(BASE_ANGULAR_VELOCITY, motion.qvel[:, 3:6].T, strict=True))
        for joint, at, dof in zip(robot.joints, robot.joint_qpos, robot.joint_dofs, strict=True):
            columns[f"joint_pos/{joint}"] = motion.qpos[:, at]
            columns[f"joint_vel/{joint}"] = motion.qvel[:, dof]
        info = replace(jump.info, source=f"replay of {jump.name}")
        return Jump(jump.name, {name: np.ascontiguousarray(values) for name, values in columns.items()}, info)
