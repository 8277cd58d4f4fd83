"""What may be the cause: each known effect at each place where it can act, with the numbers that are fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect, Parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place; all its parameters are fitted together.

    An effect that differs from log to log gets its value on each log from ``per_log`` (found without what is
    scored), one value, or several evenly spaced over the log where it changes within; the fitted number is then the
    share of that estimate's departure from nominal that is believed, common to all logs.
    """

    name: str
    location: str = "all"
    per_log: Mapping[str, tuple[float, ...]] | None = field(default=None, compare=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is fitted."""
        own = effects.known()[self.name].parameters()
        return own if self.per_log is None else (Parameter("share", "1", 0.0, 0.0, 1.25, 1.0),)

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
        effect = effects.known()[self.name](location=self.location, **self.values(log, numbers))
        if self.per_log is None or len(self.per_log[log]) == 1:
            return effect
        local = 1 + float(numbers[0]) * (np.array(self.per_log[log]) - 1)
        return effect.changing(tuple((local / local.mean()).tolist()))

    def values(self, log: str, numbers: np.ndarray) -> dict[str, float]:
        """The effect's parameters on one log."""
        own = effects.known()[self.name].parameters()
        if self.per_log is None:
            return {p.name: float(n) for p, n in zip(own, numbers, strict=True)}
        (p,) = own
        value = p.nominal + float(numbers[0]) * (float(np.mean(self.per_log[log])) - p.nominal)
        return {p.name: float(np.clip(value, p.lower, p.upper))}

    def clipped(self, numbers: np.ndarray) -> np.ndarray:
        """Numbers within their range."""
        return np.clip(numbers, *self.bounds)

    def allows(self, numbers: np.ndarray) -> bool:
        """Whether numbers are in their range."""
        return bool((self.clipped(numbers) == numbers).all())

    def at_bound(self, numbers: np.ndarray) -> bool:
        """Whether a fit ran to the end of a range, away from nominal: no sensible value fits."""
        lower, upper = self.bounds
        near = 0.02 * (upper - lower)
        return bool(
            any(
                abs(n - bound) < margin
                for n, low, high, margin, nominal in zip(numbers, lower, upper, near, self.nominal, strict=True)
                for bound in (low, high)
                if bound != nominal
            )
        )


def places(name: str, robot: Robot) -> dict[str, tuple[str, ...]]:
    """Where an effect can act: location → the single joints or feet it stands for, coarse ones first."""
    of = effects.known()[name].places
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


def usable(name: str, robot: Robot) -> bool:
    """Whether a robot can have an effect at all."""
    kind = effects.known()[name]
    return robot.has_free_base or not (kind.needs_base or kind.places == "feet")


def hypotheses_of(
    names: Sequence[str], robot: Robot, clock: Mapping[str, tuple[float, ...]] | None
) -> list[Hypothesis]:
    """Every effect at every place; one that differs by log takes its values from the clock of each log, if any."""
    return [
        Hypothesis(name, location, clock if effects.known()[name].differs_per_log else None)
        for name in names
        if usable(name, robot)
        for location in places(name, robot)
    ]
