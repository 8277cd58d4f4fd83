"""The tables of docs/experiments.md on landings hold the figures of landing_full.json."""

import re

import pytest

from leapgap.atomic_io import read_json
from stages.draws import single_tasks
from tests.code import ROOT
from tests.docs.tables import table_of

PAGE = ROOT / "docs" / "experiments.md"
FULL = read_json(ROOT / "metrics" / "landing_full.json")
WORN = {
    "joint PD on the plan": "joint_pd",
    "the same, target shifted by the best constant": "joint_pd_shifted",
    "nominal MPC, 25/100 ms": "nominal_variable",
    "learned MPC of the paper, 25/100 ms": "learned_variable",
    "learned MPC, fixed 25 ms": "learned_fixed",
    "ours": "ours",
    "ours, four jumps to adapt to each task": "ours_adapted",
    "goal-shift MPC": "learned_goal_mpc",
}
OTHERS = ["continuous_60", "block_60", "uneven_60", "push_60", "late_block_60", "crouch_60"]


def errors(robot: str, method: str, tasks: list[str]) -> list[str]:
    return [f"{FULL['abs_error_cm'][f'{robot}/{method}/{task}']:.1f}" for task in tasks]


def test_landings_of_every_method_on_worn() -> None:
    rows = table_of(PAGE, "| | 40 | 50 | 60 | 70 cm | box 60, 20 | four in a row |")
    assert [row[0] for row in rows] == list(WORN)
    for name, *cells in rows:
        mean = FULL["mean_abs_error_cm"][f"worn/{WORN[name]}"]
        assert cells == [*errors("worn", WORN[name], single_tasks() + OTHERS), f"{mean:.1f}"], name


@pytest.mark.parametrize(
    ("robot", "title"), [("soft", "`soft`"), ("sticky", "`sticky`"), ("random", "`random`, ten robots")]
)
def test_landings_on_other_robots(robot: str, title: str) -> None:
    rows = table_of(PAGE, f"| {title} | mean of the five |")
    assert len(rows) == 6
    for method, mean, *cells in rows:
        assert [cell.removesuffix(", falls") for cell in cells] == errors(robot, method, ["box_60_20", *OTHERS]), method
        key = f"{robot}/{method}"
        digits = len(mean.split(" ")[0].split(".")[1])
        numbers = [FULL["mean_abs_error_cm"][key], *FULL["mean_abs_error_ci95_cm"][key]]
        assert re.findall(r"[\d.]+", mean) == [f"{number:.{digits}f}" for number in numbers], method
