"""Importer of CSV files: text tables, one or several logs a file."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv

from leapgap.errors import InputError
from leapgap.logs.files import Bounded, decoding
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Wanted, check_size

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
