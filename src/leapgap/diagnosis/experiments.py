"""Experiments that may tell causes apart: each states what to do in numbers, and plans the logs that it would give.

A plan is a log whose commands are to be sent; its measured columns hold the state that it starts from in every row.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from leapgap.effects.links import links_at
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import columns_of, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns
from leapgap.robot.motion import Motion
from leapgap.simulation.known_loads import LOAD
from leapgap.simulation.open_loop import Course, MotionPlan, raise_front, with_block

OTHER_GAINS, OTHER_GAINS_FLOATING = (0.5, 2.0), (0.7, 1.4)
"""Factors on kp and kd; less far from what was logged where a robot stands on its feet by them."""
OTHER_SPEEDS = (0.5, 2.0)
LOG_S, ONSET_S = 2.0, 0.25
"""Least length of a log of sines, and the time in which their amplitude grows; a slow sine is logged for a period."""
WIDE_HZ, SLOW_HZ, FAST_HZ, RATIOS = 0.25, 0.7, 3.0, (0.8, 1.0, 1.25)
"""Frequencies of sines; each experiment has three logs, at these multiples."""
RANGE_SHARE, LARGEST_RAD, LARGEST_STANDING_RAD = 0.6, 1.2, 0.15
"""Amplitude of a sine: at most this share of what the joint can turn from its pose to its nearer end, and no more."""
FASTEST_SHARE = 1.5
"""A sine is at most so many times faster than the fastest joint of the logs."""
LEAST_RAD, GENTLER = 0.02, 0.6
"""Smallest amplitude, and the factor on that of a sine that the motors or joints cannot follow."""
APART = 0.13
"""Joints that move together differ in frequency by this share, so that each moves in its own way."""
MOST_PLACES, MOST_PLACES_FLOATING = 3, 1
"""Number of sets of joints that are moved by themselves."""
FINER_RATE, COARSE_S = 4, 0.004
"""Rows of at least this length, s, may be logged and sent so many times as often."""
LOAD_SHARE = 0.6
"""A known load, as a share of the mass of all that moves with the link that carries it."""
OTHER_DISTANCES_M, LOGGED_ALREADY_M = (0.3, 0.5, 0.7), 0.03
"""Distances of further jumps, and how near one counts as logged already."""
OTHER_BLOCKS_M, MOST_FURTHER_JUMPS = (0.02, 0.08), 8


REPEATS = "repeats"
"""Key of a proposal's settings: how many times each log is to be made."""


@dataclass(frozen=True)
class Given:
    """What experiments start from: the logs, the robot, and where the causes that are to be told apart act."""

    logs: tuple[Log, ...]
    """The judged rows."""
    robot: Robot
    places: tuple[str, ...] = ()
    """Locations of the causes, without doubles."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that the logs command, in the order of the robot."""
        return tuple(joint for joint in self.robot.joints if f"cmd_kp/{joint}" in self.logs[0])

    @property
    def is_jumps(self) -> bool:
        """Whether every log is a jump to a stated target."""
        return all("target" in log.info.extra for log in self.logs)

    @property
    def is_even(self) -> bool:
        """Whether all rows last one period, so that commands can be planned on it."""
        return all(log.is_even for log in self.logs)

    @property
    def has_gains(self) -> bool:
        """Whether a joint PD acts anywhere."""
        return any(bool(log.per_joint("cmd_kp").any()) for log in self.logs)

    def median(self, quantity: str) -> dict[str, float]:
        """Median of a commanded quantity over all logs, by joint."""
        return {
            joint: float(np.median(np.concatenate([log[f"{quantity}/{joint}"] for log in self.logs])))
            for joint in self.joints
        }

    @cached_property
    def fastest(self) -> float:
        """Largest speed of a joint in the logs, rad/s, of those that are commanded."""
        motions = [motion_of(log, self.robot) for log in self.logs]
        dofs = self.robot.joint_dofs[[self.robot.joints.index(joint) for joint in self.joints]]
        return max(float(np.percentile(np.abs(motion.qvel[:, dofs]), 99)) for motion in motions)

    @cached_property
    def pose(self) -> np.ndarray:
        """The state at rest that sines are about, (nq + nv,).

        That of a standing robot is its first row; the median pose of a robot that is held.
        """
        model, motions = self.robot.model, [motion_of(log, self.robot) for log in self.logs]
        state = np.concatenate([motions[0].qpos[0], np.zeros(model.nv)])
        if not self.robot.has_free_base:
            state[: model.nq] = np.median(np.concatenate([motion.qpos for motion in motions]), axis=0)
        return state

    @property
    def sine_places(self) -> list[tuple[str, ...]]:
        """Sets of joints to move: those of the causes' places that are smaller than the robot, then all."""
        robot, found = self.robot, []
        singles = robot.joint_groups if robot.has_free_base and robot.joint_groups else self.joints
        for location in (*self.places, *singles):
            if location in robot.feet or location == "all":
                continue
            joints = tuple(robot.joints[i] for i in robot.joints_at(location) if robot.joints[i] in self.joints)
            if joints and joints != self.joints and joints not in found:
                found.append(joints)
        return [*found[: MOST_PLACES_FLOATING if robot.has_free_base else MOST_PLACES], self.joints]


@dataclass(frozen=True)
class Experiment(ABC):
    """Further logs, and what they need beside commands."""

    kind: ClassVar[str]
    cost: ClassVar[int]
    """Order of the effort that it takes: of those that tell causes apart, the least is proposed."""

    @classmethod
    @abstractmethod
    def candidates(cls, given: Given) -> list["Experiment"]:
        """Those of this kind that are possible."""

    @abstractmethod
    def plans(self, given: Given) -> list[Log]:
        """The logs to make."""

    @abstractmethod
    def words(self, given: Given) -> str:
        """What to do, as an imperative with numbers."""

    @property
    def short(self) -> str:
        """The experiment in a few words, after "at" or "with"."""
        return self.kind.replace("_", " ")

    def gentler(self) -> "Experiment | None":
        """The same with a smaller motion, where the robot cannot make it; None where it has no size."""
        return None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns of sensors that are logged besides."""
        return ()

    @property
    def settings(self) -> dict[str, Any]:
        """The experiment as data, from which ``experiment_of`` restores it."""
        return {"kind": self.kind, **asdict(self)}


@dataclass(frozen=True)
class Repetition(Experiment):
    """The same motions again; it tells what the logs tell today."""

    kind = "repetition"
    cost = 0

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Always possible, and never proposed."""
        return [cls()]

    def plans(self, given: Given) -> list[Log]:
        """The logs' own commands from their own starts."""
        return [plan_of(log, k, given.robot) for k, log in enumerate(given.logs)]

    def words(self, given: Given) -> str:
        """The same again."""
        return "log the same motions again"


@dataclass(frozen=True)
class OtherJumps(Experiment):
    """Jumps to other distances with the front feet on higher blocks."""

    kind = "jumps"
    cost = 1

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """For robots that jumped."""
        return [cls()] if given.is_jumps else []

    @staticmethod
    def distances(given: Given) -> list[float]:
        """Distances that were not logged yet, m."""
        logged = np.array([log.info.extra["target"]["x_m"] for log in given.logs])
        new = [x for x in OTHER_DISTANCES_M if np.abs(logged - x).min() > LOGGED_ALREADY_M]
        return new or list(OTHER_DISTANCES_M)

    def number(self, given: Given) -> int:
        """How many jumps to make."""
        return max(len(self.distances(given)), min(2 * len(given.logs), MOST_FURTHER_JUMPS))

    def plans(self, given: Given) -> list[Log]:
        """The logged jumps on low and high blocks in turn; other distances would need another plan."""
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
        """Distances and blocks."""
        low, high = OTHER_BLOCKS_M
        centimetres = ", ".join(f"{100 * x:g}" for x in self.distances(given))
        return (
            f"log {self.number(given)} further jumps, to {centimetres} cm, with the front feet on blocks "
            f"of {100 * low:g} to {100 * high:g} cm"
        )

    @property
    def short(self) -> str:
        """On higher blocks."""
        return "on other blocks"

    def collect(self, given: Given) -> list[str]:
        """Settings of ``stages.collect`` that make such jumps on simulated hardware."""
        low, high = OTHER_BLOCKS_M
        targets = ",".join(f"[{x:g},0.0]" for x in self.distances(given))
        jumps = f"collect.jumps={self.number(given)}"
        return [f"collect.targets=[{targets}]", jumps, f"collect.block_height_m=[{low:g},{high:g}]"]


@dataclass(frozen=True)
class OtherGains(Experiment):
    """The same motions with other gains of the joint PD."""

    kind = "gains"
    cost = 1

    factor: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Softer and stiffer, where a joint PD acts."""
        factors = OTHER_GAINS_FLOATING if given.robot.has_free_base else OTHER_GAINS
        return [cls(factor) for factor in factors] if given.has_gains else []

    def plans(self, given: Given) -> list[Log]:
        """The logs' commands with scaled gains."""
        found = []
        for plan in Repetition().plans(given):
            gains = [name for name in plan.columns if name.startswith(("cmd_kp/", "cmd_kd/"))]
            columns = dict(plan.columns) | {name: self.factor * plan[name] for name in gains}
            found.append(replace(plan, columns=columns))
        return found

    def words(self, given: Given) -> str:
        """The gains in numbers."""
        return f"log the same motions again with {self.factor:g} times the gains ({self.gains(given)})"

    def gains(self, given: Given) -> str:
        """``kp 40`` or a range over joints."""
        values = sorted({float(f"{self.factor * value:.3g}") for value in given.median("cmd_kp").values() if value > 0})
        return f"kp {values[0]:g}" + (f" to {values[-1]:g}" if len(values) > 1 else "") if values else "kp 0"

    @property
    def short(self) -> str:
        """The factor."""
        return f"with {self.factor:g} times the gains"


@dataclass(frozen=True)
class OtherSpeed(Experiment):
    """The same motions slower or faster."""

    kind = "speed"
    cost = 1

    factor: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """For robots that are held and follow a joint PD; one on its feet would fall."""
        possible = given.has_gains and given.is_even and not given.robot.has_free_base
        return [cls(factor) for factor in OTHER_SPEEDS] if possible else []

    def plans(self, given: Given) -> list[Log]:
        """Commands at other times: what is asked of velocities scales, feed-forward torque stays at its place."""
        return [self.plan(plan, given.robot) for plan in Repetition().plans(given)]

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
        """The factor."""
        return f"log the same motions again, {self.short}"

    @property
    def short(self) -> str:
        """The factor as a word."""
        return f"{self.factor:g} times as fast"


@dataclass(frozen=True)
class FinerRate(Experiment):
    """The same motions, commanded and logged more often."""

    kind = "rate"
    cost = 2

    factor: int

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Where rows are coarse."""
        coarse = given.is_even and all(log.info.sample_period_s >= COARSE_S for log in given.logs)
        return [cls(FINER_RATE)] if coarse else []

    def plans(self, given: Given) -> list[Log]:
        """Each command several times."""
        found = []
        for log in Repetition().plans(given):
            columns = {name: np.repeat(log[name], self.factor) for name in commands_of(log)}
            info = replace(log.info, sample_period_s=log.info.sample_period_s / self.factor)
            start = motion_of(log, given.robot, slice(1)).first_state
            found.append(planned(log.name, columns, start, info, given.robot))
        return found

    def words(self, given: Given) -> str:
        """The rate."""
        rate = self.factor / min(log.info.sample_period_s for log in given.logs)
        return f"log the same motions again at {rate:.0f} Hz"

    @property
    def short(self) -> str:
        """The factor."""
        return f"logged {self.factor} times as often"


@dataclass(frozen=True)
class Sines(Experiment):
    """Sines of some joints about the pose of the logs, the other joints held; three logs."""

    kind = "sines"
    cost = 2

    joints: tuple[str, ...]
    amplitude: tuple[float, ...]
    """Of each joint, rad (m for slides)."""
    frequency_hz: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Wide, slow and fast, at the places of the causes and at all joints; a standing robot cannot move wide."""
        if not (given.has_gains and given.is_even):
            return []
        found: list[Experiment] = []
        for joints in given.sine_places:
            for frequency in (SLOW_HZ, FAST_HZ) if given.robot.has_free_base else (WIDE_HZ, SLOW_HZ, FAST_HZ):
                sizes = tuple(amplitude(joint, frequency, given) for joint in joints)
                if max(sizes) >= LEAST_RAD:
                    found.append(cls(joints, sizes, frequency))
        return found

    def plans(self, given: Given) -> list[Log]:
        """One log at each multiple of the frequency, by the median gains and feed-forward torque of the logs."""
        return [self.plan(k, self.frequency_hz * ratio, given) for k, ratio in enumerate(RATIOS)]

    def gentler(self) -> Experiment:
        """Smaller amplitudes."""
        return replace(self, amplitude=smaller(self.amplitude))

    @property
    def length_s(self) -> float:
        """Length of each log, s."""
        return max(LOG_S, 1 / self.frequency_hz)

    def plan(self, number: int, frequency_hz: float, given: Given) -> Log:
        """One log."""
        robot, period = given.robot, given.logs[0].info.sample_period_s
        time = np.arange(round(self.length_s / period) + 1) * period
        onset = np.clip(time / ONSET_S, 0, 1)
        growth, rate = onset**2 * (3 - 2 * onset), 6 * onset * (1 - onset) / ONSET_S
        columns = standing_commands(given, len(time))
        for k, (joint, size) in enumerate(zip(self.joints, self.amplitude, strict=True)):
            turn = 2 * np.pi * frequency_hz * (1 + APART * k / max(1, len(self.joints) - 1))
            sine, slope = np.sin(turn * time), turn * np.cos(turn * time)
            columns[f"cmd_pos/{joint}"] = columns[f"cmd_pos/{joint}"] + size * growth * sine
            columns[f"cmd_vel/{joint}"] = size * (growth * slope + rate * sine)
        info = LogInfo(given.logs[0].info.robot, period, "a planned experiment", given.logs[0].info.terrain)
        return planned(f"next_{number}", columns, given.pose, info, robot)

    def words(self, given: Given) -> str:
        """Amplitude, frequencies and gains."""
        low, high = (self.frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
        least, most = min(self.amplitude), max(self.amplitude)
        size = f"{most:.2g}" if most - least < 0.05 * most else f"{least:.2g} to {most:.2g}"
        others = "all joints" if self.joints == given.joints else f"{names_of(self.joints, given.robot)} alone"
        return (
            f"log {len(RATIOS)} sines of {self.length_s:g} s at {others}, {size} rad, {low:.2g} to {high:.2g} Hz, "
            f"{OtherGains(1.0).gains(given)}, about the pose of the logs"
        )

    @property
    def short(self) -> str:
        """Frequency and joints."""
        at = self.joints[0] if len(self.joints) == 1 else f"{len(self.joints)} joints"
        return f"with sines of {self.frequency_hz:g} Hz at {at}"


@dataclass(frozen=True)
class TorqueSines(Experiment):
    """Sines of torque at some joints of a robot without joint PD; three logs of two seconds."""

    kind = "torque_sines"
    cost = 2

    joints: tuple[str, ...]
    amplitude: tuple[float, ...]
    """Of each joint, N·m (N for slides)."""
    frequency_hz: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """At half and all of the largest torque of the logs."""
        if given.has_gains or not given.is_even or given.robot.has_free_base:
            return []
        most = {
            joint: max(float(np.abs(log[f"cmd_tau/{joint}"]).max()) for log in given.logs) for joint in given.joints
        }
        joints = tuple(joint for joint in given.joints if most[joint] > 0)
        sizes = [tuple(share * most[joint] for joint in joints) for share in (0.5, 1.0)]
        return [cls(joints, size, hz) for size in sizes for hz in (SLOW_HZ, FAST_HZ)] if joints else []

    def plans(self, given: Given) -> list[Log]:
        """One log at each multiple of the frequency."""
        found, period = [], given.logs[0].info.sample_period_s
        time = np.arange(round(LOG_S / period) + 1) * period
        for number, ratio in enumerate(RATIOS):
            columns = standing_commands(given, len(time))
            for k, (joint, size) in enumerate(zip(self.joints, self.amplitude, strict=True)):
                turn = 2 * np.pi * self.frequency_hz * ratio * (1 + APART * k)
                columns[f"cmd_tau/{joint}"] = size * np.sin(turn * time)
            info = LogInfo(given.logs[0].info.robot, period, "a planned experiment")
            found.append(planned(f"next_{number}", columns, given.pose, info, given.robot))
        return found

    def words(self, given: Given) -> str:
        """Torques and frequencies."""
        low, high = (self.frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
        return (
            f"log {len(RATIOS)} sines of torque of {LOG_S:g} s at {names_of(self.joints, given.robot)}, "
            f"{max(self.amplitude):.2g} N·m, {low:.2g} to {high:.2g} Hz, from the pose of the logs"
        )

    @property
    def short(self) -> str:
        """Frequency and torque."""
        return f"with sines of {max(self.amplitude):.2g} N·m at {self.frequency_hz:g} Hz"


@dataclass(frozen=True)
class KnownLoad(Experiment):
    """Motions with a known mass at the centre of mass of a link, which the metadata of the logs state."""

    kind = "load"
    cost = 3

    joint: str
    """The joint that moves the link."""
    body: str
    mass_kg: float
    frequency_hz: float | None = None
    """Of sines of all joints; None: the motions of the logs."""
    share: float = 1.0
    """Amplitude of the sines, as a share of that without a load."""

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
        return [with_load(plan, {self.joint: self.mass_kg}) for plan in self.motion(given).plans(given)]

    def motion(self, given: Given) -> Experiment:
        """What the robot does with the load."""
        if self.frequency_hz is None:
            return Repetition()
        return Sines(
            given.joints, tuple(amplitude(j, self.frequency_hz, given) for j in given.joints), self.frequency_hz
        )

    def words(self, given: Given) -> str:
        """Motion, mass and body."""
        return (
            f"{self.motion(given).words(given)}, with {self.mass_kg:g} kg fastened at the centre of mass of "
            f'{self.body} (metadata of these logs: "load": {{"{self.joint}": {self.mass_kg:g}}})'
        )

    @property
    def short(self) -> str:
        """Mass and body."""
        sines = "" if self.frequency_hz is None else f", sines of {self.frequency_hz:g} Hz"
        return f"with {self.mass_kg:g} kg at {self.body}{sines}"


@dataclass(frozen=True)
class FurtherSensor(Experiment):
    """The same motions with a further sensor."""

    kind = "sensor"
    cost = 4

    columns: tuple[str, ...]

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """An accelerometer and foot forces, where the model has them and the logs do not."""
        can = sensor_columns(given.robot) if given.robot.has_free_base else ()
        groups = (IMU_ACCELERATION, tuple(FOOT_FORCE + foot for foot in given.robot.feet))
        lacking = [g for g in groups if g and set(g) <= set(can) and not all(c in log for c in g for log in given.logs)]
        return [cls(group) for group in lacking]

    def plans(self, given: Given) -> list[Log]:
        """The logs' own commands."""
        return Repetition().plans(given)

    @property
    def sensors(self) -> tuple[str, ...]:
        """The columns."""
        return self.columns

    def words(self, given: Given) -> str:
        """What to log."""
        return f"log {self.short.removeprefix('with ')} too"

    @property
    def short(self) -> str:
        """The sensor."""
        return "with the accelerometer" if self.columns == IMU_ACCELERATION else "with the forces at the feet"


KINDS: tuple[type[Experiment], ...] = (
    OtherJumps,
    OtherGains,
    OtherSpeed,
    FinerRate,
    Sines,
    TorqueSines,
    KnownLoad,
    FurtherSensor,
)
"""Kinds of experiments that are proposed."""


def candidates_for(given: Given) -> list[Experiment]:
    """All experiments that are possible, the least effort first."""
    return sorted((one for kind in KINDS for one in kind.candidates(given)), key=lambda one: one.cost)


def experiment_of(settings: Mapping[str, Any]) -> Experiment:
    """The experiment that a report proposes, from its settings."""
    (kind,) = (kind for kind in KINDS if kind.kind == settings["kind"])
    values = {
        key: tuple(v) if isinstance(v, list) else v for key, v in settings.items() if key not in ("kind", REPEATS)
    }
    return kind(**values)


def plans_of(settings: Mapping[str, Any], given: Given) -> list[Log]:
    """The logs that a report proposes to make: those of the experiment, as many times as it asks for."""
    plans = experiment_of(settings).plans(given) * int(settings.get(REPEATS, 1))
    return [replace(plan, name=f"next_{k}") for k, plan in enumerate(plans)]


def amplitude(joint: str, frequency_hz: float, given: Given) -> float:
    """Amplitude of a sine at a joint, within its range and what it did in the logs, to two digits."""
    robot, which = given.robot, given.robot.joints.index(joint)
    number = robot.model.joint(joint).id
    most = LARGEST_STANDING_RAD if robot.has_free_base else LARGEST_RAD
    if robot.model.jnt_limited[number]:
        low, high = robot.model.jnt_range[number]
        at = float(given.pose[robot.joint_qpos[which]])
        most = min(most, RANGE_SHARE * max(0.0, min(at - float(low), float(high) - at)))
    speed = FASTEST_SHARE * given.fastest
    return float(f"{min(most, speed / (2 * np.pi * frequency_hz)):.2g}")


def smaller(sizes: Sequence[float]) -> tuple[float, ...]:
    """Sizes of the next gentler motion, to two digits."""
    return tuple(float(f"{GENTLER * size:.2g}") for size in sizes)


def standing_commands(given: Given, rows: int) -> dict[str, np.ndarray]:
    """Commands that hold the pose of the logs, (rows,) each, with the median gains.

    Feed-forward torque is that of the first row of a standing robot, and the median of one that is held.
    """
    robot = given.robot
    commands: dict[str, np.ndarray] = {}
    kp, kd, torque = (given.median(quantity) for quantity in ("cmd_kp", "cmd_kd", "cmd_tau"))
    first = given.logs[0]
    for joint in given.joints:
        at = float(given.pose[robot.joint_qpos[robot.joints.index(joint)]])
        held = float(first[f"cmd_pos/{joint}"][0]) if robot.has_free_base else at
        push = float(first[f"cmd_tau/{joint}"][0]) if robot.has_free_base else torque[joint]
        values = {"tau": push if given.has_gains else 0.0, "pos": held, "vel": 0.0, "kp": kp[joint], "kd": kd[joint]}
        commands |= {f"cmd_{name}/{joint}": np.full(rows, value) for name, value in values.items()}
    return commands


def with_load(plan: Log, load: Mapping[str, float]) -> Log:
    """The plan with known masses, joint → kg, in its metadata."""
    extra = {**plan.info.extra, LOAD: dict(load)}
    return replace(plan, info=replace(plan.info, extra=extra))


def commands_of(log: Log) -> list[str]:
    """Names of the columns of commands."""
    return [name for name in log.columns if name.startswith("cmd_")]


def plan_of(log: Log, number: int, robot: Robot) -> Log:
    """The commands of a log as a plan, from its own first state."""
    columns = {name: log[name] for name in commands_of(log)}
    if not log.is_even:
        columns["time"] = log.time
    start = motion_of(log, robot).first_state
    return planned(f"next_{number}", columns, start, log.info, robot)


def planned(name: str, columns: Mapping[str, np.ndarray], start: np.ndarray, info: LogInfo, robot: Robot) -> Log:
    """A plan of commands from a state (nq + nv,)."""
    rows = len(next(iter(columns.values())))
    time = {"time": np.arange(rows) * info.sample_period_s}
    extra = {key: value for key, value in info.extra.items() if key != "derived"}
    return with_start(Log(name, time | dict(columns), replace(info, extra=extra)), start, robot)


def with_start(plan: Log, start: np.ndarray, robot: Robot) -> Log:
    """The plan from another state (nq + nv,)."""
    nq = robot.model.nq
    rows = Motion(np.tile(start[:nq], (len(plan), 1)), np.tile(start[nq:], (len(plan), 1)))
    return replace(plan, columns=dict(plan.columns) | columns_of(rows, robot))


def names_of(joints: Sequence[str], robot: Robot) -> str:
    """``knee``, ``hip and knee``, or the name of the group that these joints are."""
    for location in (*robot.joint_groups, *robot.limbs_of_pair, *robot.topology.limbs):
        if {robot.joints[i] for i in robot.joints_at(location)} == set(joints):
            return location
    return " and ".join([", ".join(joints[:-1]), joints[-1]] if len(joints) > 1 else joints)


def is_possible(plan: Log, motion: Motion, robot: Robot) -> bool:
    """Whether a simulated plan stays finite, within joint ranges, and mostly within what the motors can give."""
    if not (np.isfinite(motion.qpos).all() and np.isfinite(motion.qvel).all()):
        return False
    joints = [joint for joint in robot.joints if f"cmd_kp/{joint}" in plan]
    which = [robot.joints.index(joint) for joint in joints]
    q, v = motion.qpos[:, robot.joint_qpos[which]], motion.qvel[:, robot.joint_dofs[which]]
    tau, pos, vel, kp, kd = (
        plan.per_joint(f"cmd_{name}", joints)[: len(q)] for name in ("tau", "pos", "vel", "kp", "kd")
    )
    asked = np.abs(tau + kp * (pos - q) + kd * (vel - v))
    limits = np.minimum(robot.torque_limits[which], math.inf)
    if (asked > limits).mean(axis=0).max() > MOST_LIMITED:
        return False
    for k, joint in enumerate(joints):
        number = robot.model.joint(joint).id
        if robot.model.jnt_limited[number]:
            low, high = robot.model.jnt_range[number]
            if q[:, k].min() < low - BEYOND_RAD or q[:, k].max() > high + BEYOND_RAD:
                return False
    return True


MOST_LIMITED, BEYOND_RAD = 0.05, 0.02
"""Share of the rows in which a motor may be at its limit, and how far a joint may press into its stop, rad."""
