"""Goal-directed jumps after practice: a landing model of the robot's own jumps chooses the goals."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects import to_config
from leapgap.errors import InputError
from leapgap.jumping.experiments.goal_directed_jump import LandingModel
from leapgap.jumping.experiments.method import AimingMethod, JumpTask, Method
from leapgap.jumping.experiments.rig import AdaptConfig, Bench, MethodSettings, Rig
from leapgap.jumping.experiments.training_jumps import run_practice


@dataclass(frozen=True)
class OursSettings(MethodSettings):
    """Makes the training jumps of ``land.practice`` first."""

    name = "ours"

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Make the training jumps, and fit the planner and the landing model to them."""
        settings = rig.settings
        start = AimingMethod(rig.robot, rig.bench.references, planner=rig.planner)
        learned = run_practice(rig.bench, start, settings.practice)
        print(f"{rig.bench.hardware}: found {json.dumps(to_config(learned.effects))}", flush=True)
        return replace(start, planner=learned.planner, landing=LandingModel(learned.samples, settings.practice.aim))


FIRST_ADAPTATION_RUN = 800
"""Number of the first run that offsets are learned from; ground and sensors differ from those of the scored runs."""


@dataclass(frozen=True)
class OursAdaptedSettings(MethodSettings):
    """Adapts another goal-directed method with the settings ``land.adapt``."""

    name = "ours_adapted"

    of: str = "ours"  # Name of the method that is adapted

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Make a few jumps of every task, and learn the offsets from them."""
        aiming = rig.method(self.of)
        if not isinstance(aiming, AimingMethod):
            raise InputError(f"land.method_settings.{name}.of", self.of, "a method that aims", "name ours")
        return adapt_offsets(rig.bench, aiming, rig.tasks, rig.settings.adapt)


def adapt_offsets(bench: Bench, method: AimingMethod, tasks: Sequence[JumpTask], config: AdaptConfig) -> AimingMethod:
    """The method with an offset for each task, updated after each of ``config.jumps`` jumps of that task."""
    assert method.landing is not None
    for number in range(config.jumps):
        trials = [bench.trial("adapting", method, task, FIRST_ADAPTATION_RUN + number) for task in tasks]
        offset = dict(method.offset)
        for trial, done in zip(trials, bench.runner.results(trials), strict=True):
            if len(done.samples):
                before = offset.get(trial.task.name, np.zeros(3))
                pairs = zip(done.samples.goal, done.samples.stance_pitch, done.samples.landing, strict=True)
                off = [landed - method.landing.landing(goal, stance) for goal, stance, landed in pairs]
                error = np.mean(off, axis=0) - before
                offset[trial.task.name] = before + config.rate * error
        method = replace(method, offset=offset)
    return method
