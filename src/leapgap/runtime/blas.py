"""One thread for linear algebra, so that results do not depend on the number of cores.

BLAS adds up in another order with another number of threads, and the last bits of a fit then differ.
"""

import ctypes
import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDERS = ("{name}.libs", "{name}/.dylibs")  # where the wheels of NumPy and SciPy keep their OpenBLAS, beside or inside
PREFIXES, SUFFIXES = ("scipy_openblas", "openblas"), ("64_", "")  # of its functions, by build


@dataclass(frozen=True)
class BlasThreads:
    """The number of threads of one loaded OpenBLAS."""

    get: Callable[[], int]
    set: Callable[[int], None]


@cache
def loaded() -> tuple[BlasThreads, ...]:
    """Every OpenBLAS that NumPy and SciPy bring; empty where they use another library."""
    paths = [
        path
        for name in ("numpy", "scipy")
        if (spec := importlib.util.find_spec(name)) is not None and spec.origin is not None
        for folder in FOLDERS
        for path in sorted((Path(spec.origin).parents[1] / folder.format(name=name)).glob("*openblas*"))
    ]
    found = [threads_of(path) for path in paths]
    return tuple(one for one in found if one is not None)


def threads_of(path: Path) -> BlasThreads | None:
    """The functions of a library that get and set its threads; None where it has none of them."""
    try:
        library = ctypes.CDLL(str(path))
    except OSError:
        return None
    for prefix in PREFIXES:
        for suffix in SUFFIXES:
            get = getattr(library, f"{prefix}_get_num_threads{suffix}", None)
            put = getattr(library, f"{prefix}_set_num_threads{suffix}", None)
            if get is not None and put is not None:
                get.restype, put.restype, put.argtypes = ctypes.c_int, None, [ctypes.c_int]
                return BlasThreads(get, put)
    return None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Compute with one thread of BLAS in this block; it may stand over a function, too."""
    before = [(one, one.get()) for one in loaded()]
    for one, _ in before:
        one.set(1)
    try:
        yield
    finally:
        for one, threads in before:
            one.set(threads)
