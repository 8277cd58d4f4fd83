"""Importer of MATLAB files; fields of structures are joined by dots, such as ``log.q``."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.importers.hdf5 import hdf5_arrays
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, flat
from leapgap.logs.unpacking import MOST_UNPACKED, inflated_size

HEADER_BYTES, COMPRESSED = 128, 15


class Mat(TableFormat):
    """Files of MATLAB up to 7.2, and from 7.3 on, which are HDF5."""

    name = "mat"
    suffixes = (".mat",)
    holds = "MATLAB file"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The arrays of numbers in a MATLAB file."""
        with path.open("rb") as file:
            version = file.read(HEADER_BYTES)
        if version.startswith(b"MATLAB 7.3"):
            by_path = hdf5_arrays(path, lambda name: wanted(dotted(name)))
            return {dotted(name): array.T for name, array in by_path.items()}
        from scipy.io import loadmat

        if version.startswith(b"MATLAB"):
            check_elements(path)
        else:
            check_size(path, path.stat().st_size / 8)
        variables = loadmat(path, squeeze_me=True, struct_as_record=False)
        found = flat(variables, inside, path)
        numbers = {name: np.asarray(one) for name, one in found.items() if isinstance(one, np.ndarray | int | float)}
        return {name: array for name, array in numbers.items() if array.dtype.kind in "biuf" and wanted(name)}


def inside(value: Any) -> Mapping[str, Any] | None:
    """What ``flat`` goes into: the variables, and structures."""
    return vars(value) if hasattr(value, "_fieldnames") else value if isinstance(value, dict) else None


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
