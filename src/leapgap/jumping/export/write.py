"""Writes the export of a controller: its tables, the code that runs them, and a landing model as ONNX."""

import math
import platform
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.mpc import JumpMpc
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump
from leapgap.jumping.experiments.landing_experiment import RUNS, LandingExperiment, print_trial
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.experiments.methods.mpc import GoalMpcJump
from leapgap.jumping.experiments.rig import TrialRunner
from leapgap.jumping.export.tables import ControllerTables, force_tables_of, tables_of
from leapgap.jumping.learning.onnx_graph import serialise_landing
from leapgap.jumping.learning.windows import write_npz
from leapgap.jumping.planning.problem import Problem
from leapgap.jumping.task import Target
from leapgap.runtime.atomic_io import write_json, write_text
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import package_version


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


FORMAT_VERSION = 5
OF_ALL = ("jump_controller.h", "jump_body.h", "jump_body.c", "main.c")
OF_GOALS = ("jump_controller.c", "jump_program.h", "jump_program.c")
OF_FORCES = ("force_controller.c", "force_program.h", "force_program.c")
PER_LINE = 8  # Numbers in a line of a table in C


def write_controller(tracker: ShiftTracker | JumpMpc, folder: Path, about: Mapping[str, Any]) -> ControllerTables:
    """Write a controller that has not begun its jump; ``about`` says for what robot and task it is.

    Goal-shift MPC is written with its model as ONNX, too.
    """
    shifts = isinstance(tracker, ShiftTracker)
    tables = tables_of(tracker) if isinstance(tracker, ShiftTracker) else force_tables_of(tracker)
    package = resources.files("leapgap.jumping.export")
    for name in (*OF_ALL, *(OF_GOALS if shifts else OF_FORCES)):
        write_text(folder / name, (package / "c" / name).read_text(encoding="utf-8"))
    sizes = [f"#define {name} {in_c(value)}" for name, value in tables.numbers.items()]
    named = [(declaration(name, values), values, tables.meaning[name]) for name, values in tables.arrays.items()]
    for file, says, lines in (
        ("sizes", "Numbers of this jump; SI units.", sizes),
        ("tables", "Tables of this jump.", [f"extern {declared}; /* {holds} */" for declared, _, holds in named]),
    ):
        guard = f"{file.upper()}_H"
        text = [f"/* {says} */", f"#ifndef {guard}", f"#define {guard}", "", *lines, "", "#endif", ""]
        write_text(folder / f"{file}.h", "\n".join(text))
    content = [f"{declared} = {nested(values)};\n" for declared, values, _ in named]
    write_text(folder / "tables.c", "\n".join(['#include "tables.h"', "", *content]))
    write_npz(folder / "tables.npz", dict(tables.arrays))
    if shifts:
        (folder / "landing_model.onnx").write_bytes(serialise_landing(tables.arrays, about))
    described = {
        "format_version": FORMAT_VERSION,
        **about,
        "joints": list(tracker.robot.joints),
        "feet": list(tracker.robot.feet),
        "stance_is_measured": isinstance(tracker, ShiftTracker) and tracker.late is not None,
        "numbers": dict(tables.numbers),
        "tables": {
            name: {"shape": list(tables.arrays[name].shape), "holds": tables.meaning[name]} for name in tables.arrays
        },
        "versions": {"leapgap": package_version(), "python": platform.python_version()},
    }
    write_json(folder / "controller.json", described)
    return tables


def declaration(name: str, values: np.ndarray) -> str:
    """Type, name and extent of an array in C."""
    kind = "double" if values.dtype.kind == "f" else "int"
    return f"const {kind} {name}" + "".join(f"[{length}]" for length in values.shape)


def nested(values: np.ndarray) -> str:
    """An array as an initialiser, in nested braces."""
    if values.ndim == 0:
        return in_c(values.item())
    if values.ndim > 1:
        return "{" + ",\n".join(nested(part) for part in values) + "}"
    parts = [in_c(value) for value in values.tolist()]
    lines = [", ".join(parts[i : i + PER_LINE]) for i in range(0, len(parts), PER_LINE)]
    return "{" + ",\n".join(lines) + "}"


def in_c(value: float) -> str:
    """A number as a literal that a compiler reads back to the same bits."""
    if isinstance(value, int):
        return str(value)
    return repr(value) if np.isfinite(value) else ("INFINITY" if value > 0 else "-INFINITY")
