"""Tables of numbers: what a file of any tabular format is read as, with the errors that all such files share."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.files import MOST_BYTES, check_values_fit

MOST_DIMENSIONS = 2
DEEPEST, MOST_COLUMNS = 16, 10_000  # mappings in mappings, and columns of one file, that are looked at
INDEXED = re.compile(r"^(?P<array>.+)\[(?P<index>\d+(?:,\d+)*)\]$")  # ``dof_pos[3]``: the fourth column of an array

Arrays = Mapping[str, np.ndarray]
Wanted = Callable[[str], bool]  # Whether an array is needed. A reader may leave out what is not.


def check_size(path: object, values: float, rows: float = 0, most_rows: int | None = None) -> None:
    """``InputError`` where a file states more values, or rows, than are taken into memory."""
    if most_rows is not None and rows > most_rows:
        raise InputError(path, f"{rows:.0f} rows", f"at most {most_rows} (most_rows)", "cut the file, or allow more")
    check_values_fit(path, values, MOST_BYTES)


@dataclass(frozen=True)
class Table:
    """Named arrays of one file. Columns of an array of several dimensions are named ``array[2]`` or ``array[0,1]``."""

    path: Path
    arrays: Arrays

    def __contains__(self, column: str) -> bool:
        return column in self.arrays or self.of_array(column) is not None

    def of_array(self, column: str) -> tuple[str, tuple[int, ...]] | None:
        """Array and index that a column's name stands for; None where there is no such array."""
        found = INDEXED.match(column)
        if found is None or found["array"] not in self.arrays:
            return None
        return found["array"], tuple(int(one) for one in found["index"].split(","))

    @property
    def columns(self) -> list[str]:
        """Names of all columns; those of an array of several dimensions by their index."""
        rows, names = self.rows, []
        for name, array in self.arrays.items():
            values = oriented(array, rows)
            if values.ndim == 1:
                names.append(name)
            elif values.ndim > 1:
                names += [f"{name}[{','.join(map(str, at))}]" for at in np.ndindex(values.shape[1:])]
        return names

    @cached_property
    def rows(self) -> int:
        """Length of the arrays that hold most values, pictures aside; 0 where there is none."""
        held: dict[int, int] = defaultdict(int)
        for array in self.arrays.values():
            if array.ndim and array.size and np.squeeze(array).ndim <= MOST_DIMENSIONS:
                held[max(array.shape)] += array.size
        return max(held, key=lambda length: (held[length], length), default=0)

    def values(self, column: str, rows: int | None = None) -> np.ndarray:
        """One column, (rows,), as it stands in the file; ``InputError`` where its length is another than ``rows``."""
        array, index = self.of_array(column) or (column, ())
        if column in self.arrays:
            array, index = column, ()
        found = oriented(self.arrays[array], rows or self.rows)
        at: tuple[Any, ...] = (slice(None), *index)
        try:
            values = found[at] if index else found
        except IndexError:
            shape = f"shape {self.arrays[array].shape}"
            raise InputError(f"{self.path}, {array}", shape, f"a column {list(index)}", "correct the index") from None
        if values.ndim != 1:
            expected = f"one column, such as {array}[0]"
            raise InputError(f"{self.path}, {array}", f"shape {self.arrays[array].shape}", expected, "name the column")
        if rows is not None and len(values) != rows:
            where = f"{self.path}, column {column}"
            raise InputError(where, f"{len(values)} rows", f"{rows}, as the time has", "map a column of that length")
        return values

    def numbers(self, column: str, rows: int | None = None) -> np.ndarray:
        """One column as float64; an empty cell is NaN, text is an ``InputError`` with its row."""
        values = self.values(column, rows)
        return as_numbers(values, f"{self.path}, column {column}")

    def instants(self, column: str, rows: int | None = None) -> np.ndarray:
        """The same of time stamps, from the first; whole numbers are subtracted whole, for 10¹⁸ ns need all digits."""
        values = self.values(column, rows)
        if values.dtype.kind in "iu":
            values = values.astype(np.int64)
        if values.dtype.kind in "iM" and len(values):
            values = values - values[0]
        return as_numbers(values, f"{self.path}, column {column}")


def oriented(array: np.ndarray, rows: int) -> np.ndarray:
    """The array with its rows in the first dimension; dimensions of length 1 are left out."""
    values = np.squeeze(array) if array.ndim > 1 else np.atleast_1d(array)
    if values.ndim == 0:
        return values.reshape(1)
    if values.ndim > 1 and values.shape[0] != rows and rows in values.shape:
        return np.moveaxis(values, values.shape.index(rows), 0)
    return values


def as_numbers(values: np.ndarray, where: str) -> np.ndarray:
    """Values as float64; dates become seconds, texts that are numbers become those."""
    if values.dtype.kind in "Mm":
        whole = values.astype(f"{values.dtype.kind}8[ns]")
        return np.where(np.isnat(whole), np.nan, whole.astype(np.int64) * 1e-9)
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    numbers = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            numbers[row] = np.nan if value is None or value == "" else float(value)
        except (TypeError, ValueError):
            raise InputError(f"{where}, row {row}", f"{value!r:.40}", "a number", "export it again") from None
    return numbers


def flat(held: Any, path: object, numbered: Callable[[Any], bool] = lambda _: False) -> dict[str, Any]:
    """What nested mappings hold, by names joined by dots: ``outer.inner``; of structures of MATLAB their fields.

    Lists are there by their numbers, ``motors.0.q``, where they are such as are ``numbered``.
    """

    def inside(value: Any) -> Mapping[Any, Any] | None:
        if isinstance(value, list | tuple) and numbered(value):
            return dict(enumerate(value))
        return value if isinstance(value, Mapping) else vars(value) if hasattr(value, "_fieldnames") else None

    found: dict[str, Any] = {}
    left = [("", held, 0)]
    while left:
        name, value, depth = left.pop()
        below = inside(value) if not name or depth < DEEPEST else None
        if below is None:
            found[name] = value
        else:
            left += [(f"{name}.{key}" if name else str(key), one, depth + 1) for key, one in reversed([*below.items()])]
        if len(found) + len(left) > MOST_COLUMNS:
            raise InputError(path, f"more than {MOST_COLUMNS} values by name", "the columns of a log", "save fewer")
    return found


def fields(name: str, array: np.ndarray) -> dict[str, np.ndarray]:
    """The array by its name, or each field of a structured one as ``name.field``."""
    if array.dtype.names is None:
        return {name: array}
    return {f"{name}.{one}": array[one] for one in array.dtype.names}
