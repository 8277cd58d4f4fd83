"""MuJoCo's own log while motions are tried out: an effect much too large makes a motion unstable, and is no news."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mujoco import MjLogConfig

_lock = threading.Lock()
_before: list[MjLogConfig] = []
"""MuJoCo's settings as they were before each of the trials that now run, in any thread."""


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
