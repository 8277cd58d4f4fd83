"""What an actuator network is trained on: position errors, velocities, and the torque that the joint then felt."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.diagnosis.outside_forces.inverse_dynamics import Instants, inverse_dynamics, without_constraints
from leapgap.effects.base import Commands, Effect, ForceContext
from leapgap.errors import InputError
from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.simulation.rollout import joint_commands

WINDOW_S = 0.03
"""Window in which velocities are differenced to accelerations."""


@dataclass(frozen=True)
class ActuatorLog:
    """One log at the steps of a network, (steps, joints) each unless said."""

    log: Log
    robot: Robot
    rows: np.ndarray
    """Rows of the log, (steps,)."""
    step_s: float
    is_measured: bool
    """Whether the torque is the log's own; else inverse dynamics tells it."""

    @staticmethod
    def of(log: Log, robot: Robot, step_s: float, is_measured: bool) -> "ActuatorLog":
        """Every row that a step takes; the first and last windows, whose accelerations are poor, are left out."""
        period = log.info.sample_period_s
        every, margin = max(1, round(step_s / period)), max(1, round(WINDOW_S / period))
        rows = np.arange(margin, len(log) - margin, every)
        return ActuatorLog(log, robot, rows, every * period, is_measured)

    @cached_property
    def at(self) -> ForceContext:
        """The motion with its commands, as effects read it."""
        robot, log = self.robot, self.log
        motion, sent = (
            motion_of(log, robot),
            [joint_commands(log, robot, name) for name in ("cmd_tau", "cmd_pos", "cmd_vel")],
        )
        acceleration = velocity_fit(log.time, motion.qvel, WINDOW_S).velocity
        kp, kd = (joint_commands(log, robot, name)[self.rows] for name in ("cmd_kp", "cmd_kd"))
        own = (motion.qpos[self.rows], motion.qvel[self.rows], acceleration[self.rows])
        commands = Commands(*(one[self.rows] for one in sent))
        return ForceContext(robot, robot.model, *own, commands, kp, kd, self.step_s)

    @cached_property
    def position_error(self) -> np.ndarray:
        """Set point less position, rad."""
        return np.asarray(self.at.commands.position - self.at.position)

    @cached_property
    def torque(self) -> np.ndarray:
        """Torque at the joints beside the feed-forward, N·m: the log's, or what the motion needs of the nominal model.

        The latter holds the dry friction of the gears, which the model is rid of, and not its damping.
        """
        if self.is_measured:
            found = self.log.per_joint("tau", self.robot.joints)[self.rows]
        else:
            at, none = self.at, np.zeros_like(self.at.qvel)
            motion = Instants(self.log.time[self.rows], at.qpos, at.qvel, at.qacc, none, none)
            found = inverse_dynamics(without_constraints(self.robot.model), motion)[:, self.robot.joint_dofs]
        return np.asarray(found - self.at.commands.torque)

    @cached_property
    def joint_pd(self) -> np.ndarray:
        """What the joint PD asks for within the limits, beside the feed-forward, N·m."""
        return np.asarray(self.at.torque - self.at.commands.torque)

    def with_causes(self, causes: Sequence[Effect]) -> np.ndarray:
        """The same with what named causes add, to first order, N·m."""
        found = self.joint_pd.copy()
        for effect in causes:
            force = type(effect).force(self.at, effect.location)
            if force is None:
                continue
            for one, by in zip(effect.parameters(self.robot, effect.location), force, strict=True):
                found += (effect.values.get(one.name, one.nominal) - one.nominal) * by[:, self.robot.joint_dofs]
        return found

    def inputs(self, joint: int, history: int) -> np.ndarray:
        """Position errors, newest first, then velocities likewise, (steps − history + 1, 2 history)."""
        columns = [
            values[history - 1 - lag : len(values) - lag, joint]
            for values in (self.position_error, self.at.velocity)
            for lag in range(history)
        ]
        return np.stack(columns, axis=1)


def actuator_logs(logs: Sequence[Log], robot: Robot, step_s: float) -> list[ActuatorLog]:
    """Logs at the steps of a network; ``InputError`` where no torque can be told, or gains differ."""
    if len(logs) < 2:
        expected = "two or more: a network is judged on logs it was not trained on"
        raise InputError("actuator-net", f"{len(logs)} log", expected, "log another motion")
    is_measured = all(f"tau/{joint}" in log for log in logs for joint in robot.driven_joints)
    if robot.has_free_base and not is_measured:
        expected = "measured torques (tau/<joint>): contacts hide what the joints of a floating robot feel"
        raise InputError(logs[0].name, "no torque", expected, "log them, or hang the robot up")
    found = [ActuatorLog.of(log, robot, step_s, is_measured) for log in logs]
    if short := [one.log for one in found if not len(one.rows)]:
        says = f"{len(short[0])} rows of {short[0].info.sample_period_s:g} s"
        raise InputError(short[0].name, says, f"more than {2 * WINDOW_S:g} s", "leave it out, or log more")
    gains = np.concatenate([np.hstack([one.at.kp, one.at.kd]) for one in found])
    if np.ptp(gains, axis=0).max() > 1e-6 * np.abs(gains).max():
        expected = "the same gains in all logs: a network stands in the place of one joint PD"
        raise InputError("actuator-net", "gains that change", expected, "take logs of one set of gains")
    return found
