"""Importer of CSV files, one a log, with a map from our columns to theirs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from leapgap.errors import InputError
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.schema import COMMANDS, quantity_of
from leapgap.logs.segments import PHASE_LENGTHS, Segment
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class CsvOptions:
    """How the columns of a CSV become those of a log; ``*`` in a key stands for every joint of the robot."""

    columns: dict[str, str] = field(default_factory=dict)
    """Ours → theirs, such as ``joint_pos/*: q_*``. A column not named here is taken under our own name."""
    factors: dict[str, float] = field(default_factory=dict)
    """Ours → what theirs is multiplied by, such as degrees to radians."""
    constants: dict[str, float] = field(default_factory=dict)
    """Ours → one value for all rows, such as ``cmd_kp/*: 300``."""
    segments: list[Segment] = field(default_factory=list)
    """Named intervals of each log; none: equal parts of its time, or the phases of a jump's ``schedule``."""
    schedule: dict[str, float] | None = None
    """For logs of jumps: ``double_contact_s``, ``rear_contact_s``, ``flight_s``."""
    target_x_m: float = 0.0
    """For logs of jumps: how far ahead of its start the robot was meant to land."""
    target_z_m: float = 0.0


class Csv(LogFormat):
    """Comma-separated tables with a header, one a log."""

    name = "csv"
    Options = CsvOptions

    def find(self, source: Path) -> dict[str, Path]:
        """The CSV files of a folder, by name."""
        return {path.stem: path for path in sorted(source.glob("*.csv"))}

    def read(self, path: Path, name: str, robot: Robot, options: CsvOptions) -> Log:
        """One CSV as a log; ``InputError`` names what is missing or cannot be read."""
        try:
            table = pa.csv.read_csv(path)
        except (pa.ArrowException, OSError) as error:
            raise InputError(
                path, f"no whole CSV ({error})", "a header and rows of numbers", "export it anew"
            ) from None
        theirs = per_joint(options.columns, robot)
        columns = {}
        for ours, column in theirs.items():
            if column not in table.column_names:
                raise InputError(path, f"no column {column}", f"it, as {ours}", "correct import_logs.csv.columns")
            columns[ours] = numbers(table, column, path)
        for column in table.column_names:
            if column not in columns and is_ours(column, robot):
                columns[column] = numbers(table, column, path)
        for ours, factor in per_joint(options.factors, robot).items():
            if ours not in columns:
                raise InputError("import_logs.csv.factors", ours, "a column that is imported", "map the column too")
            columns[ours] = columns[ours] * factor
        for ours, value in per_joint(options.constants, robot).items():
            columns[ours] = np.full(table.num_rows, value)
        if "time" not in columns:
            raise InputError(path, "no column time", "a strictly increasing time, s", "map it: import_logs.csv.columns")
        columns["time"] = columns["time"] - columns["time"][:1]
        ordered = {key: columns[key] for key in sorted(columns, key=column_order(robot))}
        steps = np.diff(columns["time"])
        return Log(
            name,
            ordered,
            LogInfo(
                robot=robot.name,
                sample_period_s=round(float(np.median(steps)), 9) if len(steps) else 0.0,
                source=f"CSV {path.name}",
                stated_segments=tuple(options.segments),
                extra=of_jump(options),
            ),
        )


def of_jump(options: CsvOptions) -> dict[str, dict[str, float]]:
    """The part of the metadata that only the log of a jump has."""
    if options.schedule is None:
        return {}
    if set(options.schedule) != set(PHASE_LENGTHS):
        expected = f"lengths in s of {', '.join(PHASE_LENGTHS)}"
        raise InputError("import_logs.csv.schedule", ", ".join(options.schedule), expected, "state all three")
    return {"schedule": dict(options.schedule), "target": {"x_m": options.target_x_m, "z_m": options.target_z_m}}


def is_ours(column: str, robot: Robot) -> bool:
    """Whether an unmapped column is imported under its own name: time, a known quantity, a command of a joint."""
    quantity, of = quantity_of(column), column.partition("/")[2]
    if quantity is None:
        return column == "time"
    return quantity.name not in COMMANDS or of in robot.joints


def per_joint(mapping: dict, robot: Robot) -> dict:
    """The mapping with ``*`` written out for every joint, in keys and text values alike."""
    written = {}
    for key, value in mapping.items():
        for joint in robot.joints if "*" in key else ("",):
            written[key.replace("*", joint)] = value.replace("*", joint) if isinstance(value, str) else value
    return written


def numbers(table: pa.Table, column: str, path: Path) -> np.ndarray:
    """A column as float64; empty cells become NaN, which ``Log`` refuses with its row."""
    try:
        return table[column].cast(pa.float64()).to_numpy(zero_copy_only=False)
    except (pa.ArrowException, ValueError) as error:
        raise InputError(f"{path}, column {column}", f"no numbers ({error})", "numbers", "export it anew") from None


def column_order(robot: Robot) -> Callable[[str], tuple]:
    """Sort key: time first, the base, then by quantity and the robot's joints; a fixed order gives fixed bytes."""

    def key(column: str) -> tuple:
        quantity, _, of = column.partition("/")
        return (
            column != "time",
            not column.startswith("base_"),
            quantity,
            robot.joints.index(of) if of in robot.joints else -1,
            of,
        )

    return key
