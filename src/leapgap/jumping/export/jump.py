"""The controller of one jump to export: the robot practises, or its practice is read, and the jump is planned."""

import math
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.mpc_controller import JumpMpc
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.experiments.bench import TrialRunner
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump
from leapgap.jumping.experiments.landing_experiment import RUNS, LandingExperiment, print_trial
from leapgap.jumping.experiments.methods.goal_practised_mpc import GoalMpcJump
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.planning.problem import Problem
from leapgap.jumping.task import Target
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor


@dataclass(frozen=True)
class ExportSettings:
    """Section ``export`` of the configuration."""

    method: str
    hardware: str
    target: tuple[float, float]
    stance_pitch_rad: float
    stance_is_seen: bool
    landings: str | None
    out: str | None

    def __post_init__(self) -> None:
        """Refuse what is no jump before the robot practises for minutes."""
        if len(self.target) != 2 or not all(map(math.isfinite, self.target)):
            raise ValueError(f"target {list(self.target)}: x and z of the landing, two numbers, m")
        Problem(Target(*self.target))  # refuses what is beyond all jumps
        if not abs(self.stance_pitch_rad) < math.pi / 2:
            raise ValueError(f"stance_pitch_rad {self.stance_pitch_rad}: less than a quarter turn, rad")

    def about(self, robot: str) -> dict[str, Any]:
        """What ``controller.json`` says of the jump."""
        x, z = self.target
        named = {"robot": robot, "hardware": self.hardware, "method": self.method}
        return named | {"target_m": {"x": x, "z": z}, "stance_pitch_rad": self.stance_pitch_rad}

    @property
    def in_words(self) -> str:
        """``a jump of 0.6 m to 0 m``."""
        return "a jump of {:g} m to {:g} m".format(*self.target)

    def ground_in_words(self, tracker: ShiftTracker | JumpMpc) -> list[str]:
        """What the controller does about a slope of the ground, where that is to be said."""
        if isinstance(tracker, ShiftTracker) and tracker.late is not None:
            until_ms, pitches = round(1000 * tracker.late.until_s), tracker.late.pitches
            slopes = f"{pitches[0]:g} to {pitches[-1]:g} rad"
            return [f"it measures the slope of the ground in the first {until_ms} ms, {slopes}"]
        why = "" if isinstance(tracker, JumpMpc) else "there is no plan from another slope: "
        says = f"{why}it does not measure the ground, which must slope as configured"
        return [] if self.stance_is_seen else [says]


def tracker_of(chosen: ExportSettings, experiment: LandingExperiment, executor: Executor) -> ShiftTracker | JumpMpc:
    """The controller of the jump to the target, before its first tick, on the only hardware of an experiment.

    It practises from a copy of the practice below ``landings``: the results of stage land stay as they are.
    """
    (hardware,) = experiment.hardware
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in (Path(chosen.landings) / RUNS / hardware.place).glob("practice*") if chosen.landings else ():
            if path.is_dir():
                shutil.copytree(path, folder / hardware.place / path.name)
        practised = experiment.settings.practised
        earlier = ResultCache(Path(practised) / RUNS) if practised else None
        rig = experiment.rig(hardware, TrialRunner(ResultCache(folder), executor.map, print_trial, earlier=earlier))
        task = JumpTask("export", *chosen.target, stance_is_seen=chosen.stance_is_seen)
        reference = Reference.of(rig.plan(task.target), rig.robot)  # refuses what no robot does, before practice
        method = rig.method(chosen.method)
        jump = None if method is None else method.controller(task, reference)
        if not isinstance(jump, GoalShiftJump | GoalMpcJump | JumpMpc):
            kinds = "a method of kind learned_goal_mpc, practised_mpc or goal_practised_mpc"
            raise InputError("export.method", chosen.method, kinds, "choose one")
        if isinstance(jump, JumpMpc) and chosen.stance_pitch_rad:
            expected = f"0: plans of {chosen.method} begin on level ground"
            raise InputError("export.stance_pitch_rad", f"{chosen.stance_pitch_rad:g}", expected, "leave it out")
        tracker = jump if isinstance(jump, JumpMpc) else jump.plan_from(chosen.stance_pitch_rad)
    if not isinstance(tracker, ShiftTracker | JumpMpc):
        found = "no plans to ({:g}, {:g}) m and around it".format(*chosen.target)
        raise InputError("export.target", found, "a jump within the robot's limits", "choose a nearer target")
    return tracker
