"""What may be the cause: each known effect at each place where it can act, with the numbers that are fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect, Parameter
from leapgap.robot.model import Robot

NEAR_BOUND = 0.02
"""A fit is at the end of a range where so small a share of the way there from nominal is left."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place of a robot; all its parameters are fitted together.

    An effect that differs from log to log gets its value on each log from ``per_log`` (found without what is
    scored), one value, or several evenly spaced over the log where it changes within; the fitted number is then the
    share of that estimate's departure from nominal that is believed, common to all logs.
    """

    kind: type[Effect]
    robot: Robot
    location: str = "all"
    per_log: Mapping[str, tuple[float, ...]] | None = field(default=None, compare=False)

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.kind.name

    @cached_property
    def effect_parameters(self) -> tuple[Parameter, ...]:
        """The effect's own parameters, at this place of the robot."""
        return self.kind.parameters(self.robot, self.location)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is fitted."""
        return self.effect_parameters if self.per_log is None else (Parameter("share", "1", 0.0, 0.0, 1.25, 1.0),)

    @property
    def nominal(self) -> np.ndarray:
        """The numbers at which the effect is absent, (numbers,)."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Range of sensible numbers."""
        return np.array([p.lower for p in self.parameters]), np.array([p.upper for p in self.parameters])

    @property
    def moderate(self) -> np.ndarray:
        """Departure from nominal that a person would notice, (numbers,)."""
        return np.array([p.moderate - p.nominal for p in self.parameters])

    def on(self, log: str, numbers: np.ndarray) -> Effect:
        """The effect on one log."""
        effect = self.kind(location=self.location, **self.values(log, numbers))
        if self.per_log is None or len(self.per_log[log]) == 1:
            return effect
        local = 1 + float(numbers[0]) * (np.array(self.per_log[log]) - 1)
        return effect.with_profile(tuple((local / local.mean()).tolist()))

    def values(self, log: str, numbers: np.ndarray) -> dict[str, float]:
        """The effect's parameters on one log."""
        if self.per_log is None:
            return {p.name: float(n) for p, n in zip(self.effect_parameters, numbers, strict=True)}
        (p,) = self.effect_parameters
        value = p.nominal + float(numbers[0]) * (float(np.mean(self.per_log[log])) - p.nominal)
        return {p.name: float(np.clip(value, p.lower, p.upper))}

    def clip(self, numbers: np.ndarray) -> np.ndarray:
        """Numbers within their range."""
        return np.clip(numbers, *self.bounds)

    def allows(self, numbers: np.ndarray) -> bool:
        """Whether numbers are in their range."""
        return bool((self.clip(numbers) == numbers).all())

    def at_bound(self, numbers: np.ndarray) -> bool:
        """Whether a fit ran to the end of a range, away from nominal: no sensible value fits.

        Where nature itself ends, as at a joint without friction, the end is as good a value as any other.
        """
        return any(ran_out(p, float(n)) for p, n in zip(self.parameters, numbers, strict=True))


def ran_out(parameter: Parameter, number: float) -> bool:
    """Whether a number is at an end of the parameter's range that is neither nominal nor physical."""
    ends = [parameter.upper] if parameter.lower_is_physical else [parameter.lower, parameter.upper]
    return any(
        abs(number - end) < NEAR_BOUND * abs(end - parameter.nominal) for end in ends if end != parameter.nominal
    )


def places(kind: type[Effect], robot: Robot) -> dict[str, tuple[str, ...]]:
    """Where an effect can act: location → the single joints or feet it stands for, coarse ones first."""
    of = kind.places
    if of == "none" or (of == "feet" and not robot.feet):
        return {"all": ("all",)}
    single = robot.joints if of == "joints" else robot.feet
    at = robot.joints_at if of == "joints" else robot.feet_at
    groups = [*robot.limbs_of_pair, *((*robot.joint_groups, *robot.topology.limbs) if of == "joints" else ())]
    found: dict[str, tuple[str, ...]] = {}
    for location in ("all", *groups, *single):
        members = tuple(single[i] for i in at(location))
        if members not in found.values():
            found[location] = members
    return found


def usable(kind: type[Effect], robot: Robot) -> bool:
    """Whether a robot can have an effect at all."""
    return kind.lacks(robot) is None


def list_hypotheses(
    wanted: Sequence[str | type[Effect]], robot: Robot, clock: Mapping[str, tuple[float, ...]] | None
) -> list[Hypothesis]:
    """Every effect, a known one by name or a class, at every place.

    One that differs by log takes its values from the clock of each log, if any.
    """
    own = [kind for kind in wanted if not isinstance(kind, str)]
    kinds = effects.registry(own)
    return [
        Hypothesis(kind, robot, location, clock if kind.differs_per_log else None)
        for kind in (kinds[one] if isinstance(one, str) else one for one in wanted)
        if usable(kind, robot)
        for location in places(kind, robot)
    ]
