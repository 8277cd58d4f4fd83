"""Importer of files that ``torch.save`` wrote, without torch and without running what is in them.

Such a file is a zip: ``data.pkl`` says which arrays there are, and ``data/0``, ``data/1``, … hold their bytes. The
pickle is read by an unpickler that knows mappings, lists, numbers, texts and tensors. Whatever else it asks for is
refused.
"""

import io
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.files import MOST_BYTES
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, product
from leapgap.logs.unpacking import member

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
LARGEST_PICKLE = 10_000_000
"""Bytes of ``data.pkl``; that of a thousand tensors has a hundredth of it."""
DEEPEST, MOST_ARRAYS = 8, 10_000


class Pt(TableFormat):
    """Tensors in mappings and lists as ``torch.save`` writes them."""

    name = "pt"
    suffixes = (".pt", ".pth")

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The tensors of a file by name; in mappings of mappings the names are joined by dots."""
        try:
            with zipfile.ZipFile(path) as folder:
                saved = Archive(path, folder).read()
                arrays: dict[str, np.ndarray] = {}
                collect("", saved, arrays, path, DEEPEST)
        except zipfile.BadZipFile:
            expected = "a zip, as torch.save writes it since version 1.6"
            raise InputError(path, "no whole zip", expected, "save it again") from None
        except (pickle.UnpicklingError, EOFError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
            expected = "tensors in mappings and lists"
            raise InputError(
                path, f"a pickle of something else ({error})", expected, "save the tensors alone"
            ) from None
        return {name: array for name, array in arrays.items() if wanted(name)}


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
    """Reads ``data.pkl``, and the bytes of tensors where it refers to them."""

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

    def read(self) -> Any:
        """The object that ``torch.save`` was given, with arrays in place of tensors."""
        return self.load()

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
        if product(shape) and last >= len(storage):
            raise ValueError(f"a tensor that ends at value {last} of {len(storage)}")
        self.count(product(shape))
        steps = [stride * storage.itemsize for stride in strides]
        return np.lib.stride_tricks.as_strided(storage[offset:], shape, steps).copy()

    def count(self, values: int) -> None:
        """Add to what is in memory, before it is."""
        self.taken += values
        check_size(self.path, self.taken)


def collect(name: str, value: Any, arrays: dict[str, np.ndarray], path: Path, depth: int) -> None:
    """Add an array, or those of a mapping or list, under its name."""
    if len(arrays) > MOST_ARRAYS or depth < 0:
        raise InputError(path, "too many tensors, or too deep", f"{MOST_ARRAYS} in {DEEPEST} levels", "save fewer")
    if isinstance(value, np.ndarray):
        arrays[name or "array"] = value
    elif isinstance(value, dict | list | tuple):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, one in items:
            if isinstance(one, np.ndarray | dict | list | tuple):
                collect(f"{name}.{key}" if name else str(key), one, arrays, path, depth - 1)
