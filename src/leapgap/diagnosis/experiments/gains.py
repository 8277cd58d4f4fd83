"""The same motions with other gains of the joint PD."""

from dataclasses import dataclass, replace

from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.logs.log import Log

OTHER_GAINS, OTHER_GAINS_FLOATING = (0.5, 2.0), (0.7, 1.4)
"""Factors on kp and kd; less far from what was logged where a robot stands on its feet by them."""


@dataclass(frozen=True)
class OtherGains(Experiment):
    """The same motions with other gains of the joint PD."""

    name = "gains"
    cost = 1

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
        for plan in Repetition().plans(given):
            gains = [name for name in plan.columns if name.startswith(("cmd_kp/", "cmd_kd/"))]
            columns = dict(plan.columns) | {name: self.factor * plan[name] for name in gains}
            found.append(replace(plan, columns=columns))
        return found

    def words(self, given: Given) -> str:
        """What to do, with the factor and the gains that it gives."""
        return f"record the same motions again with {self.factor:g} times the gains ({self.gains(given)})"

    def gains(self, given: Given) -> str:
        """``kp 40`` or a range over joints."""
        values = sorted({float(f"{self.factor * value:.3g}") for value in given.median("cmd_kp").values() if value > 0})
        return f"kp {values[0]:g}" + (f" to {values[-1]:g}" if len(values) > 1 else "") if values else "kp 0"

    @property
    def short(self) -> str:
        """The factor on the gains, in a few words."""
        return f"with {self.factor:g} times the gains"
