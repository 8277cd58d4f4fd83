"""The tables of docs/research/paper.md hold the figures of metrics/landing_paper.json."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import t as student

from leapgap.runtime.atomic_io import read_json
from tests.code import ROOT
from tests.docs.tables import cells_of, table_of

PAGE = ROOT / "docs" / "research" / "paper.md"
ROBOTS = read_json(ROOT / "metrics" / "landing_paper.json")["robots"]
SINGLE = ("jump_40", "jump_50", "jump_60", "jump_70", "box_60_20")
METHODS = ("nominal_variable", "plan_variable", "learned_fixed", "learned_variable")
GOAL = "learned_variable_to_goal"
SEEN = ("push_60", "box_60_20", "continuous_60", "block_60", "uneven_60", "crouch_60")
LATE = "late_block_60"


def mean_of(draw: Mapping[str, Any]) -> float:
    """Of the five targets, cm."""
    return float(np.mean([draw["abs_error_cm"][task] for task in SINGLE]))


def margin(values: np.ndarray) -> float:
    """Half of the 95 % interval of the mean of some draws."""
    return float(student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))


def of_practice() -> list[list[str]]:
    """Rows of the first table: means over draws of practice."""
    rows = []
    for robot, methods in sorted(ROBOTS.items()):
        errors = {name: {seed: mean_of(draw) for seed, draw in methods[name].items()} for name in METHODS}
        nominal, plain, _, learned = ({*errors[name]} for name in METHODS)
        assert nominal == plain == learned
        means = [np.mean([*errors[name].values()]) for name in METHODS]
        pairs = np.array([fixed - errors["learned_variable"][seed] for seed, fixed in errors["learned_fixed"].items()])
        draws = [*methods["learned_variable"].values()]
        own = ", ".join(f"{one:.1f}" for _, one in sorted(errors["learned_variable"].items()))
        ground = np.mean([draw["abs_error_cm"][task] for draw in draws for task in SINGLE[:4]])
        stand = np.mean([draw["success"][task] for draw in draws for task in SINGLE])
        cells = [*(f"{one:.2f}" for one in means[:3]), f"**{means[3]:.2f}** ({own})", f"{means[0] / means[3]:.1f}"]
        apart = f"{pairs.mean():.1f} ± {margin(pairs):.1f}"
        rows.append([f"`{robot}`", str(len(draws)), *cells, apart, f"{ground:.2f}", f"{stand:.0%}"])
    return rows


def with_goals() -> list[list[str]]:
    """Rows of the second table: means over draws of practice; pitch and standing are of all but the unseen block."""
    rows = []
    for robot, methods in sorted(ROBOTS.items()):
        draws = [draw for _, draw in sorted(methods.get(GOAL, {}).items())]
        if not draws:
            continue
        errors = [[draw["abs_error_cm"][task] for draw in draws] for task in (*SEEN, LATE)]
        cells = [f"{np.mean(of_task):.1f}" for of_task in ([mean_of(draw) for draw in draws], *errors)]
        if len(draws) > 1:
            cells[1] += f" ({', '.join(f'{one:.1f}' for one in errors[0])})"
        stand = np.mean([draw["success"][task] for draw in draws for task in (*SINGLE[:4], *SEEN)])
        pitch = max(draw["worst_pitch_deg"][task] for draw in draws for task in (*SINGLE[:4], *SEEN))
        rows.append([f"`{robot}`", str(len(draws)), *cells, f"{pitch:.0f}°", f"{stand:.0%}"])
    return rows


def without_marks(rows: list[list[str]]) -> list[list[str]]:
    """As ``table_of`` reads them."""
    return [cells_of(" | ".join(row)) for row in rows]


def test_landings_by_draws_of_practice() -> None:
    assert table_of(PAGE, "| robot | draws | nominal MPC") == without_marks(of_practice())


def test_landings_where_the_goal_was_chosen_first() -> None:
    assert table_of(PAGE, "| robot | draws | five |") == without_marks(with_goals())
