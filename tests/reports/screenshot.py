"""A picture of a recording without a screen: ``python -m tests.reports.screenshot a.rrd a.png --at 0.95``."""

import argparse
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from leapgap.errors import InputError
from leapgap.reports.shown_robot import TIMELINE
from leapgap.runtime.atomic_io import whole_file

TOP_BAR_PX = 36
"""Height of the viewer's menu bar, which is cut off the picture."""
START_LIMIT_S = 40.0
SETTLE_S = 1.5
"""Time for the viewer to lay out and draw the recording; software rendering is slow."""


def screenshot(rrd: Path, png: Path, size: tuple[int, int] = (1500, 900), at_time_s: float | None = None) -> None:
    """Render a recording as it opens in the viewer, with the time cursor at ``at_time_s``.

    Needs a Vulkan driver; without a graphics card Debian's ``mesa-vulkan-drivers`` renders in software.
    ``InputError`` where the viewer cannot render.
    """
    if not rrd.is_file():
        raise InputError(rrd, "no such file", "a recording (.rrd)", "run the stage view first")
    port = free_port()
    command = [
        viewer(), "--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port),
        "--window-size", f"{size[0]}x{size[1] + TOP_BAR_PX}", str(rrd.resolve()),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as output:
        own = {**os.environ, "RERUN_APP_ONLY": "true"}
        process = subprocess.Popen(command, stdout=output, stderr=output, env=own, start_new_session=True)
        try:
            with whole_file(png) as beside:
                picture = beside.with_name(f"{beside.name}.png")  # the viewer goes by the ending
                try:
                    save_picture(port, process, picture.resolve(), at_time_s)
                    with Image.open(picture) as whole:
                        whole.crop((0, TOP_BAR_PX, *whole.size)).save(beside, format="PNG", optimize=True)
                finally:
                    picture.unlink(missing_ok=True)
        except (RuntimeError, OSError) as error:
            output.seek(0)
            last = output.read().decode(errors="replace").strip().splitlines()[-1:] or [str(error)]
            raise InputError(
                rrd,
                f"a viewer that does not render ({last[0].strip()[:200]})",
                "a Vulkan driver",
                "install one: apt-get install mesa-vulkan-drivers renders without a graphics card",
            ) from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)  # the command is a script that starts the viewer
            process.wait()


def save_picture(port: int, process: subprocess.Popen, picture: Path, at_time_s: float | None) -> None:
    """Wait for the viewer, move its time cursor, save the picture; ``RuntimeError`` where that fails."""
    client = connect(port, process)
    time.sleep(SETTLE_S)
    if at_time_s is not None:
        client.set_time(TIMELINE, duration=at_time_s, play_state="paused")
        time.sleep(SETTLE_S)
    client.save_screenshot(str(picture))


def connect(port: int, process: subprocess.Popen) -> ViewerClient:
    """Wait until the viewer answers and return its client."""
    until = time.monotonic() + START_LIMIT_S
    while time.monotonic() < until:
        if process.poll() is not None:
            raise RuntimeError(f"the viewer ended with exit code {process.returncode}")
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        except (RuntimeError, ConnectionError):  # not listening yet
            time.sleep(0.2)
    raise RuntimeError(f"the viewer did not answer within {START_LIMIT_S:g} s")


def viewer() -> str:
    """Path of the command ``rerun`` of this environment."""
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.is_file() else shutil.which("rerun")
    if found is None:
        raise InputError("rerun", "no such command", "the viewer of rerun-sdk", "pip install rerun-sdk")
    return found


def free_port() -> int:
    """A free TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    """Parse the command line and save the screenshot; exit code 2 with one message on bad input."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rrd", type=Path)
    parser.add_argument("png", type=Path)
    parser.add_argument("--at", type=float, default=None, metavar="SECONDS", help="time cursor, s")
    parser.add_argument("--size", type=int, nargs=2, default=(1500, 900), metavar=("WIDTH", "HEIGHT"))
    chosen = parser.parse_args()
    try:
        screenshot(chosen.rrd, chosen.png, tuple(chosen.size), chosen.at)
    except InputError as error:
        print(f"screenshot: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
