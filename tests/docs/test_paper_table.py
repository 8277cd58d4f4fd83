"""The table of docs/research/paper.md holds the figures of metrics/landing_paper.json."""

import numpy as np

from leapgap.runtime.atomic_io import read_json
from tests.code import ROOT
from tests.docs.tables import table_of

ROBOTS = read_json(ROOT / "metrics" / "landing_paper.json")["robots"]
SINGLE = ("jump_40", "jump_50", "jump_60", "jump_70", "box_60_20")
METHODS = ("nominal_variable", "plan_variable", "learned_fixed", "learned_variable")


def test_landings_by_draw_of_practice() -> None:
    rows, told = table_of(ROOT / "docs" / "research" / "paper.md", "| robot | draw |"), []
    for robot, methods in ROBOTS.items():
        for seed, learned in methods["learned_variable"].items():
            errors = {
                name: np.mean([methods[name][seed]["abs_error_cm"][task] for task in SINGLE])
                for name in METHODS
                if seed in methods.get(name, {})
            }
            landed = [learned["abs_error_cm"][task] for task in SINGLE]
            ratio = errors["nominal_variable"] / errors["learned_variable"]
            cells = [f"{errors[name]:.2f}" if name in errors else "" for name in METHODS]
            flat = f"{np.mean(landed[:4]):.2f}"
            stand = np.mean([learned["success"][task] for task in SINGLE])
            told.append([robot, seed.removeprefix("seed_"), *cells, f"{ratio:.1f}", flat, f"{stand:.0%}"])
    assert rows == told
