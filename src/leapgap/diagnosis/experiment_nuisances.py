"""Nuisances of a forecast: what a model has only within a tolerance, and the error of the simulation's steps."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.hypotheses import Hypothesis, places, tolerance, usable
from leapgap.diagnosis.short_rollouts import FINE, Effects, ShortRollouts
from leapgap.effects.base import Effect, overrides
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Nuisances:
    """What nuisances change of short pieces of a robot with some causes."""

    short: ShortRollouts  # The pieces, their errors whitened for that robot
    columns: np.ndarray
    """Changes of the whitened errors by one standard deviation of each nuisance, (pieces, values, nuisances)."""

    @staticmethod
    def of(short: ShortRollouts, answer: Candidate, tolerances: Mapping[str, float]) -> "Nuisances":
        """Replay a moderate departure of each tolerance (``Settings.tolerances``) at each single place.

        The first nuisance is the error of the steps, unless some effect acts on these.
        """
        robot, acting = short.state.robot, answer.effects_on("", None)
        short = short.whiten_for(short.on_every_log(acting))
        further, sizes, kinds = list[Effect](), list[float](), {h.kind for h in answer.hypotheses}
        for name, share in tolerances.items():
            effect, _, parameter = name.partition(".")
            kind = effects.known()[effect]
            if not usable(kind, robot) or (effect in answer.names and not keeps_tolerance(kind, robot)):
                continue
            kinds.add(kind)
            for place in places(kind, robot)["all"]:
                there = Hypothesis(kind, robot, place)
                number = [p.name for p in there.effect_parameters].index(parameter)
                by = np.eye(len(there.nominal))[number] * there.moderate
                further.append(there.on("", there.nominal + by))
                sizes.append(tolerance(kind, robot, place, parameter, share) / by[number])
        start, *changed = errors_of(short, [acting, *((*acting, one) for one in further)])
        found = [size * (errors - start) for size, errors in zip(sizes, changed, strict=True)]
        if not any(overrides(kind, "change_step") for kind in kinds):
            (stepped,) = errors_of(short.with_steps(FINE * short.replayer.largest_step_s), [acting])
            found.insert(0, stepped - start)
        return Nuisances(short, np.stack(found, axis=2) if found else np.zeros((*start.shape, 0)))


def errors_of(short: ShortRollouts, sets: list[Effects]) -> list[np.ndarray]:
    """Whitened errors of the pieces of all logs with several sets of effects, (pieces, values) each."""
    return [np.concatenate(of_logs) for of_logs in short.residuals([short.on_every_log(one) for one in sets])]


def keeps_tolerance(kind: type[Effect], robot: Robot) -> bool:
    """Whether what each place is off by stays in question where an effect of that kind acts.

    One number for all joints leaves what each of them is off by. It does so where none of the effect's numbers stands
    in place of the model's, and on held robots alone: in short pieces of jumps it would hide what acts slowly.
    """
    return not robot.has_free_base and all(own.nominal is not None for own in kind.declarations().values())
