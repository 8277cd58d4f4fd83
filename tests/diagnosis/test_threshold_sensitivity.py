"""Thresholds that watch what they are compared with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.diagnosis.settings import Settings
from tests.benchmarks.sensitivity import Case, Watched, better, changed, flips, thresholds, with_threshold


@pytest.mark.parametrize(
    ("compare", "factor"),
    [
        (lambda threshold: np.float64(3.0) >= threshold, 1.5),
        (lambda threshold: threshold > 1.0, 0.5),
        (lambda threshold: 10.0 - threshold > 5.0, 2.5),
        (lambda threshold: -threshold <= -1.0, 0.5),
        (lambda threshold: np.median([3.0, 9.0]) <= threshold * 4.0, 0.75),
        (lambda threshold: (1 - threshold) * 2.0 < 0.8, 0.3),
    ],
)
def test_a_comparison_ends_otherwise_beyond_the_factor_that_is_kept(compare, factor: float) -> None:
    """Of a threshold of 2: the comparison is made again just below and above the factor."""
    seen: dict[str, list[float]] = {}
    usual = compare(Watched.of("one", seen, 2.0))
    assert seen["one"] == pytest.approx([factor])
    assert usual == compare(2.0)
    assert compare(2.0 * (factor - 1e-6)) != compare(2.0 * (factor + 1e-6))
    for by in (1.5001, 1 / 1.5):
        assert flips(seen["one"], by) == (compare(2.0 * by) != usual)


def test_arrays_are_compared_value_by_value() -> None:
    seen: dict[str, list[float]] = {}
    assert (np.array([1.0, 3.0]) >= Watched.of("one", seen, 2.0)).tolist() == [False, True]
    assert seen["one"] == [0.5, 1.5]


def test_shares_stay_shares() -> None:
    assert changed(20.0, 1.5) == 30 and changed(0.35, 1.5) == pytest.approx(0.525)
    assert changed(0.9, 1.5) == pytest.approx(1 - 0.1 / 1.5)
    assert changed(0.9, 1 / 1.5) == pytest.approx(0.6)


def test_every_threshold_of_the_settings_can_be_changed() -> None:
    settings = Settings()
    names = dict(thresholds(settings))
    assert {"model_error", "joint.least_gain", "joint.enough_closure", "outside.near"} <= set(names)
    for name, value in names.items():
        changed = dict(thresholds(with_threshold(settings, name, 0.9 * value)))
        assert {one for one in names if changed[one] != names[one]} == {name}
    assert replace(with_threshold(settings, "joint.least_gain", 1.0), joint=settings.joint) == settings


def test_an_answer_is_better_by_right_effects_more_and_wrong_ones_fewer() -> None:
    case = Case("case", Path(), Path(), frozenset({"payload", "armature"}))
    right, false, both = frozenset({"payload"}), frozenset({"payload", "wind"}), frozenset({"payload", "armature"})
    assert [better(case, right, after) for after in (right, false, both, frozenset())] == [0, -1, 1, -1]
