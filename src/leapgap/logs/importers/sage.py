"""Importer of runs in the layout of SAGE: a folder a run, commands and measurements in two files with own times.

``control.csv`` and ``state_motor.csv`` hold ``timestamp``, µs, and vectors as lists in one cell; ``joint_list.txt`` has
the joints in their order, ``event.csv`` when the motion began and the drives were switched off.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.clock import held_at
from leapgap.logs.importers.csv import CsvOptions, text_columns
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Wanted, as_numbers

CONTROL, STATE, EVENTS, JOINTS = "control.csv", "state_motor.csv", "event.csv", "joint_list.txt"
TIME = "timestamp"
BEGINS, ENDS = "MOTION_START", "DISABLE"
MOST_JOINTS = 1000


@dataclass(frozen=True)
class SageOptions(TableOptions):
    """Options of SAGE runs. Their columns are called ``control.positions.Elbow``, ``state_motor.torques.Elbow``."""


class Sage(TableFormat):
    """Folders with ``control.csv`` and ``state_motor.csv``; the rows are those of the measurements."""

    name = "sage"
    suffixes = ()
    holds = "SAGE run"
    Options = SageOptions
    columns: ClassVar[Mapping[str, str]] = {
        "time": TIME,
        "joint_pos/*": "state_motor.positions.*",
        "joint_vel/*": "state_motor.velocities.*",
        "tau/*": "state_motor.torques.*",
        "cmd_pos/*": "control.positions.*",
    }
    units: ClassVar[Mapping[str, str]] = {"time": "us"}

    def find(self, source: Path) -> dict[str, Path]:
        """The run that a folder is, or the runs in it."""
        return self.folders(source, CONTROL, STATE)

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """Measurements in their own rows; a command is the last one that was sent then, and stays."""
        joints = joints_of(path / JOINTS)
        measured, sent = vectors(path / STATE, joints), vectors(path / CONTROL, joints)
        time, sent_at = measured.pop(TIME), sent.pop(TIME)
        begin, end = motion(path / EVENTS)
        rows = (time >= max(begin, sent_at[0])) & (time < end)
        if not rows.any():
            raise InputError(path, "no measurement while commands were sent", "both at one time", "repair the run")
        arrays = {TIME: time[rows]}
        arrays |= {f"state_motor.{name}": values[rows] for name, values in measured.items()}
        arrays |= {f"control.{name}": held_at(time[rows], sent_at, values) for name, values in sent.items()}
        return {name: values for name, values in arrays.items() if wanted(name)}


def joints_of(path: Path) -> list[str]:
    """Names of the joints, one a line."""
    if not path.is_file() or path.stat().st_size > 100 * MOST_JOINTS:
        raise InputError(path, "no list of joints", "one name a line, in the order of the vectors", "add the file")
    names = [line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None or not names:
        raise InputError(path, f"{twice} twice" if twice else "no name", "each joint once", "correct it")
    return names


def vectors(path: Path, joints: list[str]) -> dict[str, np.ndarray]:
    """Times and the vectors of one file, a column a joint: ``positions.Elbow``; times must not run back."""
    columns = text_columns(path, CsvOptions(), lambda _: True)
    if TIME not in columns:
        raise InputError(path, f"no column {TIME}", "a time, µs", "export it again")
    found = {TIME: as_numbers(columns[TIME], f"{path}, {TIME}")}
    for name, values in columns.items():
        if values.ndim == 2:
            if values.shape[1] != len(joints):
                where = f"{path}, {name}"
                raise InputError(where, f"{values.shape[1]} items", f"{len(joints)}, as in {JOINTS}", "correct one")
            found |= {f"{name}.{joint}": values[:, at] for at, joint in enumerate(joints)}
    if not len(found[TIME]) or not (np.diff(found[TIME]) > 0).all():
        raise InputError(f"{path}, {TIME}", "times that do not increase", "a row a tick", "repair the run")
    return found


def motion(path: Path) -> tuple[float, float]:
    """When the motion began and when the drives were switched off, in the unit of the file; without one, always."""
    if not path.is_file():
        return -np.inf, np.inf
    columns = text_columns(path, CsvOptions(), lambda _: True)
    if not {TIME, "event"} <= columns.keys():
        raise InputError(path, ", ".join(columns), f"the columns {TIME}, event", "correct it, or remove it")
    times = as_numbers(columns[TIME], f"{path}, {TIME}")
    begins, ends = (times[columns["event"] == event] for event in (BEGINS, ENDS))
    return (float(begins[0]) if len(begins) else -np.inf), (float(ends[0]) if len(ends) else np.inf)
