"""The module behind ``make hostile``."""

import json
import subprocess
import sys
from pathlib import Path

from tests.code import ROOT
from tests.hostile.run import FIGURES


def test_a_part_writes_its_figures_and_keeps_those_of_the_others(tmp_path: Path) -> None:
    path = tmp_path / "hostile.json"
    path.write_text('{"kills": 7}')
    arguments = ("--parts", "ticks", "--ticks", "14000", "--json", str(path), "--work", str(tmp_path / "work"))
    first, again = (
        subprocess.run(
            [sys.executable, "-m", "tests.hostile.run", *arguments],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for _ in range(2)
    )
    assert "ticks 1 of 1: " in first and "ticks 1 of 1: " not in again, "the second run tries nothing again"
    figures = json.loads(path.read_text())
    assert tuple(figures) == FIGURES
    assert figures["kills"] == 7 and figures["ticks"] >= 14000
    assert (figures["exceptions"], figures["nonfinite"], figures["outside_limits"]) == (0, 0, 0)
    assert figures["inputs"] is None
