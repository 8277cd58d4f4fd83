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
    arguments = ("--parts", "ticks", "--ticks", "1400", "--json", str(path))
    subprocess.run([sys.executable, "-m", "tests.hostile.run", *arguments], cwd=ROOT, check=True, capture_output=True)
    figures = json.loads(path.read_text())
    assert tuple(figures) == FIGURES
    assert figures["kills"] == 7 and figures["ticks"] >= 1400
    assert (figures["exceptions"], figures["nonfinite"], figures["outside_limits"]) == (0, 0, 0)
    assert figures["inputs"] is None
