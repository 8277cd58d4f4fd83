"""The exported controller in C against the one in Python, over a jump in closed loop and over bad ticks."""

import json
import re
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.tracking import PhaseGains
from leapgap.jumping.experiments.goal_shift_jump import LandingFeedback
from leapgap.jumping.export.tables import tables_of
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate
from tests.jumping.export.conftest import GOAL, PARTS, RecordedJump, far_from_plan, new_tracker, run_program

CLOSE = 1e-6
"""Largest difference of a command: N·m, rad, rad/s, N."""


def python_commands(tracker: ShiftTracker, estimates: Sequence[StateEstimate]) -> np.ndarray:
    commands = [tracker.command(estimate) for estimate in estimates]
    return np.array([np.concatenate([getattr(command, part) for part in PARTS]) for command in commands])


def test_the_jump_is_one_that_tests_something(jump: RecordedJump) -> None:
    """The goal is shifted by centimetres, and all of the jump is there."""
    shifts = jump.tracker.shifts
    assert np.abs(shifts[:, 0]).max() > 0.02
    assert not jump.tracker.fallbacks
    assert len(jump.estimates) > 1000


def test_c_sends_the_commands_of_python(jump: RecordedJump, program: Path) -> None:
    np.testing.assert_allclose(run_program(program, jump.estimates), jump.commands, rtol=0, atol=CLOSE)


def hostile(estimates: Sequence[StateEstimate]) -> list[StateEstimate]:
    """The same jump with values that are missing or impossible, wrong times, a clock that is set, and missing ticks."""
    ticks = list(estimates[:900])
    nan = np.full(3, np.nan)
    ticks[0] = replace(ticks[0], base_position=nan)
    for i in range(120, 140):
        ticks[i] = replace(ticks[i], base_velocity=nan)
    for i in range(290, 305):
        ticks[i] = replace(ticks[i], base_quaternion=3 * ticks[i].base_quaternion)
    ticks[350] = replace(ticks[350], joint_pos=np.full(12, 1e9))
    ticks[400] = replace(ticks[400], time_s=float("nan"))
    for i in range(450, 480):
        ticks[i] = replace(ticks[i], time_s=float("inf"))
    ticks[500] = replace(ticks[500], time_s=-3.0)
    ticks[600:] = [replace(tick, time_s=tick.time_s + 50.0) for tick in ticks[600:]]
    return ticks[:551] + ticks[560:]


def test_bad_ticks_get_the_commands_of_python(jump: RecordedJump, robot: Robot, program: Path) -> None:
    ticks, tracker = hostile(jump.estimates), new_tracker(robot)
    expected = python_commands(tracker, ticks)
    assert {"time not usable", "not finite"} <= set(tracker.fallbacks)
    np.testing.assert_allclose(run_program(program, ticks), expected, rtol=0, atol=CLOSE)


def test_large_disturbances_get_the_commands_of_python(jump: RecordedJump, robot: Robot, program: Path) -> None:
    """Measurements far from the plan bring pitch, height, efforts and the largest shift to their limits."""
    rng = np.random.default_rng(5)
    held_back = 0
    for seed in range(4):
        ticks = far_from_plan(jump.estimates[:820], rng)
        tracker = new_tracker(robot)
        expected = python_commands(tracker, ticks)
        assert np.abs(tracker.shifts).max() > 0.03, seed
        held_back += int((np.abs(np.diff(tracker.shifts, axis=0) / [0.025, 0.02, 0.04]).max(axis=1) > 1 - 1e-6).sum())
        np.testing.assert_allclose(run_program(program, ticks), expected, rtol=0, atol=CLOSE)
    assert held_back > 10  # updates whose rate is at its limit


def test_the_onnx_graph_predicts_the_landing(jump: RecordedJump, folder: Path) -> None:
    model, rng = jump.tracker.model, np.random.default_rng(1)
    assert isinstance(model, LandingFeedback)
    goal, stance = GOAL + 0.03 * rng.standard_normal((40, 3)), rng.uniform(-0.2, 0.2, (40, 1))
    since, update, age = 0.05 * rng.standard_normal((40, 20)), rng.integers(0, 32, 40), rng.integers(1, 6, 40)
    session = onnxruntime.InferenceSession(str(folder / "landing_model.onnx"), providers=["CPUExecutionProvider"])
    (landing,) = session.run(None, {"goal": goal, "stance": stance, "since": since, "update": update, "age": age})
    for i in range(40):
        expected = model.expect(goal[i], float(stance[i, 0])) + model.change(int(update[i]), int(age[i]), since[i])
        np.testing.assert_allclose(landing[i], expected, rtol=0, atol=1e-9)


def test_no_memory_is_allocated_and_main_is_ten_lines(folder: Path, program: Path) -> None:
    symbols = subprocess.run(["nm", "-u", str(program)], capture_output=True, check=True, text=True).stdout
    assert not re.search(r"\b(malloc|calloc|realloc|alloca)\b", symbols)
    for name in ("jump_controller.c", "jump_program.c", "jump_body.c"):
        assert set(re.findall(r"#include <(.+)>", (folder / name).read_text())) == {"math.h", "string.h"}
    main = (folder / "main.c").read_text()
    body = main[main.index("int main") :].strip().splitlines()
    assert len(body) <= 10


def test_the_folder_says_what_it_holds(folder: Path) -> None:
    about = json.loads((folder / "controller.json").read_text())
    names = {path.name for path in folder.iterdir()}
    assert names == {
        *("controller.json", "tables.npz", "landing_model.onnx"),
        *("jump_controller.h", "jump_controller.c", "jump_program.h", "jump_program.c", "main.c"),
        *("jump_body.h", "jump_body.c"),
        *("sizes.h", "tables.h", "tables.c"),
    }
    assert not about["stance_is_measured"]
    assert len(about["joints"]) == about["numbers"]["JOINTS"] == 12
    with np.load(folder / "tables.npz") as tables:
        assert {name: list(tables[name].shape) for name in tables} == {
            name: one["shape"] or [1] for name, one in about["tables"].items()
        }
        assert all(one["holds"] for one in about["tables"].values())


def test_a_controller_without_a_model_is_refused(jump: RecordedJump) -> None:
    own = jump.tracker
    plain = ShiftTracker(own.plan, own.robot, PhaseGains(), own.config, own.goal, 0.0, own.goal, None)
    with pytest.raises(InputError, match="learned"):
        tables_of(plain)
