"""The same motions slower or faster."""

from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import commands_of, planned
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot

OTHER_SPEEDS = (0.5, 2.0)


@dataclass(frozen=True)
class OtherSpeed(Experiment):
    """The same motions slower or faster."""

    name = "speed"
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
        """What to do, with the factor on the speed."""
        return f"record the same motions again, {self.short}"

    @property
    def short(self) -> str:
        """The factor on the speed, in a few words."""
        return f"{self.factor:g} times as fast"
