"""Commands that reach the joints late, smoothed, held back or with something added."""

import math
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from leapgap.effects.base import (
    Commands,
    CommandStage,
    DriveEffect,
    Effect,
    ForceContext,
    MotorEffect,
    Parameter,
    parameter,
)
from leapgap.robot.model import Robot

NOTHING = 1e-17  # weight from which on earlier rows do not count


def first_order(values: np.ndarray, kept: float, before: np.ndarray) -> np.ndarray:
    """Recursion y(n) = kept y(n − 1) + (1 − kept) x(n) along the rows of x, ``values``, from y(−1) = ``before``.

    By doubling (Hillis and Steele, Comm. ACM 29, 1986): each pass adds what stands twice as many rows before.
    """
    found, step, weight = (1 - kept) * values, 1, kept
    found[:1] += kept * before
    while step < len(found) and weight > NOTHING:
        found[step:] += weight * found[:-step].copy()
        step, weight = 2 * step, weight**2
    return found


@dataclass(frozen=True)
class CommandDelay(MotorEffect):
    """Torque feed-forward and set points arrive later; the joint PD itself runs at the joint, at once.

    Each command is held for one period. Where the delay is no whole number of periods, a period sees the end of one
    command and the beginning of the next: it gets their mean, weighted by time, hence the exact impulse. Before
    anything arrives the first command holds.
    """

    name = "command_delay"
    words = "command latency"

    delay_s: float = parameter(0.0, "s", 0.0, 0.15, 0.005)

    @property
    def memory_s(self) -> float:
        """All of the delay."""
        return self.delay_s

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the commands of the joints."""
        at = robot.joints_at(self.location)
        rows = np.arange(len(commands.torque)) - self.delay_s / period_s
        whole = np.floor(rows + 1e-9).astype(int)  # a delay of whole periods is one in spite of rounding
        share = np.clip(rows - whole, 0.0, 1.0)[:, None]
        before, after = np.maximum(whole, 0), np.maximum(whole + 1, 0).clip(max=len(rows) - 1)

        def late(sent: np.ndarray) -> np.ndarray:
            arrived = sent.copy()
            arrived[:, at] = (1 - share) * sent[before][:, at] + share * sent[after][:, at]
            return arrived

        return commands.each(late)

    def change_newest_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """The same for the last period, by the same arithmetic."""
        last = len(commands.torque) - 1
        row = last - self.delay_s / period_s
        whole = math.floor(row + 1e-9)
        share = min(max(row - whole, 0.0), 1.0)
        before, after = max(whole, 0), min(max(whole + 1, 0), last)
        at = slice(None) if self.location == "all" else robot.joints_at(self.location)

        def late(sent: np.ndarray) -> np.ndarray:
            arrived = sent[-1:].copy()
            arrived[0, at] = (1 - share) * sent[before, at] + share * sent[after, at]
            return arrived

        return commands.each(late)


@dataclass(frozen=True)
class LoopDelay(DriveEffect, CommandDelay):
    """Time from a measurement to the torque of the joint PD that answers it; feed-forward and set points are as late.

    The PD acts on the state of ``delay_s`` ago, which is taken to second order: q(t − d) = q − d q̇ + d² q̈ / 2. So kd
    becomes kd − kp d, and the joint's inertia grows by kp d² / 2 − kd d, at most down to a half. Delays
    that are long for the loop (kp d² near the inertia) make a real loop unstable and are not exact here.
    """

    name = "loop_delay"
    drive_field = "delay_s"
    words = "latency of the feedback loop"
    by_default = False

    delay_s: float = parameter(0.0, "s", 0.0, 0.15, 0.003)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Commands and joint PD are late."""
        return at.at_motors(location, at.within * (at.late(at.sent) + at.kp * at.velocity + at.kd * at.acceleration))


@dataclass(frozen=True)
class ComputationDelay(Effect):
    """Commands of a sample reach the joints after a share of the sample period; until then the former commands hold.

    A process that reads the state, computes, sends and logs once a loop writes the state of the loop's beginning
    beside commands of its end. Where rows last unequally long, so does this delay: a stalled loop sends late. Where all
    rows are equally long it would be a ``command_delay``, and only that is looked for.
    """

    name = "computation_delay"
    words = "controller computation time"
    needs_motor = True
    by_default = False
    beside_clock = True
    command_stage = CommandStage.SENDING

    share: float = parameter(0.0, "rows", 0.0, 2.0, 0.5)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Mean of what has arrived in each period, hence the exact impulse."""
        count = len(commands.torque)
        if self.is_nominal or not count:
            return commands
        row = np.arange(count) if commands.row is None else commands.row
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        # Row r + share, in periods: a share above one reaches into the next row.
        arrive = np.interp(np.arange(len(starts)) + self.share, np.arange(len(starts) + 1), [*starts, count])
        return commands.each(lambda sent: arrivals(sent[starts], arrive, count))


def arrivals(sent: np.ndarray, arrive: np.ndarray, count: int) -> np.ndarray:
    """Mean in each of ``count`` periods of commands (commands, joints) that hold from ``arrive`` (commands,) on.

    ``arrive`` in periods; before anything arrives the first command holds.
    """
    knots = np.concatenate([[min(0.0, arrive[0])], arrive[1:], [max(count, arrive[-1]) + 1.0]])
    impulse = np.concatenate([np.zeros((1, sent.shape[1])), np.cumsum(np.diff(knots)[:, None] * sent, axis=0)])
    at = np.arange(count + 1.0)
    return np.stack([np.diff(np.interp(at, knots, of)) for of in impulse.T], axis=1)


@dataclass(frozen=True)
class DroppedCommands(MotorEffect):
    """Share of the commands that are lost, each by chance and on its own; the joint PD goes on with the last one.

    Which ones were lost is not known, so the mean over all losses acts: with the share p, command u of row t is
    (1 − p) Σ pᵏ u(t − k). That is late by p / (1 − p) rows on average, and smooth. Each row has one command, however
    long it lasts.
    """

    name = "dropped_commands"
    words = "lost command packets"
    by_default = False
    command_stage = CommandStage.CHOICE

    share: float = parameter(0.0, "1", 0.0, 0.95, 0.5)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Replace the commands of the joints by their mean over the losses."""
        at = robot.joints_at(self.location)
        row = np.arange(len(commands.torque)) if commands.row is None else commands.row
        begins = np.diff(row, prepend=-1) != 0

        def received(sent: np.ndarray) -> np.ndarray:
            mean, of_rows = sent.copy(), sent[begins][:, at]
            held = first_order(of_rows, self.share, of_rows[:1])  # the first command has arrived
            mean[:, at] = held[np.cumsum(begins) - 1]
            return mean

        return commands.each(received)


REMEMBERED = 30.0  # time constants after which a set point is forgotten


@dataclass(frozen=True)
class SetPointFilter(MotorEffect):
    """First-order low-pass on the set points of the joint PD, T dq_f/dt = q* − q_f, and on those of velocity alike.

    A period gets the mean of the filtered set point (the exact impulse). Before anything arrives the first command
    holds. Feed-forward torque, and what the joint PD measures, are not filtered.
    """

    name = "set_point_filter"
    words = "low-pass filter on the set points"
    by_default = False

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.5, 0.01)

    @property
    def memory_s(self) -> float:
        """Until nothing is left of a set point."""
        return REMEMBERED * self.time_constant_s

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Filter the set points of the joints."""
        if self.is_nominal:
            return commands
        at, periods = robot.joints_at(self.location), self.time_constant_s / period_s
        kept = float(np.exp(-1 / periods))

        def smooth(sent: np.ndarray) -> np.ndarray:
            wanted, found = sent[:, at], sent.copy()
            ends = first_order(wanted, kept, wanted[:1])
            starts = np.concatenate([wanted[:1], ends[:-1]])
            found[:, at] = wanted + (starts - wanted) * (periods * (1 - kept))
            return found

        return replace(commands, position=smooth(commands.position), velocity=smooth(commands.velocity))


AMPLE = 100.0  # a rate that limits nothing, rad/s
REMEMBERED_S = 2.0  # a closed loop takes set points to have been reached so long ago


@dataclass(frozen=True)
class SetPointSlew(MotorEffect):
    """Largest rate at which the set point of the joint PD follows the one that is sent.

    A period gets the mean of the set point that moves (the exact impulse). It begins at the first command. In a fit
    100 rad/s stands for no limit.
    """

    name = "set_point_slew"
    words = "rate limit on the set points"
    by_default = False

    rate_rad_s: float | None = parameter(None, "rad/s", 0.05, AMPLE, limits=(1e-3, inf), logarithmic=True)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Up to a rate that limits nothing."""
        about = cls.declarations()["rate_rad_s"]
        return (Parameter("rate_rad_s", about.unit, AMPLE, about.lower, AMPLE, 2.0, logarithmic=True),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Nothing near nominal, where it limits nothing."""
        return None

    @property
    def memory_s(self) -> float:
        """How far the set point is behind has no bound."""
        return REMEMBERED_S

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Hold back the set points of the joints."""
        if self.rate_rad_s is None or self.is_nominal_for(robot):
            return commands
        position = commands.position.copy()
        for joint in robot.joints_at(self.location):
            position[:, joint] = follow(position[:, joint], self.rate_rad_s * period_s)
        return replace(commands, position=position)


def follow(wanted: np.ndarray, most: float) -> np.ndarray:
    """Mean in each period of what follows ``wanted`` (periods,) by at most ``most`` a period, (periods,)."""
    ends, behind = wanted.tolist(), 0
    for jump in (np.flatnonzero(np.abs(np.diff(wanted)) > most) + 1).tolist():
        for k in range(max(jump, behind), len(ends)):
            one, now = ends[k], ends[k - 1]
            if abs(one - now) <= most:
                break
            ends[k] = now + most if one > now else now - most
            behind = k + 1
    starts = np.array([*wanted[:1], *ends[:-1]])
    ahead = wanted - starts
    share = np.minimum(np.abs(ahead) / most, 1.0)  # of the period, in which it moves
    return np.asarray(np.array(ends) - 0.5 * share * np.clip(ahead, -most, most))


LARGEST, MODERATE = 0.3, 0.03  # limit of the search and noticeable value, as shares of the largest torque of the motors


@dataclass(frozen=True)
class TorqueOffset(MotorEffect):
    """Constant torque added to what is commanded; the motor's limit and gain act on the sum."""

    name = "torque_offset"
    words = "constant motor torque offset"
    by_default = False

    torque_nm: float = parameter(0.0, "N·m", -10.0, 10.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Shares of the motors' largest torque, where the model states one."""
        (declared,) = super().parameters(robot, location)
        most = robot.largest_torque(location)
        if most is None:
            return (declared,)
        return (replace(declared, lower=-LARGEST * most, upper=LARGEST * most, moderate=MODERATE * most),)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Add to the feed-forward torque of the joints."""
        torque = commands.torque.copy()
        torque[:, robot.joints_at(self.location)] += self.torque_nm
        return replace(commands, torque=torque)
