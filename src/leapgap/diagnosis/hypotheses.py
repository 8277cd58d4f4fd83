"""Hypotheses about the cause: each known effect at each place where it can act, with the numbers that are fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect, Parameter
from leapgap.robot.model import Robot

NEAR_BOUND = 0.02
"""A fit is at the end of a range when its distance to it is a smaller share of the way there from nominal."""

STEP, RUNGS = 3.0, 5  # Ratio of the numbers of a ladder, and how many there are at most to each side

MOST_PARTS = 8
"""Largest number of parts of a robot, joints or joint groups, at each of which an effect gets a number of its own."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect at one place of a robot; all its parameters are fitted together.

    An effect that differs from log to log takes an estimate for each log from ``per_log``: one value, or several evenly
    spaced over the log where it changes within. These estimates do not use the channels that are scored. The fitted
    number is then the share of their departure from nominal that is applied, common to all logs.
    """

    kind: type[Effect]
    robot: Robot
    location: str = "all"
    per_log: Mapping[str, tuple[float, ...]] | None = field(default=None, compare=False)

    @property
    def name(self) -> str:
        """Name of the effect on this robot."""
        return self.kind.called(self.robot)

    @property
    def label(self) -> str:
        """Effect and place: ``joint_damping``, or ``joint_damping at elbow``."""
        return self.name if self.location == "all" else f"{self.name} at {self.location}"

    @cached_property
    def effect_parameters(self) -> tuple[Parameter, ...]:
        """The effect's own parameters, at this place of the robot."""
        return self.kind.parameters(self.robot, self.location)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that are fitted: the effect's own, or the share of the estimates ``per_log``."""
        return self.effect_parameters if self.per_log is None else (Parameter("share", "1", 0.0, 0.0, 1.25, 1.0),)

    @property
    def nominal(self) -> np.ndarray:
        """The numbers at which the effect is absent, (numbers,)."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits of the numbers, (numbers,) each."""
        return np.array([p.lower for p in self.parameters]), np.array([p.upper for p in self.parameters])

    @property
    def moderate(self) -> np.ndarray:
        """Departure from nominal with a noticeable influence on the motion, (numbers,)."""
        return np.array([p.moderate - p.nominal for p in self.parameters])

    @property
    def ladder(self) -> list[np.ndarray]:
        """Numbers far from nominal, one number at a time, on the way to the ends of its range.

        Each is a few times as far from nominal as the last. On the way to zero, where a factor goes there, they are
        twice as close: a limit (of a torque, of a rate) shows from one number on, and soon nothing is left of a motion.
        """
        (nominal,), (moderate,), (lower,), (upper,) = self.nominal, np.abs(self.moderate), *self.bounds
        found = [nominal + side * moderate * STEP**k for side in (-1, 1) for k in range(1, RUNGS)]
        found += [
            (nominal - moderate) / STEP ** (k / 2) for k in range(2 * RUNGS - 1) if 0 < lower < nominal - moderate
        ]
        return [np.array([own]) for own in found if lower < own < upper]

    def on(self, log: str, numbers: np.ndarray) -> Effect:
        """The effect with these numbers on one log."""
        effect = self.kind(location=self.location, **self.values(log, numbers))
        if self.per_log is None or len(self.per_log.get(log, ())) <= 1:
            return effect
        local = 1 + float(numbers[0]) * (np.array(self.per_log[log]) - 1)
        return effect.with_profile(tuple((local / local.mean()).tolist()))

    def values(self, log: str, numbers: np.ndarray) -> dict[str, float]:
        """Values of the effect's parameters on one log; on a log yet to be made they are as on those there are."""
        if self.per_log is None:
            return {p.name: float(n) for p, n in zip(self.effect_parameters, numbers, strict=True)}
        (p,) = self.effect_parameters
        estimates = self.per_log.get(log, np.concatenate(list(self.per_log.values())))
        value = p.nominal + float(numbers[0]) * (float(np.mean(estimates)) - p.nominal)
        return {p.name: float(np.clip(value, p.lower, p.upper))}

    def typical_value(self, name: str, numbers: np.ndarray, logs: Sequence[str]) -> float:
        """Value of a parameter at numbers within their ranges, the median over logs where it differs by log."""
        own = self.clip(numbers)
        return float(np.median([self.values(log, own)[name] for log in logs]))

    def clip(self, numbers: np.ndarray) -> np.ndarray:
        """Clip numbers to their ranges."""
        return np.clip(numbers, *self.bounds)

    def near(self, numbers: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        """Numbers clipped to their ranges, and factors to one step from what they were ``before``."""
        if before is not None:
            factor = np.array([p.logarithmic for p in self.parameters])
            numbers = np.where(factor, np.clip(numbers, before / STEP, before * STEP), numbers)
        return self.clip(numbers)

    def at_bound(self, numbers: np.ndarray) -> bool:
        """Whether a fitted number is at the end of its range, away from nominal, so that no value in the range fits.

        A physical limit, such as zero friction, does not count.
        """
        return any(ran_out(p, float(n)) for p, n in zip(self.parameters, numbers, strict=True))


def ran_out(parameter: Parameter, number: float) -> bool:
    """Whether a number is at an end of the parameter's range that is neither nominal nor physical."""
    nominal, ends = (
        parameter.nominal,
        [parameter.upper] if parameter.lower_is_physical else [parameter.lower, parameter.upper],
    )
    if parameter.logarithmic:
        number, nominal, *ends = np.log([max(number, parameter.lower), nominal, *ends]).tolist()
    return any(abs(number - end) < NEAR_BOUND * abs(end - nominal) for end in ends if end != nominal)


def places(kind: type[Effect], robot: Robot) -> dict[str, tuple[str, ...]]:
    """Locations at which an effect can act → the joints or feet of each, largest locations first."""
    of = kind.places
    if of == "none" or (of == "feet" and not robot.feet):
        return {"all": ("all",)}
    single = robot.joints if of == "joints" else robot.feet
    at = robot.joints_at if of == "joints" else robot.feet_at
    groups = [*robot.limbs_of_pair, *((*robot.joint_groups, *robot.topology.limbs) if of == "joints" else ())]
    found: dict[str, tuple[str, ...]] = {}
    for location in ("all", *groups, *single):
        members = tuple(single[i] for i in at(location) if not kind.needs_motor or robot.driven[i])
        if members and members not in found.values():
            found[location] = members
    return found


def parts_of(kind: type[Effect], robot: Robot) -> tuple[str, ...]:
    """Places that make up a robot, at each of which an effect may have another number; empty where it may not.

    Single joints of a small robot, groups of joints that are alike of a larger one. What acts on commands acts on
    all of them alike.
    """
    if kind.places != "joints" or kind.change_commands is not Effect.change_commands:
        return ()
    of = places(kind, robot)
    single = tuple(at for at, joints in of.items() if len(joints) == 1)
    grouped = tuple(at for at in of if at in robot.joint_groups)
    for parts in (single, grouped):
        joints = [joint for at in parts for joint in of[at]]
        if 2 <= len(parts) <= MOST_PARTS and sorted(joints) == sorted(of["all"]):
            return parts
    return ()


def tolerance(kind: type[Effect], robot: Robot, place: str, parameter: str, share: float) -> float:
    """Standard deviation of an effect's parameter at a place, in its unit: a share of the model's own value there."""
    (scale,) = (p.scale for p in kind.parameters(robot, place) if p.name == parameter)
    return share * scale


def usable(kind: type[Effect], robot: Robot) -> bool:
    """Whether a robot has all that an effect needs."""
    return kind.lacks(robot) is None


def list_hypotheses(
    wanted: Sequence[str | type[Effect]], robot: Robot, clock: Mapping[str, tuple[float, ...]] | None
) -> list[Hypothesis]:
    """Hypotheses of every effect (a known one by name, or a class) at every location.

    An effect that differs from log to log takes its values from the clock of each log, if there is one.
    """
    own = [kind for kind in wanted if not isinstance(kind, str)]
    kinds = effects.registry(own)
    return [
        Hypothesis(kind, robot, location, clock if kind.differs_per_log else None)
        for kind in (kinds[one] if isinstance(one, str) else one for one in wanted)
        if usable(kind, robot)
        for location in places(kind, robot)
    ]
