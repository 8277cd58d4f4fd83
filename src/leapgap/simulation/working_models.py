"""Models that effects change: compiled once and lent to one simulation after the other.

A copy of a model takes longer than many a short simulation, and most of one with meshes are the meshes. A working model
gets back only what an effect may have changed.
"""

import ctypes
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache

import mujoco
import numpy as np
from mujoco import MjLogConfig

_lock = threading.Lock()
_before: list[MjLogConfig] = []  # MuJoCo's settings as they were before each of the trials that now run, in any thread


@contextmanager
def without_warnings() -> Iterator[None]:
    """Neither print what MuJoCo warns of nor write it to ``MUJOCO_LOG.TXT``; after the last trial both are as before.

    MuJoCo has one setting for all threads, so warnings of others are not seen meanwhile either. A trial that becomes
    unstable begins anew in MuJoCo's rest position: its motion is finite and far from the log's, and its loss says so.
    """
    with _lock:
        _before.append(MjLogConfig.get())
        if len(_before) == 1:
            quiet = MjLogConfig.get()
            quiet.logto_console = quiet.logto_file = False
            quiet.set()
    try:
        yield
    finally:
        with _lock:
            first = _before[0]
            _before.pop()
            if not _before:
                first.set()


SHAPES = ("bvh_child", "bvh_depth", "bvh_nodeid", "hfield_", "mesh_", "oct_", "skin_", "tex_")
"""Fields of shapes, which no effect may change: writing to them raises ``ValueError``."""
CACHE_LINE = 64  # bytes; MuJoCo's arrays of one model begin at whole numbers of them
MOST_KEPT, MOST_KEPT_BYTES = 256, 512 * 2**20  # of models that are kept: one with meshes has 50 MB and more


class WorkingModel:
    """A compiled model that may be changed, and memory to simulate it."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        arrays = {name: field for name in names_of_fields() if (field := getattr(model, name)).size}
        if model.nmesh and "bvh_aabb" in arrays:  # constants change those of the bodies, which stand first
            arrays["bvh_aabb"] = arrays["bvh_aabb"][: int(model.mesh_bvhadr[0])]
        for name, array in arrays.items():
            if name.startswith(SHAPES):
                array.flags.writeable = False
        self.memory = memory_of([array for array in arrays.values() if array.flags.writeable])
        self.compiled = [part.copy() for part in self.memory]
        self.numbers = [
            (part, name, np.copy(value) if isinstance(value, np.ndarray) else value)
            for part in (model.opt, model.stat)
            for name, value in ((name, getattr(part, name)) for name in dir(part) if not name.startswith("_"))
        ]

    def reset(self) -> None:
        """Make the model as it was compiled."""
        for part, compiled in zip(self.memory, self.compiled, strict=True):
            part[:] = compiled
        for part, name, value in self.numbers:
            setattr(part, name, value)


@cache
def names_of_fields() -> tuple[str, ...]:
    """Names of the fields of a model that are arrays of numbers."""
    model = mujoco.MjSpec().compile()
    return tuple(name for name in dir(model) if isinstance(getattr(model, name), np.ndarray) and name[0] != "_")


def memory_of(arrays: Iterable[np.ndarray]) -> list[np.ndarray]:
    """The memory of arrays as bytes; of those that follow each other, with a gap of a cache line at most, in one."""
    found: list[list[int]] = []
    for begin, size in sorted((array.ctypes.data, array.nbytes) for array in arrays):
        if found and begin - found[-1][1] <= CACHE_LINE:
            found[-1][1] = begin + size
        else:
            found.append([begin, begin + size])
    return [np.ctypeslib.as_array((ctypes.c_uint8 * (end - begin)).from_address(begin)) for begin, end in found]


class WorkingModels:
    """Working models that are not in use, by key, those used last at the end; all threads borrow from the same."""

    def __init__(self) -> None:
        self.changing = threading.Lock()
        self.spare: dict[Hashable, list[WorkingModel]] = {}

    @contextmanager
    def lend(self, key: Hashable, compile_model: Callable[[], mujoco.MjModel]) -> Iterator[WorkingModel]:
        """A working model for the time of the block, as another left it; compiled where none of its key is free."""
        with self.changing:
            free = self.spare.get(key)
            one = free.pop() if free else None
        is_new = one is None
        one = one or WorkingModel(compile_model())
        try:
            yield one
        finally:
            with self.changing:
                self.spare[key] = [*self.spare.pop(key, []), one]
                while is_new and len(self.spare) > 1 and self.is_full:
                    del self.spare[next(iter(self.spare))]

    @property
    def is_full(self) -> bool:
        """Whether more is kept than should be."""
        models = [one.model for free in self.spare.values() for one in free]
        return len(models) > MOST_KEPT or sum(map(mujoco.mj_sizeModel, models)) > MOST_KEPT_BYTES
