"""The motions of the logs again, with something changed: gains, speed, rate, a sensor, a load, the ground."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.experiments.base import (
    Experiment,
    Given,
    Repetition,
    commands_of,
    plan_of,
    planned,
    repeated,
    with_start,
)
from leapgap.diagnosis.experiments.sines import FAST_HZ, SLOW_HZ, Sines
from leapgap.effects.bodies import links_at
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns
from leapgap.simulation.open_loop import Course, MotionPlan, raise_front, with_block
from leapgap.simulation.rollout import LOAD

OTHER_GAINS, OTHER_GAINS_FLOATING = (0.5, 2.0), (0.7, 1.4)
"""Factors on kp and kd; less far from what was logged where a robot stands on its feet by them."""
OTHER_SPEEDS = (0.5, 2.0)
FINER_RATE, COARSE_S = 4, 0.004  # Rows of at least this length, s, may be logged and sent so many times as often
LOAD_SHARE = 0.6  # A known load, as a share of the mass of all that moves with the link that carries it
OTHER_BLOCKS_M, MOST_FURTHER_JUMPS = (0.02, 0.08), 8


@dataclass(frozen=True)
class OtherGains(Experiment):
    """The same motions with other gains of the joint PD."""

    name = "gains"
    cost = 1
    brief = "with {factor:g} times the gains"

    factor: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Softer and stiffer, where a joint PD acts."""
        factors = OTHER_GAINS_FLOATING if given.robot.has_free_base else OTHER_GAINS
        return [cls(factor) for factor in factors] if given.has_gains else []

    def is_alike(self, given: Given) -> bool:
        """Where a robot stands on its feet, whose gains are changed little."""
        return given.robot.has_free_base

    def plans(self, given: Given) -> list[Log]:
        """The logs' commands with scaled gains."""
        found = []
        for plan in repeated(given):
            gains = [name for name in plan.columns if name.startswith(("cmd_kp/", "cmd_kd/"))]
            columns = dict(plan.columns) | {name: self.factor * plan[name] for name in gains}
            found.append(replace(plan, columns=columns))
        return found

    def words(self, given: Given) -> str:
        """What to do, with the factor and the gains that it gives."""
        return f"record the same motions again {self.short} ({given.gains(self.factor)})"


@dataclass(frozen=True)
class OtherSpeed(Experiment):
    """The same motions slower or faster."""

    name = "speed"
    cost = 1
    brief = "{factor:g} times as fast"

    factor: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """For robots that are held and follow a joint PD; one on its feet would fall."""
        possible = given.has_gains and given.is_even and not given.robot.has_free_base
        return [cls(factor) for factor in OTHER_SPEEDS] if possible else []

    def plans(self, given: Given) -> list[Log]:
        """Commands at other times: what is asked of velocities scales, feed-forward torque stays at its place."""
        return [self.plan(plan, given.robot) for plan in repeated(given)]

    def plan(self, log: Log, robot: Robot) -> Log:
        """One log at another speed."""
        period = log.info.sample_period_s
        time = np.arange(max(2, round(len(log) / self.factor))) * period
        source = np.minimum(time * self.factor, (len(log) - 1) * period)
        columns = {name: np.interp(source, np.arange(len(log)) * period, log[name]) for name in commands_of(log)}
        columns |= {name: self.factor * values for name, values in columns.items() if name.startswith("cmd_vel/")}
        start = motion_of(log, robot, slice(1)).first_state
        start[robot.model.nq :] *= self.factor
        return planned(log.name, columns, start, log.info, robot)

    def words(self, given: Given) -> str:
        """What to do, with the factor on the speed."""
        return f"record the same motions again, {self.short}"


@dataclass(frozen=True)
class FinerRate(Experiment):
    """The same motions, commanded and logged more often."""

    name = "rate"
    cost = 2
    brief = "logged {factor} times as often"

    factor: int

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Possible where the rows of all logs are coarse."""
        coarse = given.is_even and all(log.info.sample_period_s >= COARSE_S for log in given.logs)
        return [cls(FINER_RATE)] if coarse else []

    def plans(self, given: Given) -> list[Log]:
        """The logs' commands, each held for several shorter rows."""
        found = []
        for log in repeated(given):
            columns = {name: np.repeat(log[name], self.factor) for name in commands_of(log)}
            info = replace(log.info, sample_period_s=log.info.sample_period_s / self.factor)
            start = motion_of(log, given.robot, slice(1)).first_state
            found.append(planned(log.name, columns, start, info, given.robot))
        return found

    def words(self, given: Given) -> str:
        """What to do, with the rate in Hz."""
        rate = self.factor / min(log.info.sample_period_s for log in given.logs)
        return f"record the same motions again at {rate:.0f} Hz"


@dataclass(frozen=True)
class FurtherSensor(Repetition):
    """The same motions with a further sensor."""

    name = "sensor"
    cost = 4

    columns: tuple[str, ...]

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """An accelerometer and foot forces, where the model has them and the logs do not."""
        can = sensor_columns(given.robot) if given.robot.has_free_base else ()
        groups = (IMU_ACCELERATION, tuple(FOOT_FORCE + foot for foot in given.robot.feet))
        lacking = [g for g in groups if g and set(g) <= set(can) and not all(c in log for c in g for log in given.logs)]
        return [cls(group) for group in lacking]

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns of the sensor that is read besides."""
        return self.columns

    def words(self, given: Given) -> str:
        """What to log, by the name of the sensor."""
        return f"record {self.short.removeprefix('with ')} too"

    @property
    def short(self) -> str:
        """The sensor, in a few words."""
        return "with the accelerometer" if self.columns == IMU_ACCELERATION else "with the forces at the feet"


@dataclass(frozen=True)
class KnownLoad(Experiment):
    """Motions with a known mass at the centre of mass of a link, which the metadata of the logs state."""

    name = "load"
    cost = 3

    joint: str  # The joint that moves the link
    body: str
    mass_kg: float
    frequency_hz: float | None = None  # Of sines of all joints; None: the motions of the logs
    share: float = 1.0  # Amplitude of the sines, as a share of that without a load

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """At the last link of a robot that is held, in the motions of the logs and in sines of all joints."""
        robot, joint = given.robot, given.joints[-1]
        if robot.has_free_base:
            return []
        (link,) = links_at(robot, joint)
        body, mass = robot.model.body(link).name, float(f"{LOAD_SHARE * robot.model.body_subtreemass[link]:.2g}")
        frequencies = [None, SLOW_HZ, FAST_HZ] if given.has_gains and given.is_even else [None]
        return [cls(joint, body, mass, frequency) for frequency in frequencies] if mass > 0 else []

    def plans(self, given: Given) -> list[Log]:
        """Sines of all joints, or the logs' own commands, with the load in their metadata."""
        plans = self.motion(given).plans(given)
        extra = {LOAD: {self.joint: self.mass_kg}}
        return [replace(plan, info=replace(plan.info, extra={**plan.info.extra, **extra})) for plan in plans]

    def motion(self, given: Given) -> Experiment:
        """What the robot does with the load."""
        return Repetition() if self.frequency_hz is None else Sines.at(given.joints, self.frequency_hz, given)

    def words(self, given: Given) -> str:
        """What to do, with the mass in kg, the body and the metadata to state."""
        return (
            f"{self.motion(given).words(given)}, with {self.mass_kg:g} kg fastened at the centre of mass of "
            f'{self.body} (metadata of these logs: "load": {{"{self.joint}": {self.mass_kg:g}}})'
        )

    @property
    def short(self) -> str:
        """Mass and body, in a few words."""
        sines = "" if self.frequency_hz is None else f", sines of {self.frequency_hz:g} Hz"
        return f"with {self.mass_kg:g} kg at {self.body}{sines}"


@dataclass(frozen=True)
class OtherJumps(Experiment):
    """Jumps to the logged distances with the front feet on low and high blocks.

    Jumps to other distances need plans that nobody has simulated yet, of which the longest slip at take-off.
    """

    name = "jumps"
    cost = 1
    brief = "on other blocks"

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Possible where every log is a jump to a stated target."""
        return [cls()] if all("target" in log.info.extra for log in given.logs) else []

    @staticmethod
    def distances(given: Given) -> list[float]:
        """Distances of the logged jumps without doubles, m."""
        return sorted({float(log.info.extra["target"]["x_m"]) for log in given.logs})

    def number(self, given: Given) -> int:
        """How many jumps to make: twice as many as were logged, if that is not too many."""
        return max(len(self.distances(given)), min(2 * len(given.logs), MOST_FURTHER_JUMPS))

    def is_alike(self, given: Given) -> bool:
        """Always: they are jumps by the same plans."""
        return True

    def plans(self, given: Given) -> list[Log]:
        """The logged jumps on low and high blocks in turn."""
        robot, found = given.robot, []
        for k, log in enumerate(given.logs):
            height = OTHER_BLOCKS_M[k % len(OTHER_BLOCKS_M)]
            under = max((box.top_m for box in log.info.terrain), default=0.0)
            bare = replace(log, info=replace(log.info, terrain=()))
            block = with_block(bare, MotionPlan("", bare, height), robot, Course())
            state = raise_front(motion_of(log, robot, slice(1)).first_state, height - under, robot)
            found.append(with_start(plan_of(block, k, robot), state, robot))
        return found

    def words(self, given: Given) -> str:
        """What to do, with distances and heights of blocks in cm."""
        low, high = OTHER_BLOCKS_M
        centimetres = ", ".join(f"{100 * x:g}" for x in self.distances(given))
        return (
            f"record {self.number(given)} further jumps, to {centimetres} cm, with the front feet on blocks "
            f"of {100 * low:g} to {100 * high:g} cm"
        )

    def collect(self, given: Given) -> tuple[str, ...]:
        """Settings of ``stages.collect`` that make such jumps on simulated hardware."""
        low, high = OTHER_BLOCKS_M
        targets = ",".join(f"[{x:g},0.0]" for x in self.distances(given))
        jumps = f"collect.jumps={self.number(given)}"
        return (f"collect.targets=[{targets}]", jumps, f"collect.block_height_m=[{low:g},{high:g}]")
