"""Write the goal-shift controller of one jump as C, NumPy and ONNX, for a robot that runs without leapgap.

Examples:

    python -m stages.export export.hardware=worn 'export.target=[0.6,0.0]' export.out=controller
"""

import math
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from omegaconf import DictConfig

from leapgap.errors import InputError
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.experiments.bench import TrialRunner
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump
from leapgap.jumping.experiments.landing_experiment import RUNS, print_trial
from leapgap.jumping.experiments.rig import LandSettings, Rig
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.export.write import write_controller
from leapgap.jumping.planning.problem import Problem
from leapgap.jumping.task import Target
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import whole_folder
from stages.common import output_folder, read_config, run_stage
from stages.land import experiment_of

STAGE = "stages.export"


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


def export(config: DictConfig) -> None:
    """Let the robot practise, or read its practice; plan the jump, and write its controller."""
    chosen = read_config(ExportSettings, config.export, "export")
    executor = read_config(Executor, config.executor, "executor")
    settings = read_config(LandSettings, config.land, "land")
    settings = replace(settings, hardware=[chosen.hardware], methods=[chosen.method], only={})
    experiment = experiment_of(config, settings)
    inputs = (settings.references, chosen.landings, config.robot.model)
    out = output_folder(chosen.out, STAGE, inputs)
    (hardware,) = experiment.hardware
    with practice_of(chosen.landings, hardware.place) as cache:
        tracker = tracker_of(chosen, experiment.rig(hardware, TrialRunner(cache, executor.map, print_trial)))
    x, z = chosen.target
    about = {
        "robot": experiment.robot.name,
        "hardware": chosen.hardware,
        "method": chosen.method,
        "target_m": {"x": x, "z": z},
        "stance_pitch_rad": chosen.stance_pitch_rad,
    }
    with whole_folder(out, STAGE) as folder:
        tables = write_controller(tracker, folder, about)
    print(f"a jump of {x:g} m to {z:g} m, {tables.numbers['ROWS']} rows, {tables.numbers['UPDATES']} updates -> {out}")
    if tracker.late is not None:
        until_ms = round(1000 * tracker.late.until_s)
        print(f"it measures the slope of the ground in the first {until_ms} ms, {span_of(tracker.late.pitches)} rad")
    elif not chosen.stance_is_seen:
        print("there is no plan from another slope: it does not measure the ground, which must slope as configured")
    print(f"run it: cd {out} && gcc -O2 *.c -o jump -lm")


def span_of(values: np.ndarray) -> str:
    """The first and the last of rising values."""
    return f"{values[0]:g} to {values[-1]:g}"


@contextmanager
def practice_of(landings: str | None, place: str) -> Iterator[ResultCache]:
    """A cache with a copy of the practice of a robot, if there is any: the results of stage land stay as they are."""
    with tempfile.TemporaryDirectory() as folder:
        for path in (Path(landings) / RUNS / place).glob("practice*") if landings else ():
            if path.is_dir():
                shutil.copytree(path, Path(folder) / place / path.name)
        yield ResultCache(Path(folder))


def tracker_of(chosen: ExportSettings, rig: Rig) -> ShiftTracker:
    """The controller of the jump to the target, before its first tick."""
    task = JumpTask("export", *chosen.target, stance_is_seen=chosen.stance_is_seen)
    reference = Reference.of(rig.plan(task.target), rig.robot)  # a jump that no robot does is refused before practice
    method = rig.method(chosen.method)
    jump = None if method is None else method.controller(task, reference)
    if not isinstance(jump, GoalShiftJump):
        raise InputError("export.method", chosen.method, "a method of kind learned_goal_mpc", "choose one")
    tracker = jump.plan_from(chosen.stance_pitch_rad)
    if not isinstance(tracker, ShiftTracker):
        found = f"no plans to ({chosen.target[0]:g}, {chosen.target[1]:g}) m and around it"
        raise InputError("export.target", found, "a jump within the robot's limits", "choose a nearer target")
    return tracker


if __name__ == "__main__":
    run_stage(export)
