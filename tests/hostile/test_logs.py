"""A part of the corrupted logs in every run of the tests; ``make hostile`` has all of them."""

import pytest

from tests.hostile.base_logs import FORMATS
from tests.hostile.logs import Case, Result, cases, figures, report, run_cases
from tests.hostile.other_files import OTHER_FILES

SHARE = 11
"""One case of so many is run here; it has no factor in common with the lengths of the lists."""


@pytest.fixture(scope="module")
def results() -> list[Result]:
    return run_cases(cases()[::SHARE], 1)


@pytest.mark.long
def test_no_corrupted_log_is_a_traceback_a_hang_or_too_much_memory(results: list[Result]) -> None:
    counts = figures(results)
    assert counts["traceback"] == counts["hang"] == counts["memory"] == counts["control"] == 0, report(results)
    assert counts["inputs"] > 200
    assert {one.case.format for one in results} == {*(layout.name for layout in FORMATS), *OTHER_FILES}


def test_nonsense_is_accepted_once_in_a_hundred_at_most(results: list[Result]) -> None:
    assert figures(results)["accepted_nonsense"] <= 0.02 * len(results), report(results)  # two of 145, one of all 1585


def test_whole_logs_are_not_set_aside(results: list[Result]) -> None:
    assert not [one for one in results if "whole log" in one.says]


NAMED = (
    ("csv", "columns", "degrees_positions", "degrees for radians?"),
    ("csv", "columns", "rows_shuffled", "sort the rows"),
    ("csv_base", "columns", "xyzw", "x y z w"),
    ("csv", "columns", "rows_twice", "twice"),
    ("csv", "columns", "rows_lost_renumbered", "rows were lost here"),
    ("csv", "file", "pipe", "a named pipe"),
    ("npz", "file", "endless_device", "a device"),
    ("own", "file", "one_bit", ""),
    ("own", "file", "socket", "a socket"),
    ("own", "file", "folder", "a folder"),
    ("own", "special", "own_giant", "values; expected at most"),
    ("own", "metadata", "deep", "nested too deep"),
    ("own", "metadata", "period_true", "sample_period_s: found true"),
    ("own", "metadata", "robot_other", "robot go1"),
    ("hdf5", "special", "hdf5_empty_giant", "values; expected at most"),
    ("pt", "special", "pt_system", "os.system in the pickle"),
)
"""Format, harm, its name, and words of the reason."""


def test_a_bad_log_among_good_ones_is_set_aside_in_words() -> None:
    found = run_cases([Case(0, *each[:3]) for each in NAMED], 1)
    wrong = [
        one for one, each in zip(found, NAMED, strict=True) if one.outcome != "set_aside" or each[3] not in one.says
    ]
    assert not wrong
