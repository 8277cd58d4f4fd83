"""A picture of the index of all results for the docs, by headless Chromium; docs/pictures/ makes the others.

python -m tests.reports.take_screenshots data docs/screenshots
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tests.reports.browser import Browser


@dataclass(frozen=True)
class Shot:
    """A page below the data folder, and the window it is seen in."""

    page: str
    size: tuple[int, int]
    dark: bool = False


SHOTS = {"index": Shot("index.html", (1200, 1100))}
COLOURS = 128
"""Of a picture: enough for text and lines, and a third of the size."""


def take(data: Path, out: Path) -> list[Path]:
    """Write a picture of each page; their paths."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, shot in SHOTS.items():
        with tempfile.TemporaryDirectory() as folder:
            pixels = Browser(shot.size, shot.dark).picture((data / shot.page).resolve(), Path(folder))
        paths.append(out / f"{name}.png")
        Image.fromarray(pixels.astype(np.uint8)).quantize(COLOURS).save(paths[-1], optimize=True)
        print(f"{paths[-1]}: {paths[-1].stat().st_size / 1e3:.0f} kB")
    return paths


def main(arguments: Sequence[str]) -> None:
    """Take all pictures of a built pipeline; arguments are its data folder and the folder of the pictures."""
    if len(arguments) != 2:
        sys.exit("usage: python -m tests.reports.take_screenshots <data> <folder>")
    take(Path(arguments[0]), Path(arguments[1]))


if __name__ == "__main__":
    main(sys.argv[1:])
