"""The module behind ``make hostile``."""

import json
from pathlib import Path

import numpy as np

from tests.code import ROOT
from tests.commands import python
from tests.hostile.kills import AT_ONCE, CALLS, stage_and_moments
from tests.hostile.run import FIGURES


def test_a_part_writes_its_figures_and_keeps_those_of_the_others(tmp_path: Path) -> None:
    path = tmp_path / "hostile.json"
    path.write_text('{"kills": 7}')
    arguments = ("--parts", "ticks", "--ticks", "14000", "--json", str(path), "--work", str(tmp_path / "work"))
    first, again = (python("-m", "tests.hostile.run", *arguments) for _ in range(2))
    assert (first.returncode, again.returncode) == (0, 0), first.stderr + again.stderr
    assert "ticks 1 of 1: " in first.stdout
    assert "ticks 1 of 1: " not in again.stdout, "the second run tries nothing again"
    figures = json.loads(path.read_text())
    assert tuple(figures) == FIGURES
    assert figures["kills"] == 7 and figures["ticks"] >= 14000
    assert (figures["exceptions"], figures["nonfinite"], figures["outside_limits"]) == (0, 0, 0)
    assert figures["inputs"] is None


def test_every_stage_with_workers_is_killed_at_moments_spread_over_its_work() -> None:
    stages = (ROOT / "stages").glob("*.py")
    with_workers = {path.stem for path in stages if "config.executor" in path.read_text(encoding="utf-8")} | {"train"}
    with_workers -= {"bench"}  # its rows hold times, so that no two runs are equal
    assert {call.name for call in CALLS} == with_workers
    kills = [
        (name, share) for number in range(100 // AT_ONCE) for name, all in [stage_and_moments(number)] for share in all
    ]
    for stage in with_workers:
        edges = [0.0, *sorted(share for name, share in kills if name == stage), 1.0]
        assert len(edges) > 10 and max(np.diff(edges)) < 2.2 / (len(edges) - 2)
