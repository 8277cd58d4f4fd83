"""Goal-directed jumps after practice: a landing model of the robot's own jumps chooses the goals."""

import json
from dataclasses import dataclass, replace

from leapgap.effects import to_config
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.landing_model import LandingModel
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.aiming import AimingMethod
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.rig import Rig
from leapgap.jumping.experiments.training_jumps import run_practice
from leapgap.jumping.models.planar import planar_robot


@dataclass(frozen=True)
class OursSettings(MethodSettings):
    """Makes the training jumps of ``land.practice`` first."""

    name = "ours"

    def prepare(self, name: str, rig: Rig) -> Method | None:
        """Make the training jumps, and fit the planner and the landing model to them."""
        settings = rig.settings
        planner = JumpPlanner(planar_robot(rig.robot), settings.schedule, settings.limits)
        start = AimingMethod(rig.robot, rig.bench.references, planner=planner)
        learned = run_practice(rig.bench, start, settings.practice)
        print(f"{rig.bench.hardware}: found {json.dumps(to_config(learned.effects))}", flush=True)
        return replace(start, planner=learned.planner, landing=LandingModel(learned.samples, settings.practice.aim))
