"""Whether columns make a log that can be used: equal lengths, finite numbers, increasing times, complete sets."""

from collections.abc import Mapping, Sequence

import numpy as np

from leapgap.errors import CONTROL, InputError
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, COMMANDS

Columns = Mapping[str, np.ndarray]
"""Columns of a log by name."""


def check_complete(columns: Columns, joints: Sequence[str], where: str) -> None:
    """Raise ``InputError`` for columns that make no log; ``joints`` are those with a commanded torque."""
    check_names(columns, where)
    check_rows(columns, where)
    check_times(columns, where)
    check_commands(columns, joints, where)
    check_base(columns, where)


def check_names(columns: Columns, where: str) -> None:
    """No control characters in the name of the log or of a column: names are printed, and written into pages."""
    for name in ("", *columns) if CONTROL.search(where + "".join(columns)) else ():
        if CONTROL.search(name or where):
            found, do = f"the name {name or where}", "rename it"
            raise InputError(f"{where}, columns" if name else where, found, "printable characters, on one line", do)


def check_rows(columns: Columns, where: str) -> None:
    """Two or more rows in every column, with finite numbers."""
    if "time" not in columns:
        raise InputError(where, "no column time", "a strictly increasing time, s", "add the column")
    rows = len(columns["time"])
    if rows < 2:
        raise InputError(where, f"{rows} rows", "two or more", "log the whole motion")
    for name, values in columns.items():
        if values.shape != (rows,):
            raise InputError(f"{where}, column {name}", f"shape {values.shape}", f"({rows},)", "export it again")
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InputError(
                f"{where}, column {name}",
                f"{len(bad)} values that are no number, first in row {bad[0]}",
                "finite numbers",
                "repair the log, or leave the column out if it was not measured",
            )


def check_times(columns: Columns, where: str) -> None:
    """Raise ``InputError`` where time stands still or runs back from one row to the next."""
    back = np.flatnonzero(np.diff(columns["time"]) <= 0)
    if len(back):
        raise InputError(
            f"{where}, column time",
            f"a step of {np.diff(columns['time'])[back[0]]:g} s after row {back[0]}{copies_in_words(columns, back)}",
            "strictly increasing times",
            "sort the rows, or repair the clock",
        )


def copies_in_words(columns: Columns, rows: np.ndarray) -> str:
    """Whether the rows after these are copies of them in every column, in words; empty where they are not."""
    if not all((values[rows] == values[rows + 1]).all() for values in columns.values()):
        return ""
    return f" ({len(rows)} rows are there twice, equal in every column)"


def check_commands(columns: Columns, joints: Sequence[str], where: str) -> None:
    """Commands and gains of every joint; the log of a free body, whose pose it has, needs none."""
    free = set(BASE_POSITION) | set(BASE_QUATERNION) <= set(columns) and not any("/" in name for name in columns)
    if not joints and not free:
        raise InputError(where, "no column cmd_tau/<joint>", "commands of every joint", "log the commands")
    for quantity in COMMANDS:
        missing = [joint for joint in joints if f"{quantity}/{joint}" not in columns]
        if missing:
            raise InputError(
                where,
                f"no {quantity} of {', '.join(missing)}",
                "commands and gains of every joint",
                "log them; the gap cannot be judged without the commands",
            )


def check_base(columns: Columns, where: str) -> None:
    """All of the base's position and attitude or none, and attitudes of length one."""
    for group in (BASE_POSITION, BASE_QUATERNION):
        present = [name for name in group if name in columns]
        if present and len(present) != len(group):
            raise InputError(where, f"only {', '.join(present)}", f"all of {', '.join(group)}, or none", "log all")
    if BASE_QUATERNION[0] in columns:
        length = np.linalg.norm(np.stack([columns[name] for name in BASE_QUATERNION], axis=-1), axis=1)
        worst = int(np.argmax(np.abs(length - 1)))
        if abs(length[worst] - 1) > 1e-3:
            raise InputError(
                f"{where}, base_quat, row {worst}",
                f"length {length[worst]:g}",
                "unit quaternions w x y z",
                "normalise them, and check their order",
            )
