"""Importer of Parquet files of any origin; lists of fixed length are arrays, structures are joined by dots."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.logs.files import check_pages, decoding
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Table, Wanted, check_size
from leapgap.logs.log import METADATA_KEY
from leapgap.runtime.atomic_io import read_json


class Parquet(TableFormat):
    """Parquet tables with columns of any name; logs in leapgap's format need no import."""

    name = "parquet"
    suffixes = (".parquet",)
    holds = "Parquet"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The wanted columns of a Parquet file."""
        return parquet_arrays(path, wanted, options.most_rows)

    def stated(self, path: Path, options: Any) -> Mapping[str, Any]:
        """Nothing; ``InputError`` for a log of ours, whose terrain and segments a map would not bring along."""
        if METADATA_KEY in (pq.read_schema(path).metadata or {}):
            do = "name it to leapgap check or diagnose as it is; to change columns, import with --options"
            raise InputError(path, "a log of leapgap already", "logs of another format", do)
        return {}


def parquet_arrays(path: Path, wanted: Wanted, most_rows: int | None = None) -> dict[str, np.ndarray]:
    """Columns of a Parquet file as arrays: (rows,), or (rows, n) where each cell is a list of n."""
    with decoding(path, "Parquet", "export it again"), pq.ParquetFile(path) as file:
        tops = [column.name for column in file.schema_arrow if is_wanted(column.name, column.type, wanted)]
        groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
        stated = [group.column(i) for group in groups for i in range(group.num_columns)]  # items of lists counted
        of = tuple(f"{top}." for top in tops)
        values = sum(column.num_values for column in stated if f"{column.path_in_schema}.".startswith(of))
        check_size(path, values, file.metadata.num_rows, most_rows)
        check_pages(path, file, set(tops))
        table = file.read(columns=tops)
    columns = dict(zip(table.column_names, table.columns, strict=True))
    arrays: dict[str, np.ndarray] = {}
    while columns:
        name, column = columns.popitem()
        if pa.types.is_struct(column.type):
            for i in range(column.type.num_fields):
                parts = [chunk.field(i) for chunk in column.chunks]
                columns[f"{name}.{column.type.field(i).name}"] = pa.chunked_array(parts)
        elif wanted(name):
            arrays[name] = cells(column, f"{path}, column {name}")
    return arrays


def is_wanted(name: str, kind: pa.DataType, wanted: Wanted) -> bool:
    """Whether a column, or a field of a structure, is wanted."""
    if not pa.types.is_struct(kind):
        return wanted(name)
    fields = [kind.field(i) for i in range(kind.num_fields)]
    return any(is_wanted(f"{name}.{field.name}", field.type, wanted) for field in fields)


def cells(column: pa.ChunkedArray, where: str) -> np.ndarray:
    """A column as an array; lists must be of one length."""
    kind = column.type
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)):
        return column.to_numpy()
    whole = column.combine_chunks()
    flat = pa.chunked_array([whole.flatten()])
    lengths = np.asarray(pa.compute.list_value_length(whole).fill_null(0))
    if len(np.unique(lengths)) > 1:
        row = int(np.flatnonzero(lengths != lengths[0])[0])
        raise InputError(f"{where}, row {row}", f"{lengths[row]} items", f"{lengths[0]}, as in row 0", "repair it")
    items = cells(flat, where)
    return items.reshape(len(whole), int(lengths[0]) if len(lengths) else 0, *items.shape[1:])


INFO, EPISODE = "meta/info.json", "episode_index"
VERSIONS = ("v2", "v3")
POSITION, GRIPPER = ".pos", "gripper"  # end of the names of positions, and of the joint whose range goes from 0 to 100
TICKS = 4095  # what LeRobot divides a turn into where it turns ticks of a motor into degrees
NORMALISED = re.compile(r"so_?10[01]|koch|lekiwi|omx|hope_?jr")
"""Types of robots that LeRobot records as shares of their range unless told otherwise."""


@dataclass(frozen=True)
class LeRobotOptions(TableOptions):
    """Options of LeRobot datasets. Without a map of its own, ``time`` is their ``timestamp``."""

    cut_by: str | None = EPISODE  # the column that cuts the dataset into logs
    calibration: str | None = None
    """LeRobot's calibration file of the robot, JSON, where positions are shares of each joint's range: they then come
    in degrees from the middle of that range, those of a gripper from its closed end."""


class LeRobot(TableFormat):
    """A dataset folder: ``meta/info.json`` beside ``data/``; videos are not read."""

    name = "lerobot"
    suffixes = (".parquet",)
    holds = "LeRobot dataset"
    Options = LeRobotOptions
    columns: ClassVar[Mapping[str, str]] = {"time": "timestamp"}

    def find(self, source: Path) -> dict[str, Path]:
        """The dataset that a folder is, or the datasets in it."""
        return self.folders(source, INFO)

    def first_log(self, table: Table) -> Table:
        """The first episode: the time begins anew with each."""
        episode = table.arrays.get(EPISODE)
        if episode is None or not len(episode):
            return table
        return Table(table.path, {name: array[episode == episode[0]] for name, array in table.arrays.items()})

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """Columns of all files of the dataset; those of a vector are also there by the names in ``info.json``."""
        features, files = features_of(path), sorted((path / "data").rglob("*.parquet"))
        if not files:
            raise InputError(path, "no data/**/*.parquet", "the files of a dataset", "copy it whole")

        def needed(name: str) -> bool:
            return wanted(name) or any(wanted(f"{name}.{part}") for part in features.get(name, ()))

        parts, taken = [], 0
        for file in files:
            parts.append(parquet_arrays(file, needed))
            taken += sum(array.size for array in parts[-1].values())
            check_size(path, taken)
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for name in [name for name in arrays if name in features]:
            parts_of = arrays[name].reshape(len(arrays[name]), -1).T  # a vector of one is stored as numbers
            named = zip(features[name], parts_of, strict=False)
            arrays |= {f"{name}.{part}": values for part, values in named if wanted(f"{name}.{part}")}
        if options is not None and options.calibration is not None:
            ranges = calibration_of(Path(options.calibration))
            arrays |= {
                name: in_degrees(name, values, ranges) for name, values in arrays.items() if name.endswith(POSITION)
            }
        return arrays

    def stated(self, path: Path, options: LeRobotOptions) -> Mapping[str, Any]:
        """The rate of the rows, and whether positions may be shares of a range."""
        info = info_of(path)
        of_joints = any(name.endswith(POSITION) for names in features_of(path).values() for name in names)
        fps, shares = info.get("fps"), of_joints and NORMALISED.search(str(info.get("robot_type")).lower())
        found: dict[str, Any] = {"period_s": 1 / fps} if isinstance(fps, int | float) and 0 < fps < 1e5 else {}
        return found | {"unit": "deg" if options.calibration else "normalised" if shares else None}


def features_of(path: Path) -> dict[str, list[str]]:
    """Names of the components of each vector, from ``meta/info.json``."""
    info = info_of(path)
    features: dict[str, list[str]] = {}
    try:
        for name, one in info["features"].items():
            names = one.get("names")
            if isinstance(names, dict):  # some datasets keep them below a word such as ``motors``
                names = next(iter(names.values()), None)
            if isinstance(names, list) and names:
                features[name] = list(map(str, names))
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(path / INFO, f"no readable info ({error!r})", "that of a dataset", "copy it whole") from None
    return features


def info_of(path: Path) -> Mapping[str, Any]:
    """``meta/info.json`` of a dataset; ``InputError`` for other versions."""
    info = read_json(path / INFO)
    version = str(info.get("codebase_version"))
    if not version.startswith(VERSIONS):
        do = "convert it with LeRobot's own converter"
        raise InputError(path / INFO, f"version {version}", "version 2 or 3 of the format", do)
    return info


def calibration_of(path: Path) -> Mapping[str, tuple[float, bool]]:
    """Joint → its range, degrees, and whether the drive counts backwards, from LeRobot's calibration file."""
    stated = read_json(path)
    try:
        return {
            str(joint): ((one["range_max"] - one["range_min"]) * 360 / TICKS, bool(one.get("drive_mode")))
            for joint, one in stated.items()
        }
    except (KeyError, TypeError, AttributeError) as error:
        expected = "LeRobot's calibration: range_min and range_max of each joint"
        raise InputError(path, f"no readable calibration ({error!r})", expected, "name that file") from None


def in_degrees(name: str, values: np.ndarray, ranges: Mapping[str, tuple[float, bool]]) -> np.ndarray:
    """Shares of a joint's range as degrees from its middle; of a gripper, 0 to 100, from its closed end."""
    joint = name.removesuffix(POSITION).rpartition(".")[2]
    if joint not in ranges:
        raise InputError(name, f"no calibration of {joint}", ", ".join(ranges), "name the calibration of this robot")
    width, backwards = ranges[joint]
    if joint.endswith(GRIPPER):
        return width * (100 - values if backwards else values) / 100
    return width * (-values if backwards else values) / 200
