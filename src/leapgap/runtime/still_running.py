"""Signs of life of a long computation: how long each of its steps may take, and a line where it says nothing."""

import math
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

SILENCE_S = 60.0
"""Time without a line after which one is said, and again after each further such time."""
STEP = re.compile(r"step (\d+) of (\d+)\b")
"""How a line begins that says which step begins."""
Begins = Mapping[int, tuple[float, float]]
"""Least and largest share of the whole time that has passed when a step begins, by its number."""


@contextmanager
def still_running(
    tell: Callable[[str], None],
    begins: Begins | None = None,
    silence_s: float = SILENCE_S,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Callable[[str], None]]:
    """``tell`` that also says how long this block has run, and about how much longer it will.

    It says so at each line ``step k of n``, and wherever ``silence_s`` pass without a line. The estimate is the time
    that has passed, divided by the share of the whole that ``begins`` has for the step; there is none for a step that
    it has not. Without ``begins``, steps are equally long.
    """
    began, lock, over = clock(), threading.Lock(), threading.Event()
    last, shortest, longest = began, 0.0, 0.0

    def timed(line: str) -> str:
        passed = clock() - began
        more = remaining(shortest - passed, longest - passed)
        return f"{line}; {in_words(passed)} so far{more}"

    def said(line: str) -> None:
        nonlocal last, shortest, longest
        with lock:
            last = clock()
            step = STEP.match(line)
            if step and step[1] != "1":
                k, steps = int(step[1]), int(step[2])
                equal = (k - 1) / steps
                least, most = (equal, equal) if begins is None else begins.get(k, (math.inf, math.inf))
                shortest, longest = (last - began) / most, (last - began) / least
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


def remaining(least_s: float, most_s: float) -> str:
    """Words for the time that remains; none where more has passed than was expected."""
    if most_s <= 0:
        return ""
    least, most = in_words(least_s), in_words(most_s)
    if least_s <= 0:
        return f", up to {most} more"
    return f", about {most} more" if least == most else f", about {least} to {most} more"


def in_words(time_s: float) -> str:
    """A time as a person says it: ``40 s``, ``3 min``."""
    if time_s < 10:
        return f"{max(1, round(time_s))} s"
    return f"{5 * round(time_s / 5)} s" if time_s < 95 else f"{time_s / 60:.0f} min"
