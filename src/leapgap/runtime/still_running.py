"""Signs of life of a long computation: how long each of its steps may take, and a line where it says nothing."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SILENCE_S = 60.0
"""Time without a line after which one is said, and again after each further such time."""
STEP = re.compile(r"step (\d+) of (\d+)\b")
"""How a line begins that says which step begins."""


@contextmanager
def still_running(
    tell: Callable[[str], None], silence_s: float = SILENCE_S, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[str], None]]:
    """``tell`` that also says how long this block has run, and how much longer it will at least.

    It says so at each line ``step k of n``, and wherever ``silence_s`` pass without a line. The estimate takes the
    steps that remain to be as long as those before: of a search, they are longer where the logs are hard to explain.
    """
    began, lock, over = clock(), threading.Lock(), threading.Event()
    last, whole = began, 0.0

    def timed(line: str) -> str:
        passed = clock() - began
        more = f", at least {in_words(whole - passed)} more" if passed < whole else ""
        return f"{line}; {in_words(passed)} so far{more}"

    def said(line: str) -> None:
        nonlocal last, whole
        with lock:
            last = clock()
            step = STEP.match(line)
            if step and step[1] != "1":
                whole = (last - began) * int(step[2]) / (int(step[1]) - 1)
                line = timed(line)
            tell(line)

    def watch() -> None:
        while not over.wait(max(0.01, last + silence_s - clock())):
            if clock() - last >= silence_s:
                said(timed("still running"))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield said
    finally:
        over.set()
        watcher.join()


def in_words(time_s: float) -> str:
    """A time as a person says it: ``40 s``, ``3 min``."""
    if time_s < 10:
        return f"{max(1, round(time_s))} s"
    return f"{5 * round(time_s / 5)} s" if time_s < 95 else f"{time_s / 60:.0f} min"
