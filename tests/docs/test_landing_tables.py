"""The tables of docs/research/experiments.md hold the figures of landing_full, _kicked and _corrected.json."""

import re

import pytest

from leapgap.runtime.atomic_io import read_json
from stages.draws import single_tasks, tables
from tests.code import ROOT
from tests.docs.tables import cells_of, table_of

PAGE = ROOT / "docs" / "research" / "experiments.md"
FULL = read_json(ROOT / "metrics" / "landing_full.json")
KICKED = read_json(ROOT / "metrics" / "landing_kicked.json")
CORRECTED = read_json(ROOT / "metrics" / "landing_corrected.json")
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
METHODS = {"goal-shift MPC": "learned_goal_mpc", "ours": "ours", "nominal MPC 25/100": "nominal_variable"}


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


def test_landings_by_several_draws_of_practice() -> None:
    """The page names a robot in the first of its rows only."""
    printed = tables(KICKED).split("\n\n")[0].splitlines()[2:]
    robot, told = "", []
    for name, *cells in table_of(PAGE, "| | draws | mean of the five |"):
        robot, _, method = name.rpartition(": ") if ": " in name else (robot, "", name)
        told.append([f"{robot}: {METHODS[method]}", *(cell.replace(" %", "%") for cell in cells)])
    assert told == [cells_of(row) for row in printed]


def test_kinds_of_pushes() -> None:
    """The page tells their amounts, too."""
    by_kind = {(row[0], row[1]): row[2:] for row in map(cells_of, tables(KICKED).split("\n\n")[1].splitlines()[2:])}
    rows = table_of(PAGE, "| | of 18 | goal-shift MPC | `ours` |")
    kinds = {kind for kind, _ in by_kind}
    assert len(rows) == len(kinds)
    for told, of_18, shifted, ours in rows:
        [kind] = [kind for kind in kinds if told.endswith(kind)]
        assert by_kind[kind, "learned_goal_mpc"] == [of_18, shifted]
        assert by_kind[kind, "ours"][1].startswith(f"{ours} (")


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("joint PD", "joint_pd"),
        ("nominal MPC 25/100", "nominal_variable"),
        ("learned MPC of the paper's release", "learned_variable_paper_release"),
    ],
)
def test_landings_of_plans_for_the_corrected_robot(name: str, method: str) -> None:
    rows = {row[0]: row[1:] for row in table_of(PAGE, "| | plans for the nominal robot |")}
    means = CORRECTED["mean_abs_error_cm"]
    assert rows[name] == [f"{means[f'damped/{one}']:.1f}" for one in (method, f"{method}_corrected")]
