"""Importer of NumPy archives; nothing in them is unpickled."""

import zipfile
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from leapgap.errors import InputError
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, fields, product
from leapgap.logs.unpacking import Bounded

HEADER_BYTES = 100_000
"""Most bytes in which an array states its shape and type."""


class Npz(TableFormat):
    """Archives of arrays as ``numpy.savez`` writes them, or one structured array (``.npy``)."""

    name = "npz"
    suffixes = (".npz", ".npy")
    holds = "NumPy archive"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The arrays of an archive; the fields of a structured array are arrays of their own."""
        if path.suffix == ".npy":
            with path.open("rb") as file:
                return fields("array", array_of(file, path, 0))
        arrays: dict[str, np.ndarray] = {}
        with zipfile.ZipFile(path) as folder:
            for member in folder.namelist():
                name = member.removesuffix(".npy")
                if name != member and wanted(name):
                    with folder.open(member) as packed:
                        taken = sum(array.size for array in arrays.values())
                        arrays |= fields(name, array_of(cast(BinaryIO, packed), f"{path}, {name}", taken))
        return arrays


def array_of(file: BinaryIO, where: object, taken: int) -> np.ndarray:
    """One array, after its stated size and type were checked; ``taken`` values are in memory before it."""
    head = cast(BinaryIO, Bounded(file, where, HEADER_BYTES))
    version = npy.read_magic(head)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, kind = read_header(head)
    if kind.hasobject:
        raise InputError(where, "Python objects", "an array of numbers", "save it as numbers")
    check_size(where, taken + product(shape) * kind.itemsize / 8)
    file.seek(0)
    return npy.read_array(file, allow_pickle=False)
