"""Formats that are tables of numbers: a reader returns named arrays, and all else is the same for all of them."""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.clock import check_period, increasing_rows, mean_period
from leapgap.logs.cutting import on_even_clock
from leapgap.logs.derivatives import add_velocities
from leapgap.logs.files import decoding
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.importers.column_map import ColumnMap, Expansion, column_order, is_ours, mapped
from leapgap.logs.importers.tables import Arrays, Table, Wanted, check_size
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import LONGEST_PERIOD_S, PHASE_LENGTHS, Segment
from leapgap.robot.model import Robot
from leapgap.robot.stated_joints import servo_gains

REFUSE, DROP = "refuse", "drop"
LEAVE_OUT, FIT = "leave_out", "fit"
LOGGED, UNKNOWN = "logged", "unknown"
GAINS = ("cmd_kp", "cmd_kd")
LONGEST_NAME = 100  # bytes of the name of a piece, which becomes part of the name of a file


@dataclass(frozen=True)
class TableOptions(ColumnMap):
    """Options of every table format: the map of columns, the clock, and which rows become which log."""

    period_s: float | None = None
    """Stated period of the rows. The time stamps are the clock and must agree with it on average within 2 %; where
    there is none, the rows are this far apart."""
    repeated_times: str = REFUSE  # ``refuse`` time stamps that do not increase, or ``drop`` their rows and say so
    resample_s: float | None = None  # period of an even clock that the log is brought to; none: its own instants
    steps: str | None = None  # without a time: a column with each row's step, which add up, in ``units.time``
    gains: str = LOGGED
    """``logged``, or ``unknown``: not in the file, or in the drive's own units. The log then has those that are mapped,
    else those of the model's position servos, as a start, and says that they are unknown."""
    velocities: str = LEAVE_OUT  # velocities that are not in the file: ``leave_out``, or ``fit`` through positions
    velocity_window_s: float = 0.03  # length of the window in which such a polynomial is fitted
    pieces: list[Segment] = field(default_factory=list)
    """Several logs out of one file, by its time from its first row: their names, begins and ends."""
    piece_s: float | None = None  # length of logs out of each file, or run of ``cut_by``; a rest is left out
    cut_by: str | None = None  # a column that cuts the file: each run of equal values is a log
    cut_values: list[Any] = field(default_factory=list)  # values of that column that are kept; none: all
    drop_rows: dict[str, list[Any]] = field(default_factory=dict)
    """A column of the file → values, numbers or texts, with which a row is left out."""
    least_rows: int = 10  # runs and pieces with fewer rows are left out
    most_rows: int | None = None  # files with more rows are refused; none: what fits into 4 GB
    segments: list[Segment] = field(default_factory=list)
    """Named intervals of each log; none: equal parts of its time, or the phases of a jump's ``schedule``."""
    schedule: dict[str, float] | None = None  # of jumps: ``double_contact_s``, ``rear_contact_s``, ``flight_s``
    target_x_m: float = 0.0  # for logs of jumps: how far ahead of its start the robot was meant to land
    target_z_m: float = 0.0


class TableFormat(LogFormat):
    """A format whose files are read as named arrays. A subclass says which files, and reads one."""

    suffixes: ClassVar[tuple[str, ...]]  # endings of its files
    holds: ClassVar[str] = "table"  # what one file is, as in ``no readable HDF5``
    repair: ClassVar[str] = "export it again"  # what to do where it cannot be read
    Options: ClassVar[type] = TableOptions
    columns: ClassVar[Mapping[str, str]] = {}
    units: ClassVar[Mapping[str, str]] = {}  # parts of the map that the layout itself has, where options map no time

    @abstractmethod
    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The numbers of one file as arrays by name; it may leave out arrays that are not ``wanted``."""

    def find(self, source: Path) -> dict[str, Path]:
        """The files of a folder with such an ending, or one file, by name."""
        paths = [source] if source.is_file() else [one for end in self.suffixes for one in source.glob(f"*{end}")]
        found: dict[str, Path] = {}
        for path in sorted(paths):
            name = path.name.removesuffix(max(filter(path.name.endswith, self.suffixes), default=path.suffix))
            if found.setdefault(name, path) != path:
                raise InputError(path, f"{found[name].name} beside it", "one file of a name", "rename one")
        return found

    @staticmethod
    def folders(source: Path, *inner: str) -> dict[str, Path]:
        """A folder, and those in it, that have certain files inside, by name."""
        every = [source, *sorted(one for one in source.glob("*") if one.is_dir())]
        return {one.name: one for one in every if all((one / name).is_file() for name in inner)}

    def read(self, path: Path, name: str, robot: Robot, options: Any) -> Log:
        """The only log of a file."""
        logs = self.read_all(path, name, robot, options)
        if len(logs) != 1:
            raise InputError(path, f"{len(logs)} logs", "one", "use read_all, or cut nothing")
        return logs[0]

    def read_all(self, path: Path, name: str, robot: Robot, options: Any) -> list[Log]:
        """The logs of a file, whole or cut as the options say."""
        where = self.name
        if "time" not in options.columns:
            columns, units = {**self.columns, **options.columns}, {**self.units, **options.units}
            options = replace(options, columns=columns, units=units)
        check_options(options, where)
        # Which arrays of a file are read: those that are mapped, those that cut it, and those with our own names
        maps = [Expansion(options, robot, where, first=first).columns() for first in (0, 1)]
        mapped_columns = {column for one in maps for terms in one.values() for column in terms}
        names = mapped_columns | set(options.drop_rows) | {name for name in (options.cut_by, options.steps) if name}
        names |= {name.rpartition("[")[0] for name in names if name.endswith("]")}
        table = self.table(path, options, (lambda name: name in names or is_ours(name, robot)))
        if options.steps is not None:  # each the length until the next row
            steps, wrong = flag(table, options.steps, table.rows, f"{where}.steps"), "steps that are not all positive"
            if steps.dtype.kind == "U" or not (steps > 0).all():
                raise InputError(f"{path}, column {options.steps}", wrong, "lengths", "map a time")
            table = Table(path, {**table.arrays, "time": np.concatenate([[0.0], np.cumsum(steps[:-1])])})
        columns, ties = mapped(table, options, robot, where)
        if options.gains == UNKNOWN:
            columns |= starting_gains(columns, robot, where)
        follows = {joint: tie.of for joint, tie in ties.items()}
        rows = len(next(iter(columns.values()), ()))
        if "time" not in columns:
            if options.period_s is None or not rows:
                do = f"map it: {where}.columns, or state {where}.period_s"
                raise InputError(path, "no column time", "a strictly increasing time, s", do)
            columns["time"] = options.period_s * np.arange(rows)
        ordered = {key: columns[key] for key in sorted(columns, key=column_order(robot))}
        logs = [
            finished_log(
                cut_name, {key: values[kept] for key, values in ordered.items()}, path, robot, options, where, follows
            )
            for cut_name, kept in cuts(table, ordered["time"], name, options, where)
        ]
        if not logs:
            raise InputError(path, "no rows that are kept", f"{options.least_rows} or more", "correct how it is cut")
        return logs

    def stated(self, path: Path, options: Any) -> Mapping[str, Any]:
        """What the files say of themselves, for a proposed map: ``period_s`` of the rows, ``unit`` of positions."""
        return {}

    def first_log(self, table: Table) -> Table:
        """The rows of a table that are one run, to propose a map from; a format whose files hold several cuts them."""
        return table

    def table(self, path: Path, options: Any, wanted: Wanted = lambda _: True) -> Table:
        """The table of one file, its size checked."""
        if not path.exists():
            raise InputError(path, "no such file", f"a file of format {self.name}", "name the file")
        with decoding(path, self.holds, self.repair):
            table = Table(path, self.read_table(path, options, wanted))
        check_size(path, sum(array.size for array in table.arrays.values()), table.rows, options.most_rows)
        return table


def starting_gains(columns: Arrays, robot: Robot, where: str) -> Arrays:
    """Gains, (rows,) each, that the table lacks: those of the model's position servos, from which a fit starts."""
    rows = len(next(iter(columns.values()), ()))
    sent = [joint for joint in robot.joints if {f"cmd_pos/{joint}", f"cmd_tau/{joint}"} & columns.keys()]
    lacking = [name for name in GAINS if not all(f"{name}/{joint}" in columns for joint in sent)]
    servos = servo_gains(robot)
    if lacking and servos is None:
        do = f"state constants of {' and '.join(f'{name}/*' for name in lacking)} as a start"
        raise InputError(f"{where}.gains", "unknown, of a model without position servos", "gains to start from", do)
    return {
        f"{name}/{joint}": np.full(rows, (servos or {}).get(joint, (0.0, 0.0))[GAINS.index(name)])
        for name in lacking
        for joint in sent
        if f"{name}/{joint}" not in columns
    }


def check_options(options: TableOptions, where: str) -> None:
    """Refuse choices that are none, and ways to cut that exclude each other."""
    known_of = {"repeated_times": (REFUSE, DROP), "velocities": (LEAVE_OUT, FIT), "gains": (LOGGED, UNKNOWN)}
    for name, known in known_of.items():
        if getattr(options, name) not in known:
            raise InputError(f"{where}.{name}", getattr(options, name), f"one of {', '.join(known)}", "choose one")
    positive, finite = (lambda value: 0 < value < math.inf), (lambda value: abs(value) < math.inf)
    for names, is_sound, expected in (
        (("period_s", "resample_s", "piece_s", "velocity_window_s"), positive, "a positive time, s"),
        (("least_rows",), lambda value: value >= 0, "0 or more"),
        (("most_rows",), lambda value: value >= 1, "1 or more"),
        (("target_x_m", "target_z_m"), finite, "a number, m"),
    ):
        for name in names:
            value = getattr(options, name)
            if value is not None and not is_sound(value):
                raise InputError(f"{where}.{name}", f"{value:g}", expected, "correct it")
    for name in ("pieces", "segments"):
        check_intervals(getattr(options, name), f"{where}.{name}")
    for piece in options.pieces:
        plain = piece.name.isprintable() and not set(piece.name) & set('/\\:*?"<>|') and piece.name.strip(". ") != ""
        if not plain or len(piece.name.encode()) > LONGEST_NAME:  # no name of a file, in some folder of some system
            expected = f"a name of a file, of at most {LONGEST_NAME} characters"
            raise InputError(f"{where}.pieces", f"the name {piece.name[:LONGEST_NAME]!a}", expected, "choose another")
    for name, value in (options.schedule or {}).items():
        if not 0 <= value < math.inf:
            raise InputError(f"{where}.schedule", f"{name} {value:g}", "lengths of 0 s or more", "correct it")
    if options.pieces and (options.cut_by or options.piece_s):
        raise InputError(where, "pieces beside cut_by or piece_s", "one way to cut", "leave one out")


def check_intervals(intervals: Sequence[Segment], where: str) -> None:
    """Refuse intervals that end before they begin, and pieces that have one name."""
    for one in intervals:
        if not -math.inf < one.begin_s < one.end_s:
            found = f"{one.name} from {one.begin_s:g} to {one.end_s:g} s"
            raise InputError(where, found, "intervals that begin before they end", "correct them")
    names = [one.name for one in intervals]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None and where.endswith("pieces"):
        raise InputError(where, f"the name {twice} twice", "a name of its own for each log", "rename one")


def cuts(
    table: Table, time: np.ndarray, name: str, options: TableOptions, where: str
) -> Iterator[tuple[str, np.ndarray]]:
    """Names of the logs of a table, and the rows of each, as indices."""
    rows = len(time)
    kept = np.ones(rows, dtype=bool)
    for column, values in options.drop_rows.items():
        kept &= ~has_value(flag(table, column, rows, f"{where}.drop_rows"), values)
    runs = [(name, np.flatnonzero(kept))]
    if options.cut_by is not None:
        # Each stretch in which the flag keeps one of the wanted values, those of enough rows numbered
        state = flag(table, options.cut_by, rows, f"{where}.cut_by")
        bounds = [0, *(np.flatnonzero(state[1:] != state[:-1]) + 1).tolist(), rows]
        wanted = has_value(state, options.cut_values) if options.cut_values else np.ones(rows, dtype=bool)
        of_value = [
            begin + np.flatnonzero(kept[begin:end]) for begin, end in pairwise(bounds) if wanted[begin:end].any()
        ]
        long_enough = [run for run in of_value if len(run) >= options.least_rows]
        runs = [(f"{name}_{number}", rows_of) for number, rows_of in enumerate(long_enough, 1)]
    elif options.pieces:
        since = time - time[0]
        runs = [
            (f"{name}_{piece.name}", np.flatnonzero(kept & (since >= piece.begin_s) & (since < piece.end_s)))
            for piece in options.pieces
        ]
    for run_name, rows_of in runs:
        yield from parts(run_name, rows_of, time, options, where)


def flag(table: Table, column: str, rows: int, where: str) -> np.ndarray:
    """A column that decides about rows: numbers, or texts."""
    if column not in table:
        raise InputError(table.path, f"no column {column}", f"the column that {where} names", f"correct {where}")
    values = table.values(column, rows)
    return values.astype(str) if values.dtype.kind in "OU" else table.numbers(column, rows)


def has_value(flags: np.ndarray, values: Sequence[Any]) -> np.ndarray:
    """Whether each row has one of some values; numbers are compared as numbers, texts as texts."""
    return np.isin(flags, [str(one) for one in values] if flags.dtype.kind == "U" else values)


def parts(
    name: str, rows: np.ndarray, time: np.ndarray, options: TableOptions, where: str
) -> list[tuple[str, np.ndarray]]:
    """The rows in parts of equal length, the rest left out; whole where no length is stated."""
    length_s = options.piece_s
    if length_s is None:
        cut = options.pieces or options.cut_by
        return [] if cut and len(rows) < options.least_rows else [(name, rows)]
    if len(rows) < options.least_rows:
        return []
    part = np.floor((time[rows] - time[rows[0]]) / length_s + 1e-9).astype(int)
    period = (time[rows[-1]] - time[rows[0]]) / max(1, len(rows) - 1)
    number = int(np.floor((time[rows[-1]] - time[rows[0]] + period) / length_s + 1e-6))
    if number > len(rows):
        found = f"{length_s:g} s, less than the {period:.3g} s of a row"
        raise InputError(f"{where}.piece_s", found, "the length of a log", "correct it")
    return [(f"{name}_part{k + 1}", rows[part == k]) for k in range(number)]


def finished_log(
    name: str,
    columns: dict[str, np.ndarray],
    path: Path,
    robot: Robot,
    options: TableOptions,
    kind: str,
    follows: Mapping[str, str],
) -> Log:
    """The log of some rows: its clock checked, resampled and completed where the options say so.

    ``follows`` are joints that were not measured, and the ones that they follow by the model.
    """
    derived: dict[str, str] = {}
    source = [f"{kind.upper()} {path.name}"]
    later = increasing_rows(columns["time"])
    if options.repeated_times == DROP and not later.all():
        columns = {key: values[later] for key, values in columns.items()}
        derived["time"] = f"{int((~later).sum())} rows left out, whose time stamps repeat or run back"
        source.append(derived["time"])
    columns["time"] = columns["time"] - columns["time"][:1]
    jump: Mapping[str, Mapping[str, Any]] = {}  # what only the log of a jump has
    if options.schedule is not None:
        if set(options.schedule) != set(PHASE_LENGTHS):
            expected = f"lengths in s of {', '.join(PHASE_LENGTHS)}"
            raise InputError(f"{kind}.schedule", ", ".join(options.schedule), expected, "state all three")
        jump = {"schedule": dict(options.schedule), "target": {"x_m": options.target_x_m, "z_m": options.target_z_m}}
    period = mean_period(columns["time"])
    info = LogInfo(robot.name, period, "; ".join(source), (), tuple(options.segments), jump)
    if info.sample_period_s > LONGEST_PERIOD_S:
        found = (
            f"{len(columns['time'])} rows of {1e3 * info.sample_period_s:.4g} ms, {columns['time'][-1]:.4g} s in all"
        )
        do = "state the unit of the time (units: {time: ms}, or us, ns), or period_s of the rows"
        raise InputError(
            f"{path}, {name}", found, f"samples of a control loop, {1e3 * LONGEST_PERIOD_S:g} ms at most", do
        )
    log = Log(name, columns, info)
    if options.period_s is not None:
        check_period(f"{path}, {name}", log.time, options.period_s)
    if options.velocities == FIT:
        log, fitted = add_velocities(log, robot.joints, options.velocity_window_s)
        derived |= fitted
    if options.resample_s is not None:
        log = on_even_clock(log, options.resample_s)
        derived["all"] = f"resampled to {options.resample_s:g} s: commands held, measurements interpolated"
    ordered = {key: log.columns[key] for key in sorted(log.columns, key=column_order(robot))}
    gains = {"known": False} if options.gains == UNKNOWN else {}
    told: Mapping[str, Mapping[str, Any]] = {"derived": derived, "gains": gains, "follows": follows}
    extra = {**log.info.extra, **{key: of for key, of in told.items() if of}}
    return Log(name, ordered, replace(log.info, extra=extra))
