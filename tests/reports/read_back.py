"""What a recording holds, read with Rerun's own reader."""

from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader


class Recorded:
    """Chunks of a recording by entity and component."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(str(path))
        self.moving: dict[str, dict[str, tuple[np.ndarray, list]]] = {}
        self.static: dict[str, dict[str, list]] = {}
        for chunk in self.reader.stream():
            batch = chunk.to_record_batch()
            components = [name for name in batch.schema.names if ":" in name]
            if chunk.is_static:
                here = self.static.setdefault(chunk.entity_path, {})
                here |= {name: batch.column(name)[0].as_py() for name in components}
                continue
            seconds = batch.column("time").cast("int64").to_numpy() / 1e9
            there = self.moving.setdefault(chunk.entity_path, {})
            for name in components:
                there[name] = (seconds, batch.column(name).to_pylist())

    def at(self, entity: str, component: str, time_s: float) -> np.ndarray:
        """The row of a component at a time that was logged."""
        seconds, values = self.moving[entity][component]
        (row,) = np.flatnonzero(np.abs(seconds - time_s) < 1e-9)
        return np.array(values[row])

    def first_time(self, entity: str, component: str) -> float:
        """Time of a component's first row, s."""
        return float(self.moving[entity][component][0][0])
