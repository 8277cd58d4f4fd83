"""One replay as data: a log, the effects to add, where it starts, and what the log commands."""

import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from leapgap.effects.base import Effect, overriding, recompute_constants
from leapgap.effects.bodies import add_mass, links_at, square_to
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class Rollout:
    """One replay: a log, and the effects to add to the nominal robot."""

    log: Log
    effects: tuple[Effect, ...] = ()
    first_state: np.ndarray | None = None  # (nq + nv,): true first state; None: by the log's first row
    measured: Motion | None = None  # the log's measured motion, where it is known already; None: read from the log

    @cached_property
    def structure(self) -> tuple[Hashable, ...]:
        """What the effects add to the model; only models of equal structure roll out in one batch."""
        structures = (effect.structure for effect in overriding(self.effects, "change_spec"))
        return tuple(own for own in structures if own is not None)

    @cached_property
    def period_s(self) -> float:
        """The control period that the effects make of the claimed one, s."""
        period = self.log.info.sample_period_s
        for effect in overriding(self.effects, "change_period"):
            period = effect.change_period(period)
        return period

    @cached_property
    def reported_late_s(self) -> float:
        """How late the log reports a part of the state, s; of several such effects the longest time."""
        return max((effect.reported_late_s for effect in overriding(self.effects, "reported_late_s")), default=0.0)

    @cached_property
    def step_ratio(self) -> float:
        """Length of the steps of the simulation that the motion is one of, over that of the replayer's own."""
        ratio = 1.0
        for effect in overriding(self.effects, "change_step"):
            ratio = effect.change_step(ratio)
        return ratio


def joint_gains(log: Log, robot: Robot) -> np.ndarray:
    """Gains of the joint PD in every row, (rows, 2 joints): N·m/rad of all joints, then N·m·s/rad."""
    return np.concatenate([joint_commands(log, robot, gain) for gain in ("cmd_kp", "cmd_kd")], axis=1)


def joint_commands(log: Log, robot: Robot, quantity: str) -> np.ndarray:
    """A commanded quantity of every joint, (rows, joints); zero for joints that the log does not command."""
    if log.joints == robot.joints:
        return log.per_joint(quantity)
    commanded = [joint in log.joints for joint in robot.joints]
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
    states: np.ndarray  # (pieces, nq + nv), as reported
    course: Callable[[Sequence[int], float], np.ndarray] | None = None
    """By how much the reported states change in so many rows from some rows on, (rows, nq + nv); None: not known."""
    stride: int = 1  # rows of the log that ``course`` knows for each of the log whose pieces these are

    def chosen(self, which: Sequence[int]) -> "Starts":
        """The starts of some of the pieces, in the order of ``which``."""
        return replace(self, rows=[self.rows[k] for k in which], states=self.states[list(which)])

    def every(self, rows: int) -> "Starts":
        """The same starts in a log of every ``rows``-th row."""
        return replace(self, rows=[row // rows for row in self.rows], stride=self.stride * rows)

    def later(self, rows: float) -> np.ndarray | None:
        """The states that are reported so many rows later, (pieces, nq + nv); None where that is not known."""
        if self.course is None:
            return None
        return self.states + self.course([row * self.stride for row in self.rows], rows * self.stride)


LOAD = "load"  # key of a log's metadata


def put_loads(model: mujoco.MjModel, log: Log, robot: Robot) -> None:
    """Put the loads of a log into a model that the caller owns and that has all effects already."""
    stated: Mapping[str, float] = log.info.extra.get(LOAD, {})
    for joint, mass in stated.items():
        for link in links_at(robot, joint):
            add_point_mass(model, int(link), float(mass), robot.model.body_ipos[link])
    if stated:
        recompute_constants(model)


def add_point_mass(model: mujoco.MjModel, body: int, mass: float, at: np.ndarray) -> None:
    """Add a point mass, kg, at a place in the axes of a body, m, (3,)."""
    away = at - model.body_ipos[body]
    add_mass(model, body, mass, mass * away, mass * square_to(away))
