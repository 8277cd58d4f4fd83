"""Importer of Parquet files of any origin; lists of fixed length are arrays, structures are joined by dots."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.parquet as pq

from leapgap.errors import InputError
from leapgap.logs.files import decoding
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size
from leapgap.logs.log import METADATA_KEY
from leapgap.logs.parquet_pages import check_pages


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
        check_size(path, sum(stored_values(file, top) for top in tops), file.metadata.num_rows, most_rows)
        check_pages(path, file, set(tops))
        table = file.read(columns=tops)
    columns = dict(zip(table.column_names, table.columns, strict=True))
    arrays: dict[str, np.ndarray] = {}
    while columns:
        name, column = columns.popitem()
        if pa.types.is_struct(column.type):
            columns |= {f"{name}.{key.name}": pa.chunked_array(field) for key, field in fields_of(column)}
        elif wanted(name):
            arrays[name] = cells(column, f"{path}, column {name}")
    return arrays


def is_wanted(name: str, kind: pa.DataType, wanted: Wanted) -> bool:
    """Whether a column, or a field of a structure, is wanted."""
    if not pa.types.is_struct(kind):
        return wanted(name)
    fields = [kind.field(i) for i in range(kind.num_fields)]
    return any(is_wanted(f"{name}.{field.name}", field.type, wanted) for field in fields)


def stored_values(file: pq.ParquetFile, top: str) -> int:
    """Number of values that a column states, items of lists counted."""
    groups = (file.metadata.row_group(i) for i in range(file.num_row_groups))
    columns = (group.column(i) for group in groups for i in range(group.num_columns))
    return sum(column.num_values for column in columns if f"{column.path_in_schema}.".startswith(f"{top}."))


def fields_of(column: pa.ChunkedArray) -> list[tuple[pa.Field, list[pa.Array]]]:
    """The fields of a structure, each with its parts."""
    return [(column.type.field(i), [chunk.field(i) for chunk in column.chunks]) for i in range(column.type.num_fields)]


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
