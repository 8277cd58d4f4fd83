"""Times of ticks by the wall clock and by that of the thread, and a machine that is busy."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Timings:
    """Times of ticks of one kind."""

    microseconds: list[float] = field(default_factory=list)
    """Wall-clock time of each tick."""
    cpu_microseconds: list[float] = field(default_factory=list)
    """CPU time of this thread in each tick, without other processes."""

    def tick(self, work: Callable[[], object]) -> None:
        """Do it and note how long it took."""
        wall, cpu = time.perf_counter(), time.thread_time()
        work()
        self.cpu_microseconds.append(1e6 * (time.thread_time() - cpu))
        self.microseconds.append(1e6 * (time.perf_counter() - wall))

    def row(self) -> dict[str, float]:
        """Median, p99, p99.9 and worst of all ticks, µs."""
        found = {}
        for name, ticks in (("", self.microseconds), ("cpu_", self.cpu_microseconds)):
            of_ticks = {"median": np.median(ticks), "p99": np.percentile(ticks, 99)}
            of_ticks |= {"p99_9": np.percentile(ticks, 99.9), "worst": max(ticks)}
            found |= {name + k: v for k, v in of_ticks.items()}
        return {name: round(float(value), 1) for name, value in found.items()}


def load() -> float:
    """Mean number of processes of the machine that ran or waited in the last minute, this one among them."""
    return round(os.getloadavg()[0], 2)


@contextlib.contextmanager
def busy_cores() -> Iterator[None]:
    """A process on every core that computes and reads memory without end."""
    work = "import numpy\na = numpy.ones(1 << 21)\nwhile True: a += numpy.tanh(a)"
    running = [subprocess.Popen([sys.executable, "-c", work]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()
