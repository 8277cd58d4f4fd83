"""Processes that end in time: workers together with the process that started them, and a command on Ctrl-C."""

import contextlib
import ctypes
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from leapgap.atomic_io import TEMPORARY

POLL_S = 1.0
"""Time between two looks of a worker at its parent."""
UNWIND_S = 1.5
"""Time that a command has after Ctrl-C to end in order; then it is ended."""
STOPPED = 130
"""Exit code of a command that Ctrl-C ended."""
SET_DEATH_SIGNAL = 1
"""``PR_SET_PDEATHSIG`` of ``prctl``."""


@contextmanager
def starting_workers() -> Iterator[tuple[Callable[..., None], tuple[int, bool]]]:
    """Start worker processes in this block, with the initialiser and its arguments that it yields.

    Workers inherit that Ctrl-C is blocked, so that they print nothing before their initialiser has run.
    """
    is_main = threading.current_thread() is threading.main_thread()
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield end_with_parent, (os.getpid(), is_main)
    finally:
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


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


class InterruptGuard:
    """On Ctrl-C one line and the end of this process: in order where that is quick, at once after ``UNWIND_S``.

    A library may catch ``KeyboardInterrupt`` for reasons of its own, wait for its workers, or be in a long computation;
    so a thread ends the process in any case. Standard error is shut in between, against tracebacks of libraries.
    """

    def __init__(self, line: Callable[[], str]) -> None:
        """``line`` returns what is printed."""
        self.line = line
        self.interrupted = False
        self._errors = 2
        self._ended, self._silent = threading.Lock(), threading.Lock()

    def install(self) -> None:
        """Handle Ctrl-C from now on, unless this process ignores it (as one in the background of a script does)."""
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            return
        heard, told = os.pipe()
        os.set_blocking(told, False)
        signal.set_wakeup_fd(told, warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, self._handle)
        sys.excepthook = self._except
        threading.Thread(target=self._watch, args=(heard,), daemon=True).start()

    def end(self) -> NoReturn:
        """Remove what is temporary, print the line, and end this process; its workers end with it."""
        self._ended.acquire()  # for good: one thread does this once
        for path in list(TEMPORARY):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    path.unlink()
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
        with contextlib.suppress(OSError):
            os.write(self._errors, f"{self.line()}\n".encode())
        os._exit(STOPPED)

    def _handle(self, *_: Any) -> None:
        if not self.interrupted:
            self._silence()
            raise KeyboardInterrupt

    def _except(self, *error: Any) -> None:
        if self.interrupted:
            self.end()
        sys.__excepthook__(*error)

    def _silence(self) -> None:
        """Shut standard error once, and keep it for the line."""
        with self._silent:
            if not self.interrupted:
                self._errors = os.dup(2)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
                self.interrupted = True

    def _watch(self, heard: int) -> None:
        """Wait for Ctrl-C, which the interpreter tells here even where its main thread is in a computation."""
        while signal.SIGINT not in os.read(heard, 64):
            pass
        time.sleep(UNWIND_S)
        self._silence()
        self.end()
