"""Sines of torque, for robots without a joint PD."""

from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.experiments.base import Experiment
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import names_of, planned, standing_commands
from leapgap.diagnosis.experiments.sines import APART, FAST_HZ, LOG_S, RATIOS, SLOW_HZ
from leapgap.logs.log import Log, LogInfo


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
        """What to do, with torques in N·m and frequencies in Hz."""
        low, high = (self.frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
        return (
            f"record {len(RATIOS)} sines of torque of {LOG_S:g} s at {names_of(self.joints, given.robot)}, "
            f"{max(self.amplitude):.2g} N·m, {low:.2g} to {high:.2g} Hz, from the pose of the logs"
        )

    @property
    def short(self) -> str:
        """Frequency and largest torque, in a few words."""
        return f"with sines of {max(self.amplitude):.2g} N·m at {self.frequency_hz:g} Hz"
