"""The log: commands and measurements of one run, from hardware or simulation, as one Parquet file.

Columns, units and metadata are the contract of ``docs/reference/log_format.md``. A planned reference is stored in the
same form (its planned motion in the measured columns), so the same code reads both.
"""

import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.logs.clock import check_period
from leapgap.logs.consistency import check_complete, check_physics
from leapgap.logs.files import VALUE_BYTES, check_file, check_folder, check_pages, check_values_fit, decoding
from leapgap.logs.metadata import Segment, contact_segments, equal_segments, jump_segments, read_metadata
from leapgap.logs.schema import BASE_QUATERNION, PAIR_FORCE_AXES, check_values
from leapgap.robot.rotations import continuous, pitch_of, roll_of, yaw_of
from leapgap.robot.terrain import Box
from leapgap.runtime.atomic_io import whole_file

FORMAT_VERSION = 2
JUMP_VERSION = 1  # version of the logs of jumps, which state ``schedule`` and ``target`` instead of segments
MANY_VALUES = 3_000_000
"""Values from which on columns are read by several threads; below, threads take longer than they save."""
METADATA_KEY, CHECKSUM_KEY = b"leapgap", b"leapgap_crc32"
EVEN = 1e-3  # largest departure of a row's length from the sample period, as a share of it, that counts as none
TICKS_S = (0.001, 0.0005, 0.00025)
"""Steps of other people's simulations that rows of uneven length may be whole multiples of, s, longest first."""


@dataclass(frozen=True)
class LogInfo:
    """The metadata of a log."""

    robot: str
    sample_period_s: float
    source: str
    terrain: tuple[Box, ...] = ()
    stated_segments: tuple[Segment, ...] = ()
    """Named intervals of the log, where it states them itself."""
    extra: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """What applications store: of a jump its ``schedule`` and ``target``. An importer states under ``derived`` what it
    computed and nobody measured: a quantity → how."""

    def rows(self, seconds: float) -> int:
        """Number of rows that last ``seconds``, rounded, at least one."""
        return max(1, round(seconds / self.sample_period_s))

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Named intervals of the log: those stated, or the phases of a jump; empty where neither is stated."""
        if self.stated_segments or "schedule" not in self.extra:
            return self.stated_segments
        return jump_segments(self.extra["schedule"])

    def to_json(self) -> str:
        """The JSON text that is stored under the Parquet key ``leapgap``."""
        version = JUMP_VERSION if {"schedule", "target"} <= set(self.extra) else FORMAT_VERSION
        stated = {
            "format_version": version,
            "robot": self.robot,
            "sample_period_s": self.sample_period_s,
            "source": self.source,
            "terrain": [asdict(box) for box in self.terrain],
            **self.extra,
        }
        if self.stated_segments:
            stated["segments"] = [asdict(segment) for segment in self.stated_segments]
        return json.dumps(stated, sort_keys=True)

    @staticmethod
    def from_json(text: str | bytes, where: object) -> "LogInfo":
        """Metadata from their JSON text; ``InputError`` names what is missing or invalid."""
        try:
            raw = read_metadata(text, where)
            version = raw.pop("format_version")
            if version not in (JUMP_VERSION, FORMAT_VERSION):
                expected = f"{JUMP_VERSION} or {FORMAT_VERSION}"
                raise InputError(where, f"format_version {version}", expected, "import the logs again")
            info = LogInfo(
                robot=raw.pop("robot"),
                sample_period_s=float(raw.pop("sample_period_s")),
                source=raw.pop("source"),
                terrain=tuple(Box(**{**box, "size_m": tuple(box["size_m"])}) for box in raw.pop("terrain", None) or ()),
                stated_segments=tuple(Segment(**segment) for segment in raw.pop("segments", None) or ()),
                extra={key: value for key, value in raw.items() if value is not None},
            )
            _ = info.segments  # a schedule that lacks a phase is told here, where the file is known
            return info
        except (KeyError, TypeError, ValueError) as error:
            found = f"metadata that do not fit ({error!r})"
            do = "import the log again"
            raise InputError(where, found, "the log's metadata (docs/reference/log_format.md)", do) from None


@dataclass(frozen=True)
class Log:
    """One log: columns of equal length (SI units, world x forward, y left, z up) and their metadata.

    Signs of the base's quaternions never flip from row to row: q and −q are one attitude.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    info: LogInfo

    def __post_init__(self) -> None:
        columns = dict(self.columns)
        object.__setattr__(self, "columns", MappingProxyType(columns))
        check_complete(self.columns, self.joints, self.name)
        if all(name in columns for name in BASE_QUATERNION):
            turn = self.stack(BASE_QUATERNION)
            if (smooth := continuous(turn)) is not turn:
                columns |= zip(BASE_QUATERNION, smooth.T.copy(), strict=True)

    def __reduce__(self) -> tuple[type["Log"], tuple[str, dict[str, np.ndarray], LogInfo]]:
        """Pickle with a plain dict: a read-only view of columns cannot be pickled."""
        return type(self), (self.name, dict(self.columns), self.info)

    def __len__(self) -> int:
        return len(self.columns["time"])

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> np.ndarray:
        """One column, shape (rows,); ``InputError`` where the log has none."""
        try:
            return self.columns[column]
        except KeyError:
            expected = f"one of {', '.join(sorted(self.columns))}"
            raise InputError(self.name, f"no column {column}", expected, "log it, or leave out what needs it") from None

    def stack(self, columns: Sequence[str]) -> np.ndarray:
        """Several columns side by side, shape (rows, len(columns))."""
        return np.stack([self[column] for column in columns], axis=-1) if len(columns) else np.empty((len(self), 0))

    def per_joint(self, quantity: str, joints: Sequence[str] | None = None) -> np.ndarray:
        """``quantity/<joint>`` of all joints in order, shape (rows, joints); cached, hence read-only."""
        key = (quantity, tuple(joints or self.joints))
        if key not in self._per_joint:
            values = self.stack([f"{quantity}/{joint}" for joint in key[1]])
            values.flags.writeable = False
            self._per_joint[key] = values
        return self._per_joint[key]

    @cached_property
    def _per_joint(self) -> dict[tuple[str, tuple[str, ...]], np.ndarray]:
        """Cache of ``per_joint``: replays call it thousands of times."""
        return {}

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the file."""
        return tuple(name.removeprefix("cmd_tau/") for name in self.columns if name.startswith("cmd_tau/"))

    @cached_property
    def time(self) -> np.ndarray:
        """Seconds since the first row, as logged."""
        return self.columns["time"]

    @property
    def derived(self) -> tuple[str, ...]:
        """Quantities that an importer computed from others, and nobody measured."""
        return tuple(self.info.extra.get("derived", {}))

    @cached_property
    def is_even(self) -> bool:
        """Whether every row lasts one sample period."""
        return bool(np.abs(np.diff(self.time) / self.info.sample_period_s - 1).max() <= EVEN)

    @cached_property
    def row_lengths(self) -> np.ndarray:
        """How long each row lasted by the log's own time, in sample periods, (rows,); the last one as a mean row."""
        return np.ones(len(self)) if self.is_even else np.append(np.diff(self.time) / self.info.sample_period_s, 1.0)

    @cached_property
    def uneven_steps(self) -> np.ndarray | None:
        """Time from each row to the next, s, (rows − 1,), where rows are uneven; None where they are even."""
        return None if self.is_even else np.diff(self.time)

    @cached_property
    def tick_s(self) -> float | None:
        """The longest of ``TICKS_S`` that uneven rows are whole multiples of; None: of none, or rows are even."""
        lengths = np.diff(self.time)
        whole = (tick for tick in TICKS_S if (np.abs(lengths / tick - np.round(lengths / tick)) < 1e-6).all())
        return None if self.is_even else next(whole, None)

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """Named intervals of the log; where it states none, by the feet in contact, else equal parts of its time."""
        feet = [name.removeprefix("contact/") for name in self.columns if name.startswith("contact/")]
        if self.info.segments or not feet:
            return self.info.segments or equal_segments(float(self.time[-1]))
        return contact_segments(self.time, self.stack([f"contact/{foot}" for foot in feet]) > 0, feet)

    @cached_property
    def pitch(self) -> np.ndarray:
        """Pitch of the base, rad, positive nose-down (about y of the roll-pitch-yaw angles)."""
        return pitch_of(self.stack(BASE_QUATERNION))

    @cached_property
    def yaw(self) -> np.ndarray:
        """Heading of the base in the world, rad, positive to the left."""
        return yaw_of(self.stack(BASE_QUATERNION))

    @cached_property
    def angles(self) -> dict[str, np.ndarray]:
        """Roll, pitch and yaw of the base, rad, by the names of their channels, (rows,) each."""
        return {"base_roll": roll_of(self.stack(BASE_QUATERNION)), "base_pitch": self.pitch, "base_yaw": self.yaw}

    def pair_force(self, source: str) -> np.ndarray:
        """``mpc_force``, ``pd_force`` or ``train_force``: front x z, rear x z on the robot, N, (rows, 4)."""
        return self.stack([f"{source}/{axis}" for axis in PAIR_FORCE_AXES])

    def has_pair_force(self, source: str) -> bool:
        """Whether the log holds the pair forces of a source: ``mpc_force``, ``pd_force``, ``train_force``."""
        return f"{source}/{PAIR_FORCE_AXES[0]}" in self

    @cached_property
    def rows_before_gain_change(self) -> int:
        """Number of rows until a joint gain first differs from the first row's (all rows if none does)."""
        gains = np.concatenate([self.per_joint("cmd_kp"), self.per_joint("cmd_kd")], axis=1)
        changed = np.flatnonzero((gains != gains[0]).any(axis=1))
        return int(changed[0]) if len(changed) else len(self)

    def first_rows(self, rows: int) -> "Log":
        """The log cut after ``rows`` rows."""
        return replace(self, columns={name: values[:rows] for name, values in self.columns.items()})

    def downsample(self, rows: int) -> "Log":
        """Every ``rows``-th row of the log; commands are means over the rows between."""
        if rows == 1:
            return self
        last = len(self) // rows * rows
        means = ("cmd_tau/", "cmd_pos/", "cmd_vel/")
        columns = {
            name: values[:last].reshape(-1, rows).mean(axis=1) if name.startswith(means) else values[:last:rows].copy()
            for name, values in self.columns.items()
        }
        return replace(self, columns=columns, info=replace(self.info, sample_period_s=rows * self.info.sample_period_s))


def write_log(log: Log, path: Path) -> None:
    """Write one log; equal logs give equal bytes. Its pages and its header carry checksums."""
    table = pa.table({name: np.ascontiguousarray(values) for name, values in log.columns.items()})
    text = log.info.to_json().encode()
    checksum = header_checksum(text, table.schema.names, table.num_rows)
    table = table.replace_schema_metadata({METADATA_KEY: text, CHECKSUM_KEY: checksum})
    with whole_file(path) as beside:
        pq.write_table(table, beside, compression="zstd", write_page_checksum=True)


def write_logs(logs: Iterable[Log], folder: Path) -> None:
    """Write logs into a folder, each under its name."""
    for log in logs:
        write_log(log, folder / f"{log.name}.parquet")


def header_checksum(text: bytes, columns: Sequence[str], rows: int) -> bytes:
    """CRC-32 of metadata, names of columns and number of rows, in hex: what the checksums of pages do not cover."""
    return b"%08x" % zlib.crc32("\0".join(columns).encode(), zlib.crc32(b"%d" % rows, zlib.crc32(text)))


def read_log(path: Path) -> Log:
    """Read one log, verified and checked; its name is the stem of the file's name."""
    check_file(path, "a log (*.parquet), or a folder of logs", "convert your logs first: leapgap import")
    with decoding(path, "Parquet", "import the log again"):
        table, metadata = read_parquet(path)
        names, rows = table.column_names, table.num_rows
        columns = {}
        for name, column in zip(names, table.columns, strict=True):
            # A copy: the arrays of the table lie in buffers of twice their size, which live as long as any of them
            columns[name] = column.cast(pa.float64(), safe=False).to_numpy().copy()
            columns[name].flags.writeable = False
    text = metadata[METADATA_KEY]
    checksum = header_checksum(text, names, rows)
    if metadata.get(CHECKSUM_KEY, checksum) != checksum:
        raise InputError(path, "a header that is not as it was written", "a whole log", "import the log again")
    info = LogInfo.from_json(text, path)
    log = Log(path.stem, columns, info)
    check_period(path, log.time, info.sample_period_s)
    check_read(log, path)
    return log


def read_parquet(path: Path) -> tuple[pa.Table, Mapping[bytes, bytes]]:
    """The table of a log file and its metadata, its size checked before it is read and its pages as they are read."""
    with pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False) as file:
        stated, metadata = file.metadata, file.metadata.metadata or {}
        if METADATA_KEY not in metadata:
            raise InputError(path, "no metadata 'leapgap'", "a log of this project", "import it: leapgap import")
        groups = sum(stated.row_group(i).total_byte_size for i in range(stated.num_row_groups))
        check_values_fit(path, max(stated.num_rows * stated.num_columns, groups / VALUE_BYTES))
        # Refuse a column that is not numeric, or is there twice
        schema = file.schema_arrow
        if len(set(schema.names)) < len(schema.names):
            twice = next(name for name in schema.names if schema.names.count(name) > 1)
            raise InputError(
                path, f"{schema.names.count(twice)} columns {twice}", "one of each name", "import it again"
            )
        for name, kind in zip(schema.names, schema.types, strict=True):
            if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
                found = f"a column that is not numeric ({name}: {kind})"
                raise InputError(path, found, "float64 columns", "import it again")
        check_pages(path, file)
        return file.read(use_threads=stated.num_rows * stated.num_columns > MANY_VALUES), metadata


def check_read(log: Log, where: object) -> None:
    """What every reader checks of a log from a file: possible values, and agreement with physics."""
    check_values(log.columns, where)
    check_physics(log.columns, log.joints, where)


def log_files(folder: Path) -> list[Path]:
    """Files of the logs in a folder, in the order of their names; ``InputError`` where it cannot be read."""
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a folder of logs", "convert your logs first: leapgap import")
    check_folder(folder)
    return sorted(folder.glob("*.parquet"))


def read_logs(folder: Path) -> list[Log]:
    """All logs of a folder, in the order of their names; empty where there is none.

    ``InputError`` lists all files that cannot be used; ``reading.read_folder`` goes on without them.
    """
    logs, errors = [], []
    for path in log_files(folder):
        try:
            logs.append(read_log(path))
        except InputError as error:
            errors.append(error)
    if len(errors) > 1:
        raise InputError(folder, f"{len(errors)} logs that cannot be used", "whole logs", "repair them", errors)
    if errors:
        raise errors[0]
    return logs
