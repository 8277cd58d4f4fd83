"""Sines of some joints, the others held."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.experiments.base import Experiment
from leapgap.diagnosis.experiments.gains import OtherGains
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import names_of, planned, standing_commands
from leapgap.logs.log import Log, LogInfo

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
        """The same sines with smaller amplitudes."""
        return replace(self, amplitude=smaller(self.amplitude))

    @property
    def length_s(self) -> float:
        """Length of each log, s."""
        return max(LOG_S, 1 / self.frequency_hz)

    def plan(self, number: int, frequency_hz: float, given: Given) -> Log:
        """The log of one frequency."""
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
        """What to do, with amplitudes, frequencies and gains."""
        low, high = (self.frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
        least, most = min(self.amplitude), max(self.amplitude)
        size = f"{most:.2g}" if most - least < 0.05 * most else f"{least:.2g} to {most:.2g}"
        others = "all joints" if self.joints == given.joints else f"{names_of(self.joints, given.robot)} alone"
        return (
            f"record {len(RATIOS)} sines of {self.length_s:g} s at {others}, {size} rad, {low:.2g} to {high:.2g} Hz, "
            f"{OtherGains(1.0).gains(given)}, about the pose of the logs"
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


def smaller(sizes: Sequence[float]) -> tuple[float, ...]:
    """Sizes of the next gentler motion, to two digits."""
    return tuple(float(f"{GENTLER * size:.2g}") for size in sizes)
