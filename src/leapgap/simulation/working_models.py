"""Models that effects change: copies of compiled ones, made once and lent to one simulation after the other.

A copy takes longer than many a short simulation, and most of one with meshes are the meshes. A working model gets back
only what an effect may have changed.
"""

import copy
import threading
from collections.abc import Collection, Hashable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

SHAPES = ("bvh_child", "bvh_depth", "bvh_nodeid", "hfield_", "mesh_", "oct_", "skin_", "tex_")
"""Fields of shapes, which no effect may change: writing to them raises ``ValueError``."""
MOST_KEPT, MOST_KEPT_BYTES = 256, 512 * 2**20
"""Number and size of the models that are kept: a maker's model with meshes has 50 MB and more."""


class WorkingModel:
    """A copy of a compiled model, and memory to simulate it."""

    def __init__(self, compiled: mujoco.MjModel) -> None:
        self.model, self.data = copy.copy(compiled), mujoco.MjData(compiled)
        fields = {name: getattr(self.model, name) for name in dir(self.model)}
        arrays = {name: field for name, field in fields.items() if isinstance(field, np.ndarray) and field.size}
        if self.model.nmesh and "bvh_aabb" in arrays:  # constants change those of the bodies, which stand first
            arrays["bvh_aabb"] = arrays["bvh_aabb"][: int(self.model.mesh_bvhadr[0])]
        for name, array in arrays.items():
            if name.startswith(SHAPES):
                array.flags.writeable = False
        self.arrays = [(array, array.copy()) for array in arrays.values() if array.flags.writeable]
        self.numbers = [
            (part, name, np.copy(value) if isinstance(value, np.ndarray) else value)
            for part in (self.model.opt, self.model.stat)
            for name, value in ((name, getattr(part, name)) for name in dir(part) if not name.startswith("_"))
        ]

    def reset(self) -> None:
        """Make the model as it was compiled."""
        for array, compiled in self.arrays:
            array[...] = compiled
        for part, name, value in self.numbers:
            setattr(part, name, value)


class WorkingModels:
    """Working models that are not in use, the newest last; all threads borrow from the same."""

    def __init__(self) -> None:
        self.changing = threading.Lock()
        self.spare: list[tuple[Hashable, WorkingModel]] = []

    @contextmanager
    def lend(self, key: Hashable, compiled: mujoco.MjModel) -> Iterator[WorkingModel]:
        """A working model as it was compiled, for the time of the block; ``key`` is that of the compiled model."""
        with self.changing:
            at = next((i for i in reversed(range(len(self.spare))) if self.spare[i][0] == key), None)
            one = None if at is None else self.spare.pop(at)[1]
        if one is None:
            one = WorkingModel(compiled)
        else:
            one.reset()
        try:
            yield one
        finally:
            with self.changing:
                self.spare.append((key, one))
                while at is None and are_too_many([each.model for _, each in self.spare]):
                    self.spare.pop(0)


def are_too_many(models: Collection[mujoco.MjModel]) -> bool:
    """Whether so many models are no longer kept."""
    return len(models) > MOST_KEPT or sum(map(mujoco.mj_sizeModel, models)) > MOST_KEPT_BYTES
