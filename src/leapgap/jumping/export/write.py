"""Writes the export of a controller: its tables, the code that runs them, and a landing model as ONNX."""

import platform
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.mpc_controller import JumpMpc
from leapgap.jumping.export.force_tables import force_tables_of
from leapgap.jumping.export.tables import ControllerTables, tables_of
from leapgap.jumping.learning import landing_graph
from leapgap.jumping.learning.windows import write_npz
from leapgap.runtime.atomic_io import write_json, write_text
from leapgap.runtime.output_folder import package_version

FORMAT_VERSION = 4
OF_ALL = ("jump_controller.h", "jump_body.h", "jump_body.c", "main.c")
OF_GOALS = ("jump_controller.c", "jump_program.h", "jump_program.c")
OF_FORCES = ("force_controller.c", "force_program.h", "force_program.c")
PER_LINE = 8
"""Numbers in a line of a table in C."""


def write_controller(tracker: ShiftTracker | JumpMpc, folder: Path, about: Mapping[str, Any]) -> ControllerTables:
    """Write a controller that has not begun its jump; ``about`` says for what robot and task it is.

    The learned MPC is written in C alone, goal-shift MPC in NumPy too, with its model as ONNX.
    """
    shifts = isinstance(tracker, ShiftTracker)
    tables = tables_of(tracker) if isinstance(tracker, ShiftTracker) else force_tables_of(tracker)
    package = resources.files("leapgap.jumping.export")
    for name in (*OF_ALL, *(OF_GOALS if shifts else OF_FORCES)):
        write_text(folder / name, (package / "c" / name).read_text(encoding="utf-8"))
    write_text(folder / "sizes.h", sizes_in_c(tables))
    write_text(folder / "tables.h", declarations_in_c(tables))
    write_text(folder / "tables.c", tables_in_c(tables))
    write_npz(folder / "tables.npz", dict(tables.arrays))
    if shifts:
        write_text(folder / "controller.py", (package / "numpy_controller.py").read_text(encoding="utf-8"))
        (folder / "landing_model.onnx").write_bytes(landing_graph.serialise(tables.arrays, about))
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


def sizes_in_c(tables: ControllerTables) -> str:
    """``sizes.h``: every number of the jump as a macro."""
    lines = [f"#define {name} {in_c(value)}" for name, value in tables.numbers.items()]
    head = ["/* Numbers of this jump; SI units. */", "#ifndef SIZES_H", "#define SIZES_H", ""]
    return "\n".join([*head, *lines, "", "#endif", ""])


def declarations_in_c(tables: ControllerTables) -> str:
    """Declarations of the arrays, each with what it holds."""
    head = ["/* Tables of this jump. */", "#ifndef TABLES_H", "#define TABLES_H", ""]
    lines = [
        f"extern {declaration(name, values)}; /* {tables.meaning[name]} */" for name, values in tables.arrays.items()
    ]
    return "\n".join([*head, *lines, "", "#endif", ""])


def tables_in_c(tables: ControllerTables) -> str:
    """``tables.c``: every array of the jump as a constant."""
    lines = [f"{declaration(name, values)} = {nested(values)};\n" for name, values in tables.arrays.items()]
    return "\n".join(['#include "tables.h"', "", *lines])


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
