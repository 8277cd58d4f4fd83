"""Ends the workers of a process that was killed; a script of its own, which imports nothing but Python's library.

``python guardian.py <pid>``: its standard input is a pipe that ends when the process of that number does. Workers can
end themselves only once they run a line of ours, for which a busy machine may take minutes. This script waits already.
"""

import contextlib
import os
import signal
import sys
import time
from pathlib import Path

LOOKS, LOOK_S = 20, 0.05  # looks for workers, and the time between two: a worker that is being started shows late


def main() -> None:
    """Wait for the end of the process, then end its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = sys.argv[1].encode()
    while os.read(0, 1):
        pass
    for _ in range(LOOKS):
        # Processes of this user whose environment says that the process ``parent`` started them as workers
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                entries = (path / "environ").read_bytes().split(b"\0")
                if any(entry.startswith(b"LEAPGAP_PARENT=" + parent + b" ") for entry in entries):
                    found.append(int(path.name))
        for pid in found:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(LOOK_S)


if __name__ == "__main__":
    main()
