"""The tables of docs/experiments.md on landings hold the figures of landing_full.json and landing_kicked.json."""

import re
from collections.abc import Iterator

import pytest

from leapgap.atomic_io import read_json
from stages.draws import tables
from tests.code import ROOT

PAGE = (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")
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
SINGLE = ["jump_40", "jump_50", "jump_60", "jump_70", "box_60_20"]
OTHERS = ["continuous_60", "block_60", "uneven_60", "push_60", "late_block_60", "crouch_60"]
KICKED = {"goal-shift MPC": "learned_goal_mpc", "ours": "ours", "nominal MPC 25/100": "nominal_variable"}
KINDS = {
    "±0.2 m/s at 0.3 s": "m/s at 0.3 s",
    "±1 rad/s at 0.3 s": "rad/s at 0.3 s",
    "39 to 60 N from 0.3 to 0.4 s": "N from 0.3 to 0.4 s",
    "±0.2 m/s at 0.4 s": "m/s at 0.4 s",
    "±1 rad/s at 0.4 s": "rad/s at 0.4 s",
    "36 to 55 N from 0.4 to 0.5 s": "N from 0.4 to 0.5 s",
}


def rows_below(title: str) -> Iterator[list[str]]:
    """Cells of the rows of the table whose heading row begins so, without emphasis."""
    assert PAGE.count(f"\n{title}") == 1, title
    table = PAGE.split(f"\n{title}")[1].split("\n\n")[0]
    for row in table.splitlines()[2:]:
        yield [cell.strip().replace("**", "").replace("`", "") for cell in row.strip("|").split("|")]


def errors(robot: str, method: str, tasks: list[str]) -> list[str]:
    return [f"{FULL['abs_error_cm'][f'{robot}/{method}/{task}']:.1f}" for task in tasks]


def test_landings_of_every_method_on_worn() -> None:
    rows = list(rows_below("| | 40 | 50 | 60 | 70 cm | box 60, 20 | four in a row |"))
    assert [row[0] for row in rows] == list(WORN)
    for name, *cells in rows:
        mean = FULL["mean_abs_error_cm"][f"worn/{WORN[name]}"]
        assert cells == [*errors("worn", WORN[name], SINGLE + OTHERS), f"{mean:.1f}"], name


@pytest.mark.parametrize(
    ("robot", "title"), [("soft", "`soft`"), ("sticky", "`sticky`"), ("random", "`random`, ten robots")]
)
def test_landings_on_other_robots(robot: str, title: str) -> None:
    rows = list(rows_below(f"| {title} | mean of the five |"))
    assert len(rows) == 6
    for method, mean, *cells in rows:
        assert [cell.removesuffix(", falls") for cell in cells] == errors(robot, method, ["box_60_20", *OTHERS]), method
        key = f"{robot}/{method}"
        digits = len(mean.split(" ")[0].split(".")[1])
        numbers = [FULL["mean_abs_error_cm"][key], *FULL["mean_abs_error_ci95_cm"][key]]
        assert re.findall(r"[\d.]+", mean) == [f"{number:.{digits}f}" for number in numbers], method


def test_landings_by_several_draws_of_practice() -> None:
    """The page names a robot in the first of its rows only, and kinds of pushes in other words."""
    printed = tables(read_json(ROOT / "metrics" / "landing_kicked.json")).replace("`", "")
    by_robot, by_kind = (
        [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[2:]]
        for table in printed.split("\n\n")
    )
    robot, told = "", []
    for name, *cells in rows_below("| | draws | mean of the five |"):
        robot, _, method = name.rpartition(": ") if ": " in name else (robot, "", name)
        told.append([f"{robot}: {KICKED[method]}", *(cell.replace(" %", "%") for cell in cells)])
    assert told == by_robot
    for kind, _, ours_with_mpc, ours in rows_below("| | of 18 | goal-shift MPC | `ours` |"):
        found = {row[1]: row[3] for row in by_kind if row[0] == KINDS[kind]}
        assert found["learned_goal_mpc"] == ours_with_mpc, kind
        assert found["ours"].split(" ")[0] == ours, kind
