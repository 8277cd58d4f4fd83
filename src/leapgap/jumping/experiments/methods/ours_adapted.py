"""Aimed jumps with an offset for each task on top, learned from a few jumps of that task."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.landing_model import LandingModel, Tried
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.aiming import ByAiming
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.rig import AdaptConfig
from leapgap.jumping.experiments.tasks import JumpTask

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import Rig


ADAPTING = 800
"""Number of the first run that an offset is learned from: other ground and sensors than in those that count."""


@dataclass(frozen=True)
class OursAdaptedSettings(MethodSettings):
    """Adapts another method that aims, as ``land.adapt`` says."""

    name = "ours_adapted"

    of: str = "ours"
    """Name of the method that is adapted."""

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Jump every task a few times."""
        aiming = rig.method(self.of)
        if not isinstance(aiming, ByAiming):
            raise InputError(f"land.method_settings.{name}.of", self.of, "a method that aims", "name ours")
        return adapted(rig.bench, aiming, rig.tasks, rig.settings.adapt)


def adapted(bench: Bench, method: ByAiming, tasks: Sequence[JumpTask], config: AdaptConfig) -> ByAiming:
    """With an offset for each task, learned from its own first jumps."""
    assert method.landing is not None
    for number in range(config.jumps):
        trials = [bench.trial("adapting", method, task, ADAPTING + number) for task in tasks]
        offset = dict(method.offset)
        for trial, done in zip(trials, bench.runner.results(trials), strict=True):
            if len(done.tried):
                before = offset.get(trial.task.name, np.zeros(3))
                surprise = surprises(method.landing, done.tried).mean(axis=0) - before
                offset[trial.task.name] = before + config.rate * surprise
        method = replace(method, offset=offset)
    return method


def surprises(model: LandingModel, tried: Tried) -> np.ndarray:
    """How much farther than predicted each jump landed, (n, 3)."""
    pairs = zip(tried.goal, tried.stance_pitch, tried.landing, strict=True)
    return np.array([landed - model.landing(goal, stance) for goal, stance, landed in pairs])
