"""Signs of life of a long computation: a line where it has said nothing for a minute."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SILENCE_S = 60.0
"""Time without a line after which one is said, and again after each further such time."""


@contextmanager
def still_running(tell: Callable[[str], None], silence_s: float = SILENCE_S) -> Iterator[Callable[[str], None]]:
    """``tell`` that also says how long this block has run, wherever ``silence_s`` pass without a line."""
    began, lock, over = time.monotonic(), threading.Lock(), threading.Event()
    last = began

    def said(line: str) -> None:
        nonlocal last
        with lock:
            last = time.monotonic()
            tell(line)

    def watch() -> None:
        while not over.wait(max(0.01, last + silence_s - time.monotonic())):
            if time.monotonic() - last >= silence_s:
                said(f"still running, {(time.monotonic() - began) / 60:.0f} min so far")

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield said
    finally:
        over.set()
        watcher.join()
