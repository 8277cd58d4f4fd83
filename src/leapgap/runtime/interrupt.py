"""Ctrl-C in the first moments of a command, while it imports.

This file is imported first, so it imports next to nothing. Later ``processes.InterruptGuard`` takes over.
"""

import os
import signal

STOPPED = 130  # exit code of a command that Ctrl-C ended


def hear_early() -> None:
    """End this process on Ctrl-C from now on, unless it ignores it (as one in the background of a script does)."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, end_at_once)


def end_at_once(*_: object) -> None:
    """Print one line and end this process, which has done nothing yet."""
    os.write(2, b"leapgap: stopped by Ctrl-C; nothing was written\n")
    os._exit(STOPPED)
