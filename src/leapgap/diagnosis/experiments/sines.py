"""Sines of some joints, the others held; of their torques, for robots without a joint PD."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.experiments.base import Experiment, Given, from_rest, names_of, standing_commands
from leapgap.logs.log import Log

LOG_S, ONSET_S = 2.0, 0.25
"""Least length of a log of sines, and the time in which their amplitude grows; a slow sine is logged for a period."""
WIDE_HZ, SLOW_HZ, FAST_HZ, RATIOS = 0.25, 0.7, 3.0, (0.8, 1.0, 1.25)
"""Frequencies of sines; each experiment has three logs, at these multiples."""
RANGE_SHARE, LARGEST_RAD, LARGEST_STANDING_RAD = 0.6, 1.2, 0.15
"""Amplitude of a sine: at most this share of what the joint can turn from its pose to its nearer end, and no more."""
FASTEST_SHARE = 1.5  # A sine is at most so many times faster than the fastest joint of the logs
LEAST_RAD, GENTLER = 0.02, 0.6
"""Smallest amplitude, and the factor on that of a sine that the motors or joints cannot follow."""
APART = 0.13  # Joints that move together differ in frequency by this share, so that each moves in its own way


@dataclass(frozen=True)
class Sines(Experiment):
    """Sines of some joints about the pose of the logs, the other joints held; three logs."""

    name = "sines"
    cost = 2

    joints: tuple[str, ...]
    amplitude: tuple[float, ...]  # Of each joint, rad (m for slides)
    frequency_hz: float

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Wide, slow and fast, at the places of the causes and at all joints; a standing robot cannot move wide."""
        if not (given.has_gains and given.is_even):
            return []
        frequencies = (SLOW_HZ, FAST_HZ) if given.robot.has_free_base else (WIDE_HZ, SLOW_HZ, FAST_HZ)
        every = [cls.at(joints, frequency, given) for joints in given.sine_places for frequency in frequencies]
        return [one for one in every if max(one.amplitude) >= LEAST_RAD]

    @classmethod
    def at(cls, joints: tuple[str, ...], frequency_hz: float, given: Given) -> "Sines":
        """Sines at some joints, as large as these can make them."""
        return cls(joints, tuple(amplitude(joint, frequency_hz, given) for joint in joints), frequency_hz)

    def plans(self, given: Given) -> list[Log]:
        """One log at each multiple of the frequency, by the median gains and feed-forward torque of the logs."""
        time = times(self.length_s, given)
        onset = np.clip(time / ONSET_S, 0, 1)
        growth, rate = onset**2 * (3 - 2 * onset), 6 * onset * (1 - onset) / ONSET_S
        found = []
        for number, ratio in enumerate(RATIOS):
            columns = standing_commands(given, len(time))
            for k, (joint, size) in enumerate(zip(self.joints, self.amplitude, strict=True)):
                apart = 1 + APART * k / max(1, len(self.joints) - 1)
                turn = 2 * np.pi * (self.frequency_hz * ratio) * apart
                sine, slope = np.sin(turn * time), turn * np.cos(turn * time)
                columns[f"cmd_pos/{joint}"] = columns[f"cmd_pos/{joint}"] + size * growth * sine
                columns[f"cmd_vel/{joint}"] = size * (growth * slope + rate * sine)
            found.append(from_rest(given, number, columns))
        return found

    def gentler(self) -> Experiment:
        """The same sines with smaller amplitudes, to two digits."""
        return replace(self, amplitude=tuple(float(f"{GENTLER * size:.2g}") for size in self.amplitude))

    @property
    def length_s(self) -> float:
        """Length of each log, s."""
        return max(LOG_S, 1 / self.frequency_hz)

    def words(self, given: Given) -> str:
        """What to do, with amplitudes, frequencies and gains."""
        least, most = min(self.amplitude), max(self.amplitude)
        size = f"{most:.2g}" if most - least < 0.05 * most else f"{least:.2g} to {most:.2g}"
        others = "all joints" if self.joints == given.joints else f"{names_of(self.joints, given.robot)} alone"
        return (
            f"record {len(RATIOS)} sines of {self.length_s:g} s at {others}, {size} rad, {band(self.frequency_hz)}, "
            f"{given.gains()}, about the pose of the logs"
        )

    @property
    def short(self) -> str:
        """Frequency and joints, in a few words."""
        at = self.joints[0] if len(self.joints) == 1 else f"{len(self.joints)} joints"
        return f"with sines of {self.frequency_hz:g} Hz at {at}"


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


def times(seconds: float, given: Given) -> np.ndarray:
    """Times of the rows of a log of so many seconds, s."""
    period = given.logs[0].info.sample_period_s
    return np.asarray(np.arange(round(seconds / period) + 1) * period)


def band(frequency_hz: float) -> str:
    """The frequencies of an experiment's logs in words."""
    low, high = (frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
    return f"{low:.2g} to {high:.2g} Hz"


@dataclass(frozen=True)
class TorqueSines(Experiment):
    """Sines of torque at some joints of a robot without joint PD; three logs of two seconds."""

    name = "torque_sines"
    cost = 2

    joints: tuple[str, ...]
    amplitude: tuple[float, ...]  # Of each joint, N·m (N for slides)
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
        found, time = [], times(LOG_S, given)
        for number, ratio in enumerate(RATIOS):
            columns = standing_commands(given, len(time))
            for k, (joint, size) in enumerate(zip(self.joints, self.amplitude, strict=True)):
                turn = 2 * np.pi * self.frequency_hz * ratio * (1 + APART * k)
                columns[f"cmd_tau/{joint}"] = size * np.sin(turn * time)
            found.append(from_rest(given, number, columns))
        return found

    def words(self, given: Given) -> str:
        """What to do, with torques in N·m and frequencies in Hz."""
        return (
            f"record {len(RATIOS)} sines of torque of {LOG_S:g} s at {names_of(self.joints, given.robot)}, "
            f"{max(self.amplitude):.2g} N·m, {band(self.frequency_hz)}, from the pose of the logs"
        )

    @property
    def short(self) -> str:
        """Frequency and largest torque, in a few words."""
        return f"with sines of {max(self.amplitude):.2g} N·m at {self.frequency_hz:g} Hz"
