"""Pictures of the report of the arm, for the tutorial, by headless Chromium.

    python docs/pictures/report_pages.py docs/pictures

The logs are those of docs/examples/arm_logs.py. Without Chromium the pictures stay as they are.
"""

import runpy
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import leapgap as lg

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
from tests.reports.browser import CHROMIUM, Browser  # noqa: E402

COLOURS = 128
"""Of a picture: enough for text and lines, and a third of the size."""


@dataclass(frozen=True)
class Shot:
    """A window on the report's page, and where in the page it begins: the id of a heading, or the top."""

    size: tuple[int, int]
    at: str = ""
    dark: bool = False


SHOTS = {
    "arm_report": Shot((1100, 760)),
    "arm_channels": Shot((1100, 700), "channels"),
    "arm_report_dark": Shot((1100, 760), dark=True),
    "arm_report_phone": Shot((500, 900)),
}
BEGIN = """<script>addEventListener("load", () => setTimeout(() => {{
  const first = document.getElementById("{}");
  while (first.previousElementSibling) first.previousElementSibling.remove();
}}, 1500))</script>"""
"""Takes away what stands above a heading."""


def main(out: Path) -> None:
    """Diagnose the arm and take all pictures."""
    if CHROMIUM is None:
        print("no Chromium: the pictures of the report stay as they are")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runpy.run_path(str(ROOT / "docs" / "examples" / "arm_logs.py"))["main"](folder)
        lg.diagnose(folder / "logs", folder / "robot.xml").save(folder / "report")
        page = (folder / "report" / "report.html").read_text(encoding="utf-8")
        for stem, shot in SHOTS.items():
            shown = folder / f"{stem}.html"
            begin = BEGIN.format(shot.at) if shot.at else ""
            shown.write_text(page.replace("</body>", f"{begin}</body>"), encoding="utf-8")
            pixels = Browser(shot.size, shot.dark).picture(shown, folder)
            path = out / f"{stem}.png"
            Image.fromarray(pixels.astype(np.uint8)).quantize(COLOURS).save(path, optimize=True)
            print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
