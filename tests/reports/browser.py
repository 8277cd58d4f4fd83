"""A page in headless Chromium: what its scripts made of it, and a picture of it."""

import json
import os
import shutil
import signal
import subprocess
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from queue import Queue
from threading import Thread

import numpy as np
import pytest
from PIL import Image

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
PHONE, DESKTOP = (500, 900), (1200, 900)
"""Widths and heights, pixels; headless Chromium opens no window narrower than 500."""


@dataclass(frozen=True)
class Browser:
    """A window of a width and height in pixels, on a light or dark system."""

    size: tuple[int, int]
    dark: bool = False
    software_gl: bool = False

    def command(self, page: Path, *arguments: str) -> list[str]:
        """Chromium with a page; names of other machines do not resolve in it."""
        graphics = ["--disable-gpu"]
        if self.software_gl:
            graphics = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        assert CHROMIUM is not None
        command = [CHROMIUM, "--headless=new", "--no-sandbox", "--hide-scrollbars", *graphics]
        command += [f"--window-size={self.size[0]},{self.size[1]}"]
        command += ["--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
        command += ["--blink-settings=preferredColorScheme=0"] if self.dark else []
        return [*command, *arguments, page.as_uri()]

    def evaluate(self, page: Path, script: str, folder: Path, seconds: float = 90) -> dict:
        """What an expression of JavaScript is once the page is drawn; it must be an object, and may be a promise's."""
        heard: Queue[str] = Queue()

        class Listener(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                heard.put(self.rfile.read(int(self.headers["Content-Length"])).decode())
                self.send_response(204)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        server = HTTPServer(("127.0.0.1", 0), Listener)
        asks = f"""<script>(async () => {{
          const tell = (what) => fetch("http://127.0.0.1:{server.server_port}/", {{method: "POST", mode: "no-cors",
            body: JSON.stringify(what)}});
          try {{ await leapgap.ready; await new Promise((go) => setTimeout(go, 500)); tell(await ({script})); }}
          catch (error) {{ tell({{ error: String(error) }}); }} }})();</script></body>"""
        asked = folder / "asked.html"
        before, _, after = page.read_text(encoding="utf-8").rpartition("</body>")
        asked.write_text(f"{before}{asks}{after}", encoding="utf-8")
        Thread(target=server.serve_forever, daemon=True).start()
        profile = f"--user-data-dir={folder / 'profile'}"
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(self.command(asked, profile), start_new_session=True, **silent) as chromium:  # type: ignore[call-overload]
            try:
                return dict(json.loads(heard.get(timeout=seconds)))
            finally:
                os.killpg(chromium.pid, signal.SIGKILL)
                server.shutdown()
                server.server_close()

    def picture(self, page: Path, folder: Path) -> np.ndarray:
        """Pixels of the window, (height, width, 3), 0 to 255."""
        taken = self.command(page, "--virtual-time-budget=20000", f"--screenshot={folder / 'page.png'}")
        subprocess.run(taken, capture_output=True, timeout=150)
        with Image.open(folder / "page.png") as image:
            return np.asarray(image.convert("RGB"), dtype=int)
