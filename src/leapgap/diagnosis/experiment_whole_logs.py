"""Whether whole logs of an experiment would show the answer, or small errors of the model alone would hide it.

Short pieces may tell causes apart in a motion whose whole logs no simulation can replay: where feet slip, errors as
small as the tolerances of the model take a robot elsewhere within a second. A diagnosis judges its answer by whole
logs, and finds in such ones a gap that no cause closes. So an experiment is made in simulation by robots that differ
from the answer's as the model may differ from the real one, and judged as a further diagnosis would judge its logs.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap import effects
from leapgap.diagnosis.experiment_forecast import MOST_LOGS, Forecaster, short_plan
from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.gap import candidate_squares
from leapgap.diagnosis.hypotheses import places, tolerance, usable
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.short_rollouts import FINE
from leapgap.diagnosis.simulation_settings import SimulationSettings
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.rollout import Rollout

CONTACT_TIMES = (0.9, 1.1)
"""Factors on the time constants of contacts of the robots that make an experiment, one robot each.

Their other numbers are drawn within the tolerances of the model, and they are simulated by short steps.
"""
LEAST_SHOWN = 0.6
"""The right answer must close this share of what it closes in the same motions, made again.

A further diagnosis judges all logs together, and new ones that show much less of the answer hide what the others show.
Jumps with other gains or blocks had 0.64 to 1.6; sines of a standing robot up to 0.1, and 0.5 where all joints swing
fast."""


@dataclass(frozen=True)
class WholeLogs:
    """Judges experiments by their whole logs."""

    forecaster: Forecaster

    def show_answer(self, experiment: Experiment) -> bool:
        """Whether whole logs of an experiment show the answer about as well as those of the logged motions."""
        return self.closes(experiment) >= self.least

    @cached_property
    def least(self) -> float:
        """What the right answer must close: of what it closes in the same motions, made again by such robots."""
        return LEAST_SHOWN * max(0.0, self.closes(Repetition()))

    def closes(self, experiment: Experiment) -> float:
        """Share of the gap of an experiment's whole logs that the right answer closes, those of all robots together.

        Below 0 where the nominal robot is nearer. Noise of the sensors stays part of the gap.
        """
        rng = np.random.default_rng(self.forecaster.seed)
        before, after = np.sum([self.squares(experiment, time, rng) for time in CONTACT_TIMES], axis=0)
        return float(1 - np.sqrt(after / before)) if before > 0 else 0.0

    def squares(self, experiment: Experiment, contact_time: float, rng: np.random.Generator) -> np.ndarray:
        """Sums of squares that the nominal robot and the right answer leave in one robot's logs, (2,).

        Of long logs the first part is made (``short_plan``). Channels and their sizes are those of a diagnosis of
        these and the given logs together.
        """
        of, given = self.forecaster, self.forecaster.given
        plans = [short_plan(plan) for plan in experiment.plans(given)[:MOST_LOGS]]
        made = self.logs_of(plans, contact_time, rng)
        every = JudgedLogs.of([*given.logs, *made], of.robot)
        judged = replace(every, whole=every.whole[len(given.logs) :], states=every.states[len(given.logs) :])
        answer = of.answer.effects_on("", None)
        sets = [[own] * len(made) for own in ((), answer)]
        return np.asarray(candidate_squares(judged, of.replayer, sets).sum(axis=1))

    def logs_of(self, plans: Sequence[Log], contact_time: float, rng: np.random.Generator) -> list[Log]:
        """Noisy logs of plans by the answer's robot with errors within the tolerances, simulated by short steps."""
        of = self.forecaster
        acting = (
            *of.answer.effects_on("", None),
            *self.errors(rng),
            SimulationSettings(contact_time=contact_time),
        )
        motions = of.replayer.with_steps(FINE * of.replayer.largest_step_s).motions([Rollout(p, acting) for p in plans])
        logs = [of.measured(plan, motion, of.replayer, rng) for plan, motion in zip(plans, motions, strict=True)]
        return [replace(log, name=f"experiment_{k}") for k, log in enumerate(logs)]

    def errors(self, rng: np.random.Generator) -> tuple[Effect, ...]:
        """Errors of the model, drawn within its tolerances at each place.

        None of effects that the answer has, and of a user's own.
        """
        of = self.forecaster
        free = {key: share for key, share in of.tolerances.items() if key.partition(".")[0] not in of.answer.names}
        return tuple(tolerance_effects(of.robot, free, iter(rng.standard_normal, None)))


def tolerance_effects(robot: Robot, tolerances: Mapping[str, float], deviations: Iterator[float]) -> list[Effect]:
    """One effect for each tolerance (``Settings.tolerances``) and single place, off by the next of some deviations.

    These are in standard deviations.
    """
    kinds, found = effects.known(), []
    for name, share in tolerances.items():
        effect, _, parameter = name.partition(".")
        if effect not in kinds or not usable(kinds[effect], robot):
            continue
        kind: Callable[..., Effect] = kinds[effect]
        for place in places(kinds[effect], robot)["all"]:
            (own,) = (p for p in kinds[effect].parameters(robot, place) if p.name == parameter)
            off = tolerance(kinds[effect], robot, place, parameter, share) * next(deviations)
            found.append(kind(location=place, **{parameter: own.nominal + off}))
    return found
