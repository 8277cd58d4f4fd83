"""Importers of zips of arrays: NumPy's archives, and what ``torch.save`` wrote; nothing in them is run."""

import io
import math
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from leapgap.errors import InputError
from leapgap.logs.files import MOST_BYTES, Bounded, member
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, fields, flat

HEADER_BYTES = 100_000  # most bytes in which an array states its shape and type


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
    check_size(where, taken + math.prod(shape) * kind.itemsize / 8)
    file.seek(0)
    return npy.read_array(file, allow_pickle=False)


DTYPES = {
    "FloatStorage": "f4",
    "DoubleStorage": "f8",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
    "ShortStorage": "i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
LARGEST_PICKLE = 10_000_000  # bytes of ``data.pkl``; that of a thousand tensors has a hundredth of it


class Pt(TableFormat):
    """Tensors in mappings and lists as ``torch.save`` writes them."""

    name = "pt"
    suffixes = (".pt", ".pth")
    holds = "zip of tensors in mappings and lists, as torch.save writes it since version 1.6"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The tensors of a file by name; in mappings of mappings the names are joined by dots."""
        with zipfile.ZipFile(path) as folder:
            saved = Archive(path, folder).load()
        found = {"array": saved} if isinstance(saved, np.ndarray) else flat(saved, path, lambda _: True)
        return {name: array for name, array in found.items() if isinstance(array, np.ndarray) and wanted(name)}


class Fixed:
    """What a pickle may name and not change: the opcode that sets the state of an object fails on it."""

    __slots__ = ()

    def __setstate__(self, state: object) -> None:
        raise pickle.UnpicklingError("it sets the state of an object")


@dataclass(frozen=True)
class Storage(Fixed):
    """What the pickle calls a type of storage."""

    __slots__ = ("dtype",)
    dtype: str


@dataclass(frozen=True)
class Call(Fixed):
    """A function that the pickle may call."""

    __slots__ = ("function",)
    function: Callable[..., Any]

    def __call__(self, *arguments: Any) -> Any:
        """What the function returns for arguments of the pickle."""
        return self.function(*arguments)


class Archive(pickle.Unpickler):
    """Reads ``data.pkl``, with arrays in place of tensors, and their bytes where it refers to them."""

    def __init__(self, path: Path, folder: zipfile.ZipFile) -> None:
        self.path, self.folder = path, folder
        files = [name for name in folder.namelist() if name.endswith("/data.pkl")]
        if len(files) != 1:
            raise InputError(path, f"{len(files)} files data.pkl", "one, as torch.save writes it", "save it again")
        self.root = files[0].removesuffix("data.pkl")
        order = f"{self.root}byteorder"
        self.order = ">" if order in folder.namelist() and member(folder, order, path, 100).strip() == b"big" else "<"
        self.taken = 0
        super().__init__(io.BytesIO(member(folder, files[0], path, LARGEST_PICKLE)))

    def find_class(self, module: str, name: str) -> Any:
        """The few names that a pickle of tensors holds; any other is refused and nothing of it is imported."""
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return Call(self.tensor)
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if module == "torch" and name in DTYPES:
            return Storage(DTYPES[name])
        expected = "tensors in mappings and lists alone"
        raise InputError(self.path, f"{module}.{name} in the pickle", expected, "save the tensors alone")

    def persistent_load(self, reference: Any) -> np.ndarray:
        """The bytes of one storage: ``("storage", type, file, device, number of values)``."""
        _, kind, file, _, number = reference
        dtype = np.dtype(kind.dtype).newbyteorder(self.order)
        name = f"{self.root}data/{file}"
        size = self.folder.getinfo(name).file_size
        if size != number * dtype.itemsize:
            found, expected = f"{size} bytes", f"{number} values of {dtype.itemsize} bytes"
            raise InputError(f"{self.path}, data/{file}", found, expected, "the file is damaged: copy it again")
        self.count(number)
        return np.frombuffer(member(self.folder, name, self.path, MOST_BYTES), dtype)

    def tensor(
        self, storage: np.ndarray, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *_: Any
    ) -> Any:
        """The view of a storage that a tensor is, as a copy."""
        if len(shape) != len(strides) or any(one < 0 for one in (offset, *shape, *strides)):
            raise ValueError(f"a tensor of shape {shape} and strides {strides}")
        last = offset + sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
        if math.prod(shape) and last >= len(storage):
            raise ValueError(f"a tensor that ends at value {last} of {len(storage)}")
        self.count(math.prod(shape))
        steps = [stride * storage.itemsize for stride in strides]
        return np.lib.stride_tricks.as_strided(storage[offset:], shape, steps).copy()

    def count(self, values: int) -> None:
        """Add to what is in memory, before it is."""
        self.taken += values
        check_size(self.path, self.taken)
