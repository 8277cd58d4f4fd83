"""Importers of CSV files: text tables, one or several logs a file, and runs in the layout of SAGE."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv

from leapgap.errors import InputError
from leapgap.logs.clock import held_at
from leapgap.logs.files import Bounded, decoding
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Wanted, as_numbers, check_size

CHUNK_BYTES = 1 << 20
PACKED = ("gz", "bz2", "zst", "lz4")  # endings of packed files, which pyarrow unpacks


@dataclass(frozen=True)
class CsvOptions(TableOptions):
    """How a text table is written, beside which column is which."""

    delimiter: str = ","  # what separates the cells of a row, such as ``;`` or a tab
    decimal_point: str = "."  # what separates the decimals of a number: a point, or a comma
    header: bool = True  # whether the first row names the columns; else they are called 0, 1, 2, …
    skip_rows: int = 0  # lines before the header or the first row


class Csv(TableFormat):
    """Tables of text with one row a control tick."""

    name = "csv"
    suffixes = (".csv", *(f".csv.{end}" for end in PACKED))
    holds = "CSV"
    Options = CsvOptions

    def read_table(self, path: Path, options: CsvOptions, wanted: Wanted) -> Arrays:
        """The columns of a CSV; those that are not wanted may hold any text."""
        return text_columns(path, options, wanted)


def text_columns(path: Path, options: CsvOptions, wanted: Wanted) -> dict[str, np.ndarray]:
    """Columns of a text table, (rows,), or (rows, n) where each cell is a list of n numbers, as in ``[0.1, 0.2]``."""
    with opened(path) as file:
        # Check the size of a file by its lines and the cells of its widest one among the first, before it is read
        head = file.read(CHUNK_BYTES)
        cells = max(line.count(options.delimiter.encode()) + 1 for line in head.split(b"\n"))
        lines = head.count(b"\n")
        while chunk := file.read(CHUNK_BYTES):
            lines += chunk.count(b"\n")
        check_size(path, lines * cells, lines - options.skip_rows - options.header, options.most_rows)
    read = pa.csv.ReadOptions(skip_rows=options.skip_rows, autogenerate_column_names=not options.header)
    if options.header and options.delimiter == " " and (marked := names_behind_mark(path, options.skip_rows)):
        read = pa.csv.ReadOptions(skip_rows=options.skip_rows + 1, column_names=marked)
    parse = pa.csv.ParseOptions(delimiter=options.delimiter)
    with decoding(path, "CSV", "export it again"), opened(path) as file:
        table = pa.csv.read_csv(file, read, parse, pa.csv.ConvertOptions(decimal_point=options.decimal_point))
    names = [name.strip() for name in table.column_names]
    if not options.header:
        names = [str(at) for at in range(table.num_columns)]
    number = Counter(names)
    twice = next((name for name in names if number[name] > 1 and wanted(name)), None)
    if twice is not None:
        raise InputError(path, f"{number[twice]} columns {twice}", "one of each name", "rename them")
    columns = {name: column.to_numpy() for name, column in zip(names, table.columns, strict=True) if wanted(name)}
    return {name: with_lists(values, f"{path}, column {name}") for name, values in columns.items()}


def names_behind_mark(path: Path, row: int) -> list[str]:
    """Names of columns in a line that begins with a mark of comments, as NumPy writes it; none in any other line."""
    with opened(path) as file:
        lines = file.read(CHUNK_BYTES).decode(errors="replace").split("\n")
    mark, *names = (lines[row].split() if row < len(lines) else []) or [""]
    return names if mark in ("#", "%") else []


def with_lists(values: np.ndarray, where: str) -> np.ndarray:
    """A column whose cells are lists of numbers as (rows, n); any other as it is."""
    if values.dtype.kind != "O" or not len(values) or not all(isinstance(cell, str) for cell in values):
        return values
    cells = [cell.strip() for cell in values]
    if not all(cell.startswith("[") and cell.endswith("]") for cell in cells):
        return values
    try:
        rows = [np.array(cell[1:-1].replace(",", " ").split(), dtype=np.float64) for cell in cells]
    except ValueError:
        return values
    other = next((at for at, row in enumerate(rows) if len(row) != len(rows[0])), None)
    if other is not None:
        found, expected = f"{len(rows[other])} items", f"{len(rows[0])}, as in row 0"
        raise InputError(f"{where}, row {other}", found, expected, "repair it")
    return np.stack(rows)


def opened(path: Path) -> BinaryIO:
    """The text of a file; a packed one (``.csv.gz``) is unpacked as it is read, up to a limit."""
    file = pa.input_stream(str(path), compression="detect")
    return cast(BinaryIO, Bounded(file, path) if isinstance(file, pa.CompressedInputStream) else file)


CONTROL, STATE, EVENTS, JOINTS = "control.csv", "state_motor.csv", "event.csv", "joint_list.txt"
TIME = "timestamp"
BEGINS, ENDS = "MOTION_START", "DISABLE"
MOST_JOINTS = 1000


@dataclass(frozen=True)
class SageOptions(TableOptions):
    """Options of SAGE runs. Their columns are called ``control.positions.Elbow``, ``state_motor.torques.Elbow``."""


class Sage(TableFormat):
    """A folder a run, with commands and measurements in two files with own times; rows are those of measurements.

    ``control.csv`` and ``state_motor.csv`` hold ``timestamp``, µs, and vectors as lists in one cell; ``joint_list.txt``
    has the joints in their order, ``event.csv`` when the motion began and the drives were switched off.
    """

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
