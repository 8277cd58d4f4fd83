"""Importer of MATLAB files; fields of structures are joined by dots, such as ``log.q``."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.importers.hdf5 import hdf5_arrays
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size
from leapgap.logs.unpacking import MOST_UNPACKED, inflated_size

HEADER_BYTES, COMPRESSED = 128, 15
DEEPEST = 8
"""Structures in structures are read down to here."""


class Mat(TableFormat):
    """Files of MATLAB up to 7.2, and from 7.3 on, which are HDF5."""

    name = "mat"
    suffixes = (".mat",)

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The arrays of numbers in a MATLAB file."""
        with path.open("rb") as file:
            version = file.read(HEADER_BYTES)
        if version.startswith(b"MATLAB 7.3"):
            by_path = hdf5_arrays(path, lambda name: wanted(dotted(name)))
            return {dotted(name): array.T for name, array in by_path.items()}
        from scipy.io import loadmat

        try:
            if version.startswith(b"MATLAB"):
                check_elements(path)
            else:
                check_size(path, path.stat().st_size / 8)
            variables = loadmat(path, squeeze_me=True, struct_as_record=False)
        except (ValueError, TypeError, OSError, EOFError, IndexError, KeyError, zlib.error, struct.error) as error:
            raise InputError(path, f"no whole MATLAB file ({error})", "arrays of numbers", "save it again") from None
        arrays: dict[str, np.ndarray] = {}
        for name, value in variables.items():
            collect(name, value, arrays, DEEPEST)
        return {name: array for name, array in arrays.items() if wanted(name)}


def dotted(name: str) -> str:
    """The name of a dataset as that of a field."""
    return name.replace("/", ".")


def check_elements(path: Path) -> None:
    """Check the sizes of the variables in a file of version 5, those of compressed ones by inflating them."""
    size = path.stat().st_size
    with path.open("rb") as file:
        order = "<" if file.read(HEADER_BYTES)[126:128] == b"IM" else ">"
        total = 0
        while (tag := file.read(8)) and len(tag) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            after = file.tell() + length
            if after > size:
                raise InputError(path, f"{size} bytes", f"{after} or more", "the file is cut off: copy it again")
            total += inflated_size(file, length, path, max(0, MOST_UNPACKED - total)) if kind == COMPRESSED else length
            check_size(path, total / 8)
            file.seek(after)


def collect(name: str, value: Any, arrays: dict[str, np.ndarray], depth: int) -> None:
    """Add an array, or the fields of a structure, under its name."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        arrays[name] = value
    elif depth and hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            collect(f"{name}.{field}", getattr(value, field), arrays, depth - 1)
