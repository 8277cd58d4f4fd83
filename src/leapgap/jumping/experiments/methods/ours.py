"""Aimed jumps after practice: where the robot lands was learned from its own jumps, and decides where to aim."""

import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from leapgap.effects import to_config
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.landing_model import LandingModel
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.methods.aiming import ByAiming
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.training_jumps import practised
from leapgap.jumping.models.planar import planar_robot

if TYPE_CHECKING:
    from leapgap.jumping.experiments.rig import Rig


@dataclass(frozen=True)
class OursSettings(MethodSettings):
    """Practises as ``land.practice`` says."""

    name = "ours"

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Practise, and learn from it where jumps land."""
        settings = rig.settings
        planner = JumpPlanner(planar_robot(rig.robot), settings.schedule, settings.limits)
        start = ByAiming(rig.robot, rig.bench.references, planner=planner)
        learned = practised(rig.bench, start, settings.practice)
        print(f"{rig.bench.hardware}: found {json.dumps(to_config(learned.found))}", flush=True)
        return replace(start, planner=learned.planner, landing=LandingModel(learned.tried, settings.practice.aim))
