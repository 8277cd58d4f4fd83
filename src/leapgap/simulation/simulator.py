"""A robot with effects that is stepped by hand: commands go in, what its sensors report comes out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leapgap.effects.base import Effect, overriding
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import columns_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.closed_loop import Plant
from leapgap.simulation.controller import Command
from leapgap.simulation.corrected import read_corrected
from leapgap.simulation.open_loop import MotionPlan, PreparedRun
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, joint_commands

NOT_STEPPED = {"change_step": "compares two replays of a whole log", "change_rows": "is of the rows of one log"}
"""Methods of effects that no single step has, and why."""


@dataclass(frozen=True)
class Reading:
    """What the sensors of a robot report at one time; of a robot without a free base, None for the base."""

    time_s: float
    joint_pos: np.ndarray  # (joints,), rad; joints of the model in its order, passive ones with them
    joint_vel: np.ndarray  # (joints,), rad/s
    base_pos: np.ndarray | None = None  # (3,), m
    base_quat: np.ndarray | None = None  # (4,), base to world, w x y z
    base_linvel: np.ndarray | None = None  # (3,), m/s, in the world
    base_angvel: np.ndarray | None = None  # (3,), rad/s, in base axes

    @staticmethod
    def of(motion: Motion, robot: Robot, time_s: float) -> "Reading":
        """The last row of a motion."""
        joints = motion.qpos[-1, robot.joint_qpos], motion.qvel[-1, robot.joint_dofs]
        if not robot.has_free_base:
            return Reading(time_s, *joints)
        base = (motion.base_position, motion.base_quaternion, motion.base_velocity, motion.base_angular_velocity)
        return Reading(time_s, *joints, *(part[-1].copy() for part in base))

    @property
    def vector(self) -> np.ndarray:
        """All of it but the time, in the order above."""
        parts = (self.joint_pos, self.joint_vel, self.base_pos, self.base_quat, self.base_linvel, self.base_angvel)
        return np.concatenate([part for part in parts if part is not None])


class Simulator:
    """A corrected robot with its delays, motors and sensors, one control period at a time.

        simulator = lg.Simulator("report/corrected", period_s=0.002)
        reading = simulator.reset()
        reading = simulator.step(position=target, kp=40.0, kd=1.0)

    The steps are those of a replay: with the commands of an even log, from its first state, both give the same motion.
    Effects that depend on the motion, such as friction that grows with the load, see the simulated one here, and the
    logged one in a replay.
    """

    def __init__(
        self, robot: Robot | Path | str, effects: Sequence[Effect] = (), period_s: float | None = None
    ) -> None:
        """Load a folder ``corrected`` of a report with its effects, a model file, or a robot; ``effects`` are added.

        ``period_s``: time for which each command holds, s; None: the step of the model, or the period of the log that
        ``reset`` is given.
        """
        own: tuple[Effect, ...] = ()
        if not isinstance(robot, Robot):
            path = Path(robot)
            robot, own = read_corrected(path) if path.is_dir() else (Robot.load(robot), ())
        self.robot = robot
        self.effects = (*own, *effects)
        self.period_s = period_s
        for method, why in NOT_STEPPED.items():
            for effect in overriding(self.effects, method):
                do = "leave it out, or replay whole logs"
                raise InputError(f"effect {effect.name}", "an effect that " + why, "effects of single steps", do)
        self.replayer = Replayer(robot)
        self.plant: Plant | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that commands are for, in their order."""
        return self.robot.driven_joints

    @property
    def running(self) -> Plant:
        """The simulation; ``InputError`` before the first ``reset``."""
        if self.plant is None:
            raise InputError("Simulator", "no state", "a start", "call reset() first")
        return self.plant

    def reset(self, start: Log | np.ndarray | None = None) -> Reading:
        """Put the robot at a start, and say what its sensors report there.

        ``start`` is a log, whose first row, terrain, gains and period hold; or positions and velocities (nq + nv,) in
        MuJoCo's order; None: the first keyframe of the model, or its reference pose at rest.
        """
        robot = self.robot
        log = start if isinstance(start, Log) else None
        if log is None:
            state = self._rest() if start is None else np.asarray(start, float)
            if state.shape != (size := robot.model.nq + robot.model.nv,):
                raise InputError("Simulator.reset", f"a state {state.shape}", f"({size},), nq + nv", "correct it")
            log = self._log(state)
        elif not log.is_even:
            raise InputError(log.name, "rows of unequal length", "a log of one period", "replay it with lg.replay")
        if len(log.info.terrain) > self.replayer.slots:
            self.replayer = Replayer(robot, len(log.info.terrain))
        first = self.replayer.first_state(Rollout(log, self.effects))
        self.plant = Plant(self.replayer, PreparedRun(MotionPlan(log.name, log), log, first), self.effects)
        self.kp, self.kd = (joint_commands(log, robot, gain)[0] for gain in ("cmd_kp", "cmd_kd"))
        self.steps = 0
        self.held = np.where(robot.driven, first[robot.joint_qpos], 0.0)
        return self.reading

    def step(
        self,
        position: np.ndarray | None = None,
        velocity: np.ndarray | float = 0.0,
        torque: np.ndarray | float = 0.0,
        kp: np.ndarray | float | None = None,
        kd: np.ndarray | float | None = None,
    ) -> Reading:
        """Send a command for one control period and say what the sensors report at its end.

        Set points, rad and rad/s, feed-forward torque, N·m, and gains, N·m/rad and N·m·s/rad, of the driven joints,
        (joints,) or one number for all. Without a set point the last one holds; gains hold until others are given.
        """
        plant, driven = self.running, self.robot.driven
        for name, given in (("kp", kp), ("kd", kd)):
            if given is not None:
                setattr(self, name, self._all(given, driven, name))
        if position is not None:
            self.held = self._all(position, driven, "position")
        sent = (self._all(torque, driven, "torque"), self.held, self._all(velocity, driven, "velocity"))
        plant.send(Command(*sent, self.kp, self.kd, np.zeros(4)))
        self.steps += 1
        return self.reading

    @property
    def reading(self) -> Reading:
        """What the sensors report now."""
        plant = self.running
        return Reading.of(plant.measure(), self.robot, self.steps * plant.trial.log.info.sample_period_s)

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """True positions (nq,) and velocities (nv,) now, in MuJoCo's order."""
        return self.running.state

    def _all(self, values: np.ndarray | float, driven: np.ndarray, what: str) -> np.ndarray:
        """Values of the driven joints among those of all joints, zero at passive ones."""
        given = np.asarray(values, float)
        if given.shape not in ((), (int(driven.sum()),)):
            expected = f"one for each of {', '.join(self.joints)}, or one for all"
            raise InputError("Simulator.step", f"{what} of shape {given.shape}", expected, "correct it")
        if not np.isfinite(given).all():
            raise InputError("Simulator.step", f"{what} that is not finite", "numbers", "correct it")
        found = np.zeros(len(driven))
        found[driven] = given
        return found

    def _rest(self) -> np.ndarray:
        """The first keyframe, or the reference pose, at rest, (nq + nv,)."""
        model = self.robot.model
        pose = model.key(0).qpos if model.nkey else model.qpos0
        return np.concatenate([pose, np.zeros(model.nv)])

    def _log(self, state: np.ndarray) -> Log:
        """A log of two rows that begins at a state, without gains."""
        robot, period = self.robot, self.period_s or float(self.robot.model.opt.timestep)
        motion = Motion(*(np.tile(part, (2, 1)) for part in np.split(state, [robot.model.nq])))
        columns = {"time": np.array([0.0, period]), **columns_of(motion, robot)}
        kinds = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
        columns |= {f"{kind}/{joint}": np.zeros(2) for kind in kinds for joint in robot.driven_joints}
        return Log("by hand", columns, LogInfo(robot.name, period, "stepped by hand"))
