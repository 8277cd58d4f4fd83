"""Rate limit on the set points."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from leapgap.effects.base import Commands, ForceContext, MotorEffect, Parameter, parameter
from leapgap.robot.model import Robot

AMPLE = 100.0
"""A rate that limits nothing, rad/s."""
REMEMBERED_S = 2.0
"""A closed loop takes set points to have been reached so long ago."""


@dataclass(frozen=True)
class SetPointSlew(MotorEffect):
    """Largest rate at which the set point of the joint PD follows the one that is sent.

    A period gets the mean of the set point that moves (the exact impulse). It begins at the first command. In a fit
    100 rad/s stands for no limit.
    """

    name = "set_point_slew"
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
