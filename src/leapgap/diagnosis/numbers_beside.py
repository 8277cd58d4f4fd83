"""Numbers of a simulation that are in no question and not known either: its step, and the tolerances of its model.

A landing of a robot whose masses are wrong by half a percent may look like a trunk that turns 20 % easier. So beside
the numbers of effects a joint likelihood has those of what is wrong within tolerances and of the simulation's own step.
They are found anew at every point. What they change is small, hence taken as linear.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap import effects
from leapgap.diagnosis.hypotheses import places, usable
from leapgap.diagnosis.log_errors import LogErrors, normal_equations
from leapgap.diagnosis.sensitivities import keeps_tolerance, tolerance
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot

ITERATIONS = 3
"""Least squares for the numbers, whose weights are those of the numbers before."""
EXPECTED_STEPS, SPREAD_STEPS, MOST_STEPS = 0.4, 0.5, 1.5
"""Share of short steps that is expected, its standard deviation, and the largest one. The limit of short steps is at
1.3 of what steps of a quarter change, steps twice as long are at −1.3."""
TOLD = 0.05
"""Combinations of tolerances of which logs tell less, as a share of what is known beforehand, are left out."""


@dataclass(frozen=True)
class NumbersBeside:
    """Numbers beside those of effects, in standard deviations, and what each changes in the errors."""

    changes: tuple[LogErrors, ...]
    """Derivatives of the errors of each log: whole (values, numbers) and pieces (pieces, values, numbers)."""
    expected: np.ndarray
    """What is expected beforehand, (numbers,), with a standard deviation of 1."""
    most: np.ndarray
    """Largest size of each, (numbers,)."""
    has_step: bool = False
    """Whether the first number is the share of short steps."""

    @staticmethod
    def none(logs: int) -> "NumbersBeside":
        """No numbers at all."""
        nothing = LogErrors(np.zeros((0, 0)), np.zeros((0, 0, 0)))
        return NumbersBeside((nothing,) * logs, np.zeros(0), np.zeros(0))

    @staticmethod
    def of_tolerances(
        start: Sequence[LogErrors], moved: Sequence[Sequence[LogErrors]], folds: np.ndarray
    ) -> "NumbersBeside":
        """Those of a model's tolerances, from errors ``[log]`` without and ``[tolerance][log]`` with each deviation.

        Combinations of which the logs tell next to nothing are left out, which saves time at every point.
        """
        changes = [
            LogErrors(
                np.stack([of[k].whole - own.whole for of in moved], axis=-1),
                np.stack([of[k].pieces - own.pieces for of in moved], axis=-1),
            )
            for k, own in enumerate(start)
        ]
        told, combinations = np.linalg.eigh(normal_equations(start, changes, folds)[0])
        chosen = combinations[:, told > TOLD]
        own = tuple(LogErrors(of.whole @ chosen, of.pieces @ chosen) for of in changes)
        return NumbersBeside(own, np.zeros(chosen.shape[1]), np.full(chosen.shape[1], np.inf))

    def with_step(self, usual: Sequence[LogErrors], by_short: Sequence[LogErrors]) -> "NumbersBeside":
        """The same after the share of short steps, from errors by usual and by short steps."""
        steps = [
            LogErrors(
                SPREAD_STEPS * (short.whole - own.whole)[:, None], SPREAD_STEPS * (short.pieces - own.pieces)[..., None]
            )
            for own, short in zip(usual, by_short, strict=True)
        ]
        changes = steps if not self.number else [a.beside(b) for a, b in zip(steps, self.changes, strict=True)]
        expected = np.append(EXPECTED_STEPS / SPREAD_STEPS, self.expected)
        return NumbersBeside(tuple(changes), expected, np.append(MOST_STEPS / SPREAD_STEPS, self.most), True)

    def without_step(self) -> "NumbersBeside":
        """The same by the steps as they are."""
        if not self.has_step:
            return self
        changes = tuple(LogErrors(of.whole[:, 1:], of.pieces[:, :, 1:]) for of in self.changes)
        return NumbersBeside(changes, self.expected[1:], self.most[1:])

    @property
    def number(self) -> int:
        """How many there are."""
        return len(self.expected)

    def likeliest(self, errors: Sequence[LogErrors], folds: np.ndarray) -> np.ndarray:
        """The most likely numbers at some errors, (numbers,)."""
        found = np.zeros(self.number)
        for _ in range(ITERATIONS if self.number else 0):
            curvature, slope = normal_equations(self.at(errors, found), self.changes, folds)
            by = np.linalg.solve(curvature + np.eye(self.number), slope + found - self.expected)
            found = np.clip(found - by, -self.most, self.most)
        return found

    def at(self, errors: Sequence[LogErrors], numbers: np.ndarray) -> list[LogErrors]:
        """Errors with the changes by such numbers, (numbers,)."""
        if not self.number:
            return list(errors)
        return [of.moved(by, numbers) for of, by in zip(errors, self.changes, strict=True)]

    def step_share(self, numbers: np.ndarray) -> float:
        """Share of short steps among such numbers: 0 by the usual steps, near 1 by short ones."""
        return float(SPREAD_STEPS * numbers[0]) if self.has_step else 0.0


def tolerance_effects(
    robot: Robot,
    tolerances: Mapping[str, float],
    acting: Sequence[tuple[str, str]] = (),
    alone: bool = False,
    deviations: Iterator[float] | None = None,
) -> list[Effect]:
    """One effect for each tolerance (``Settings.tolerances``) and single place, off by one standard deviation.

    With ``deviations`` each is off by the next of them, in standard deviations.

    Left out are effects that act already, as (name, location), but for those that keep their tolerance
    (``keeps_tolerance``). ``alone``: these lose it where they act at that single place, since their own number says
    there what it is off by.
    """
    kinds, found = effects.known(), []
    for name, share in tolerances.items():
        effect, _, parameter = name.partition(".")
        if effect not in kinds or not usable(kinds[effect], robot):
            continue
        at = [location for other, location in acting if other == effect]
        if at and not keeps_tolerance(kinds[effect], robot):
            continue
        kind: Callable[..., Effect] = kinds[effect]
        of = places(kinds[effect], robot)
        told = {of[location] for location in at if location in of} if alone else set()
        for place in of["all"]:
            if (place,) in told:
                continue
            (own,) = (p for p in kinds[effect].parameters(robot, place) if p.name == parameter)
            off = tolerance(kinds[effect], robot, place, parameter, share)
            off *= 1.0 if deviations is None else next(deviations)
            found.append(kind(location=place, **{parameter: own.nominal + off}))
    return found
