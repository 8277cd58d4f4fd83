"""The two files of a model, as trained or as exported: ``<model>.json`` beside the arrays in ``<model>.npz``."""

import csv
import math
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import IO, Any, TypeVar, cast

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.files import Bounded
from leapgap.runtime.atomic_io import read_json, whole_file

NOON_OF_ZIP = (1980, 1, 1, 0, 0, 0)  # One date for every member, so that equal arrays give equal bytes
LARGEST_BYTES = 2 << 30  # Largest size of all arrays of a file together
LARGEST_HEADER = 100_000  # Bytes in which an array states its shape and type
KINDS = "biuf"  # Kinds of values that arrays may have: truth values and numbers
BROKEN: tuple[type[BaseException], ...] = (
    *(ValueError, EOFError, OSError, KeyError, NotImplementedError, RuntimeError, SyntaxError, MemoryError),
    *(zipfile.BadZipFile, zlib.error),
)
"""What reading a broken archive of arrays raises."""


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Like ``numpy.savez``, but whole and without the clock: equal arrays give equal bytes."""
    with whole_file(path) as beside, zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = BytesIO()
            np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", NOON_OF_ZIP), member.getvalue())


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read arrays of numbers, never pickles; ``InputError`` where the file is absent or broken.

    Sizes are compared before memory is taken: a member may claim neither more than it has nor more than
    ``LARGEST_BYTES``.
    """
    if not path.exists():
        raise InputError(path, "no such file", "arrays written by a stage", "run that stage first")
    if not path.is_file():
        raise InputError(path, "no plain file", "arrays written by a stage", "name the folder that a stage wrote")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > LARGEST_BYTES:
                raise ValueError(f"arrays of more than {LARGEST_BYTES >> 30} GiB")
            return {member.filename.removesuffix(".npy"): read_member(archive, member) for member in members}
    except BROKEN as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, f"no whole archive ({said})", "arrays written by a stage", "run it again") from None


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array of an archive; ``ValueError`` where its header and its size differ."""
    with archive.open(member) as file:
        head = Bounded(file, member.filename, LARGEST_HEADER)
        size = size_by_header(cast(IO[bytes], head), member.filename) + head.most - head.left
    if size != member.file_size:
        raise ValueError(f"{member.filename}: {member.file_size} bytes, and {size} by its header")
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def size_by_header(file: IO[bytes], name: str) -> int:
    """Bytes of the values of an array by its header, which is read."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{name}: version {version} of the format")
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(file)
    if dtype.kind not in KINDS or min(shape, default=0) < 0:
        raise ValueError(f"{name}: values of type {dtype}, shape {shape}")
    return math.prod(shape) * dtype.itemsize


def check_finite(arrays: Mapping[str, np.ndarray], where: object, do: str, infinite: Iterable[str] = ()) -> None:
    """Raise ``InputError`` for the first array that holds NaN or an infinite value.

    Arrays whose last name (``force_scale`` of ``contact/force_scale``) is in ``infinite`` may be infinite.
    """
    for name, array in arrays.items():
        if array.dtype.kind != "f":
            continue
        bad = np.isnan(array) if name.rpartition("/")[2] in infinite else ~np.isfinite(array)
        if bad.any():
            found = f"{int(bad.sum())} of {array.size} values of {name} that are not finite"
            raise InputError(where, found, "finite numbers", do)


Content = TypeVar("Content")


def read_model(
    folder: Path,
    name: str,
    format_version: int,
    build: Callable[[Mapping[str, Any], dict[str, np.ndarray]], Content],
    infinite: Callable[[Mapping[str, Any]], Iterable[str]] = lambda _: (),
) -> Content:
    """Build a model from its JSON object and its arrays; ``InputError`` where they are absent, broken or of another
    version, lack what ``build`` asks for, or hold numbers that are not finite.

    ``infinite`` names arrays that may be infinite, from the JSON object.
    """
    path, again = folder / f"{name}.json", "run stages.train again"
    about = read_json(path)
    if about.get("format_version") != format_version:
        raise InputError(path, f"format_version {about.get('format_version')}", str(format_version), again)
    arrays = read_npz(folder / f"{name}.npz")
    if not is_finite(about):
        raise InputError(path, "a number that is not finite", "finite numbers", again)
    try:
        check_finite(arrays, folder / f"{name}.npz", again, infinite(about))
        return build(about, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        found = f"a model that does not fit ({error!r})"
        raise InputError(path, found, "a model of this version", again) from None


def is_finite(value: Any) -> bool:
    """Whether all numbers of a JSON value are finite; JSON has no others, but Python reads them."""
    if isinstance(value, Mapping):
        return all(map(is_finite, value.values()))
    if isinstance(value, list):
        return all(map(is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def arrays_below(arrays: Mapping[str, np.ndarray], place: str) -> dict[str, np.ndarray]:
    """Arrays whose names begin with ``place/``, with that prefix removed."""
    return {name.removeprefix(f"{place}/"): a for name, a in arrays.items() if name.startswith(f"{place}/")}


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table whole, numbers as texts of their callers."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
