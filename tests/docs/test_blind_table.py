"""The tables of docs/research/blind.md and the counts of README.md hold the figures of the metrics."""

import re

import pytest

from leapgap.runtime.atomic_io import read_json
from tests.code import ROOT
from tests.docs.tables import table_of

BLIND = read_json(ROOT / "metrics" / "blind.json")
ROBOTS = read_json(ROOT / "metrics" / "real" / "robots.json")
FOUND = {row[0]: row[1:] for row in table_of(ROOT / "docs" / "research" / "blind.md", "| found | A1 |")}
README = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
# The beginning of a row, the metric, how many of its units are one.
ROWS = [
    ("cases (seed)", "cases", 1),
    ("of these detectable", "detectable", 1),
    ("named first, of detectable single effects", "named_first", 100),
    ("a wrong named, of all cases", "wrongly_named", 100),
    ("both of a pair, where both show", "pairs_both_named", 100),
    ("members of a triple, of those detectable", "triples_members_named", 100),
    ("unknown or partly, of detectable unmodelled effects", "unknown_recall", 100),
    ("none, of robots with nothing wrong", "none_correct", 100),
    ("overlap of the map", "where_overlap", 1),
    ("median parameter error", "parameter_error_median", 100),
    ("95 % intervals that hold the truth", "coverage", 100),
]
INJECTED = [
    ("single effects named first", "injected_named_first", 100),
    ("single effects named, and nothing beside", "injected_named_alone", 100),
    ("places named rightly", "locations_right", 100),
    ("both of a pair named", "pairs_both_named", 100),
    ("nothing wrong", "none_correct", 100),
    ("median parameter error", "injected_parameter_error_median", 100),
    ("95 % intervals that hold the truth", "injected_coverage", 100),
    ("mean difference of predicted and actual reduction", "closure_promise_error", 1),
]
COLUMNS = {"a1": 0, "ur5e": 1}
COUNTS = ("none", "one", "two", "three")
SINGLES = r"the right cause first in (\d+) of (\d+) detectable single faults"
VERDICTS = {
    row[0]: row[1] for row in table_of(ROOT / "docs" / "explanation" / "verdicts.md", "| | A1 jumps, 150 cases |")
}


def assert_begins_with(cell: str, value: float) -> None:
    """A cell begins with a value, as rounded as it stands there."""
    found = re.match(r"\d+(?:\.(\d+))?", cell)
    assert found, cell
    assert found[0] == f"{value:.{len(found[1] or '')}f}"


@pytest.mark.parametrize("robot", COLUMNS)
@pytest.mark.parametrize(("beginning", "metric", "units"), ROWS)
def test_scores(robot: str, beginning: str, metric: str, units: int) -> None:
    [row] = [cells for name, cells in FOUND.items() if name.startswith(beginning)]
    cell, value = row[COLUMNS[robot]], BLIND[robot][metric]
    if value is None:
        assert cell == "none drawn"
        return
    assert_begins_with(cell, units * value)


@pytest.mark.parametrize(("beginning", "metric", "units"), INJECTED)
def test_injected_causes(beginning: str, metric: str, units: int) -> None:
    metrics = read_json(ROOT / "metrics" / "diagnosis.json")
    rows = dict(table_of(ROOT / "docs" / "research" / "blind.md", f"| found | {metrics['cases']} cases |"))
    [cell] = [cell for name, cell in rows.items() if name.startswith(beginning)]
    assert_begins_with(cell, units * metrics[metric])


def test_counts_of_the_front_page() -> None:
    found = re.search(SINGLES, README)
    assert found
    first, singles = map(int, found.groups())
    assert first / singles == pytest.approx(BLIND["named_first"], abs=1e-5)
    for share, text in (
        ("wrongly_named", "a wrong name in {:.1f} % of 150 cases"),
        ("parameter_error_median", "median parameter error {:.1f} %"),
        ("coverage", "{:.0f} % of the 95 % intervals contain the true value"),
    ):
        assert text.format(100 * BLIND[share]) in README


@pytest.mark.parametrize(
    ("row", "metric"),
    [
        ("right cause first, of detectable single causes", "named_first"),
        ("both of a pair, where both are detectable", "pairs_both_named"),
        ("members of a triple, of those detectable", "triples_members_named"),
        ("none where nothing is wrong", "none_correct"),
        ("unknown or partly where the cause is not in the list", "unknown_recall"),
    ],
)
def test_counts_of_the_page_on_verdicts(row: str, metric: str) -> None:
    count, of = map(int, VERDICTS[row].split(" of "))
    assert count / of == pytest.approx(BLIND[metric], abs=1e-5)


def test_real_robots_of_the_front_page() -> None:
    judged = [case["right"] for case in ROBOTS["cases"].values() if case["right"] is not None]
    wrong = sum(case["false_name"] for case in ROBOTS["cases"].values())
    assert f"{sum(judged)} of {len(judged)} right, {COUNTS[wrong]} with a false name" in README
