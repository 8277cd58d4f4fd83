"""Importers of HDF5 files, whose arrays are named by their path, and of MATLAB files, by the fields of structures."""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError, needs
from leapgap.logs.files import MOST_UNPACKED, inflated_size, unpack
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, fields, flat

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3  # numbers of HDF5's own filters: the first packs, and the others do not
SMALL_PIECE, LARGEST_PIECE = 1 << 16, 1 << 24
"""Bytes of a packed piece that cannot unpack to much, and of one that is unpacked without a trial."""
DEEPEST, MOST_ITEMS = 16, 100_000  # levels of groups, and groups and datasets of all levels, that are looked at


class Hdf5(TableFormat):
    """Datasets of an HDF5 file."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".hdf")
    holds = "HDF5"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The wanted datasets of numbers; links to other files are not followed."""
        return hdf5_arrays(path, wanted)


def hdf5_arrays(path: Path, wanted: Wanted) -> dict[str, np.ndarray]:
    """Datasets by their path in the file; a compound one gives an array a field."""
    with needs("logs"):
        import h5py

    arrays: dict[str, np.ndarray] = {}
    with h5py.File(path, "r") as file:
        for name, item in datasets(file, path):
            if item.shape is None:
                continue
            names = [name] if item.dtype.names is None else [f"{name}.{one}" for one in item.dtype.names]
            if not any(map(wanted, names)) or item.dtype.hasobject:
                continue
            where = f"{path}, {name}"
            if item.external or item.is_virtual:
                raise InputError(where, "data in another file", "data in this file", "copy them into it")
            check_size(where, item.size * item.dtype.itemsize / 8 + sum(one.size for one in arrays.values()))
            check_chunks(item, where)
            arrays.update(fields(name, item[()]))
    return arrays


def check_chunks(item: Any, where: str) -> None:
    """``InputError`` where a packed piece of a dataset unpacks to more than it states, or may and cannot be tried."""
    if item.chunks is None or (kind := item.id.get_create_plist()).get_nfilters() == 0:
        return
    size = math.prod(item.chunks) * item.dtype.itemsize
    check_size(where, size / 8)
    filters = [kind.get_filter(i)[0] for i in range(kind.get_nfilters())]
    packers = [one for one in filters if one not in (SHUFFLE, CHECKSUM)]
    large: list[Any] = []
    item.id.chunk_iter(lambda one: large.append(one) if one.size > SMALL_PIECE else None)
    for one in large:
        if packers == [DEFLATE] and filters[-1] in (DEFLATE, CHECKSUM):
            mask, data = item.id.read_direct_chunk(one.chunk_offset)
            if not mask:
                unpack(data[:-4] if filters[-1] == CHECKSUM else data, zlib.decompressobj, where, size)
        elif packers and one.size > LARGEST_PIECE:
            raise InputError(where, f"packed pieces of {one.size} bytes", f"{LARGEST_PIECE} at most", "save it again")


def datasets(file: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Datasets by their path in the file, in the order of names; links to other places are not followed.

    A group that holds itself is met once. ``InputError`` where groups lie deeper, or are more, than any log needs.
    """
    import h5py

    met, number = {h5py.h5o.get_info(file.id).addr}, 0
    waiting: list[tuple[str, Any, int]] = [("", file, 0)]
    while waiting:
        name, item, depth = waiting.pop()
        if isinstance(item, h5py.Dataset):
            yield name, item
            continue
        below = []
        for key in item:
            number += 1
            if depth >= DEEPEST or number > MOST_ITEMS:
                expected = f"at most {MOST_ITEMS} items in {DEEPEST} levels"
                raise InputError(path, "too many groups, or too deep", expected, "save the arrays alone")
            if not isinstance(item.get(key, getlink=True), h5py.HardLink):
                continue
            found = item[key]
            address = h5py.h5o.get_info(found.id).addr
            if address not in met and isinstance(found, h5py.Dataset | h5py.Group):
                met.add(address)
                below.append((f"{name}/{key}".removeprefix("/"), found, depth + 1))
        waiting += reversed(below)


MAT_HEADER_BYTES, COMPRESSED = 128, 15


class Mat(TableFormat):
    """Files of MATLAB up to 7.2, and from 7.3 on, which are HDF5."""

    name = "mat"
    suffixes = (".mat",)
    holds = "MATLAB file"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The arrays of numbers in a MATLAB file."""
        with path.open("rb") as file:
            version = file.read(MAT_HEADER_BYTES)
        if version.startswith(b"MATLAB 7.3"):
            by_path = hdf5_arrays(path, lambda name: wanted(name.replace("/", ".")))
            return {name.replace("/", "."): array.T for name, array in by_path.items()}
        from scipy.io import loadmat

        if version.startswith(b"MATLAB"):
            check_elements(path)
        else:
            check_size(path, path.stat().st_size / 8)
        variables = loadmat(path, squeeze_me=True, struct_as_record=False)
        found = flat(variables, path)
        numbers = {name: np.asarray(one) for name, one in found.items() if isinstance(one, np.ndarray | int | float)}
        return {name: array for name, array in numbers.items() if array.dtype.kind in "biuf" and wanted(name)}


def check_elements(path: Path) -> None:
    """Check the sizes of the variables in a file of version 5, those of compressed ones by inflating them."""
    size = path.stat().st_size
    with path.open("rb") as file:
        order = "<" if file.read(MAT_HEADER_BYTES)[126:128] == b"IM" else ">"
        total = 0
        while (tag := file.read(8)) and len(tag) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            after = file.tell() + length
            if after > size:
                raise InputError(path, f"{size} bytes", f"{after} or more", "the file is cut off: copy it again")
            total += inflated_size(file, length, path, max(0, MOST_UNPACKED - total)) if kind == COMPRESSED else length
            check_size(path, total / 8)
            file.seek(after)
