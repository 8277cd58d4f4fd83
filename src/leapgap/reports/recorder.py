"""A Rerun recording that is written whole or not at all, on one timeline in seconds."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from leapgap.runtime.atomic_io import whole_file

TIMELINE = "time"


class Recorder:
    """An open recording; every entity is either static or a set of columns over ``TIMELINE``."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self.stream = stream

    def static(self, entity: str, *what: rr.AsComponents) -> None:
        """Log what holds at all times."""
        self.stream.log(entity, *what, static=True)

    def over_time(self, entity: str, time_s: np.ndarray, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Log one row for each time, s, of an entity in a single call."""
        flat = [column for some in columns for column in some]
        self.stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=time_s)], flat)


@contextmanager
def recording(path: Path, title: str, blueprint: rrb.Blueprint) -> Iterator[Recorder]:
    """Open a recording that opens in the viewer with ``blueprint``.

    The viewer keeps one blueprint per application name, so the title is part of it: recordings opened
    together keep their own cameras and plots.
    """
    with whole_file(path) as beside:
        stream = rr.RecordingStream(f"leapgap {title}".replace(".", "-"))  # Rerun warns of names with a dot
        try:
            stream.save(beside, default_blueprint=blueprint)
            stream.send_recording_name(title)
            yield Recorder(stream)
            stream.flush()
        finally:
            stream.disconnect()


def rows_at_period(time_s: np.ndarray, period_s: float) -> np.ndarray:
    """Indices of about one row per ``period_s``, always with the first and the last row."""
    tick = np.floor((time_s - time_s[0]) / period_s + 1e-6).astype(int)
    keep = np.flatnonzero(np.diff(tick, prepend=-1) > 0)
    return np.union1d(keep, [len(time_s) - 1])
