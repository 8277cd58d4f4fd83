"""Processes that end in time: workers together with the process that started them, and a command on Ctrl-C.

And what else a command needs of its process: printing to any terminal.
"""

import contextlib
import ctypes
import io
import math
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from leapgap.runtime.atomic_io import TEMPORARY
from leapgap.runtime.interrupt import STOPPED, end_at_once

POLL_S = 1.0  # time between two looks of a worker at its parent
WAIT_S = 0.5  # time that the main thread has after Ctrl-C to end its process itself
TRACKER_ADVICE = "ignore:resource_tracker"  # of Python's helper, which clears semaphores of workers that were ended
PARENT = "LEAPGAP_PARENT"  # variable that tells a worker which process started it, and whether by its main thread
SET_DEATH_SIGNAL = 1  # ``PR_SET_PDEATHSIG`` of ``prctl``
GUARDED: dict[int, int] = {}  # process with a guardian → its end of the pipe whose end the guardian awaits


@contextmanager
def starting_workers() -> Iterator[tuple[Callable[..., None], tuple[int, bool]]]:
    """Start worker processes in this block, with the initialiser and its arguments that it yields.

    Workers inherit that Ctrl-C is ignored, so that they print nothing before their initialiser has run. (A mask of
    signals would not do: Python's tracker of shared memory removes it when it is started.)
    """
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if is_main else None
    filters = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), TRACKER_ADVICE)))
    start_guardian()
    given = {"PYTHONWARNINGS": filters, PARENT: f"{os.getpid()} {int(is_main)}"}
    before = {name: os.environ.get(name) for name in given}
    os.environ.update(given)
    try:
        yield end_with_parent, (os.getpid(), is_main)
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if handler is not None:
            signal.signal(signal.SIGINT, handler)


def start_guardian() -> None:
    """Start the process that ends the workers of this one if it is killed, once; on Linux, which lists processes."""
    if sys.platform != "linux" or not sys.executable or os.getpid() in GUARDED:
        return
    ends, held = os.pipe()
    script = str(Path(__file__).with_name("guardian.py"))
    nowhere = ((os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2))
    try:
        os.posix_spawn(
            sys.executable,
            [sys.executable, "-I", "-S", script, str(os.getpid())],
            {name: value for name, value in os.environ.items() if name != PARENT},
            file_actions=[(os.POSIX_SPAWN_DUP2, ends, 0), *nowhere],
        )
    except OSError:  # no process to be had: workers still end by themselves
        os.close(held)
        return
    finally:
        os.close(ends)
    GUARDED[os.getpid()] = held


def end_with_parent_early() -> None:
    """As ``end_with_parent``, for a worker that still imports the module of a stage and has no initialiser yet."""
    parent, _, by_main_thread = os.environ.get(PARENT, "").partition(" ")
    if parent:
        end_with_parent(int(parent), by_main_thread == "1")


def end_with_parent(parent: int, by_main_thread: bool = True) -> None:
    """Initialise a worker: it ends when its parent does, and leaves Ctrl-C to it.

    On Linux the kernel kills it when the thread ends that started it, so only one that lives as long as its process may
    (``by_main_thread``). Everywhere a thread of the worker looks at its parent once a second.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux" and by_main_thread:
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(STOPPED)
    threading.Thread(target=watch_parent, args=(parent,), daemon=True).start()


def watch_parent(parent: int) -> None:
    """End this process when its parent is another one than at its start."""
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os._exit(STOPPED)


def open_closed_streams() -> None:
    """Give a process whose output or error stream is closed one that leads nowhere.

    Python has None in the place of such a stream. The descriptors are taken, too: the next file that is opened would
    get the number of a closed stream, and messages would be written into it.
    """
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, "w", closefd=False))


def tolerate_terminal() -> None:
    """Print a character that the terminal cannot show as its code, such as ``\\xb7``, and go on."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class InterruptGuard:
    """Ends this process on Ctrl-C, with its workers, and says so in one line.

    No exception is raised: libraries catch ``KeyboardInterrupt`` for reasons of their own, print tracebacks or wait for
    their workers. What is temporary is removed here instead. A thread does this where the main one is in a computation.
    """

    def __init__(self, line: Callable[[], str]) -> None:
        """``line`` returns what is printed."""
        self.line = line
        self._ended = threading.Lock()

    def install(self) -> None:
        """Handle Ctrl-C from now on, unless this process ignores it (as one in the background of a script does)."""
        if signal.getsignal(signal.SIGINT) not in (signal.default_int_handler, end_at_once):
            return
        heard, told = os.pipe()
        os.set_blocking(told, False)
        signal.set_wakeup_fd(told, warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, lambda *_: self.end())
        threading.Thread(target=self._watch, args=(heard,), daemon=True).start()

    def end(self) -> None:
        """End the workers, remove what is temporary, print the line, and end this process."""
        if not self._ended.acquire(blocking=False):
            return  # another thread is at it
        line = self.line()
        # End the processes that this one has started, where they can be listed; the tracker of shared memory stays
        for listed in Path("/proc/self/task").glob("*/children"):
            for pid in map(int, listed.read_text().split()):
                with contextlib.suppress(OSError):
                    if b"resource_tracker" not in Path(f"/proc/{pid}/cmdline").read_bytes():
                        os.kill(pid, signal.SIGKILL)
        with contextlib.suppress(OSError, ValueError, RuntimeError):  # of one who prints at this moment
            sys.stdout.flush()
        for path in list(TEMPORARY):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    path.unlink()
        with contextlib.suppress(OSError):
            os.write(2, f"{line}\n".encode())
        os._exit(STOPPED)

    def _watch(self, heard: int) -> None:
        """Wait for Ctrl-C, which the interpreter tells here even where its main thread is in a computation."""
        while signal.SIGINT not in os.read(heard, 64):
            pass
        time.sleep(WAIT_S)
        self.end()


SILENCE_S = 60.0  # time without a line after which one is said, and again after each further such time
STEP = re.compile(r"step (\d+) of (\d+)\b")  # how a line begins that says which step begins
Begins = Mapping[int, tuple[float, float]]  # number of a step → least and largest share of the time when it begins


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
