"""Landing figures by hand."""

import numpy as np
import pytest

from leapgap.jumping.experiments.landing_experiment import ScoredRun, mean_over_tasks, tables
from leapgap.jumping.experiments.trial import Landing, RunMetrics, TrialResult

CONDUCT = RunMetrics(0.4, 200.0, 0.02, 30.0, 0.1)


def run(
    errors: list[float],
    task: str = "jump_60",
    wanted: int = 1,
    fallbacks: int = 0,
    success: bool = True,
    robot: str = "worn",
) -> ScoredRun:
    landings = tuple(Landing(error, error, -error, 2.0, success) for error in errors)
    total = sum(errors) if len(errors) == wanted else None
    done = TrialResult(landings, total, {"late": fallbacks} if fallbacks else {}, (), CONDUCT)
    return ScoredRun("worn", robot, "ours", task, 0, wanted, done)


def test_figures_of_three_runs() -> None:
    found = tables([run([3.0]), run([-1.0], fallbacks=2), run([1.0], success=False)], seed=0)
    key = "worn/ours/jump_60"
    assert found["error_cm"][key] == 1.0
    assert found["abs_error_cm"][key] == pytest.approx(5 / 3, abs=1e-3)
    assert found["error_sd_cm"][key] == 2.0
    assert found["worst_error_cm"][key] == 3.0
    assert found["success"][key] == pytest.approx(2 / 3, abs=1e-3)
    assert found["landing_pitch_deg"][key] == pytest.approx(5 / 3, abs=1e-3)
    assert found["jumps"][key] == 3
    assert found["fallbacks"][key] == 2
    low, high = found["abs_error_ci95_cm"][key]
    assert 1.0 <= low < 5 / 3 < high <= 3.0


def test_jumps_that_were_never_made_are_no_success_and_have_no_total() -> None:
    found = tables([run([1.0, -2.0], "continuous_60", 4), run([1.0, 1.0, 1.0, 1.0], "continuous_60", 4)], seed=0)
    key = "worn/ours/continuous_60"
    assert (found["jumps"][key], found["jumps_made"][key]) == (8, 6)
    assert found["success"][key] == 0.75
    assert found["total_error_cm"][key] == 4.0


def test_a_method_that_never_jumped_has_figures_without_numbers() -> None:
    found = tables([run([])], seed=0)
    assert found["abs_error_cm"]["worn/ours/jump_60"] is None
    assert found["success"]["worn/ours/jump_60"] == 0.0
    assert mean_over_tasks([run([])], ["jump_60"], seed=0)["mean_abs_error_cm"] == {}


def test_the_headline_counts_each_task_alike() -> None:
    runs = [
        run([1.0]),
        run([1.0]),
        run([1.0]),
        run([-5.0], "box_60_20"),
        run([-5.0], "box_60_20"),
        run([99.0], "block_60"),
    ]
    found = mean_over_tasks(runs, ["jump_60", "box_60_20"], seed=0)
    assert found["mean_abs_error_cm"] == {"worn/ours": 3.0}
    assert found["mean_abs_error_ci95_cm"] == {"worn/ours": [3.0, 3.0]}, "no scatter within a task"


def test_one_jump_has_no_interval() -> None:
    runs = [run([1.0]), run([2.0]), run([-5.0], "box_60_20")]
    assert mean_over_tasks(runs, ["jump_60", "box_60_20"], seed=0)["mean_abs_error_ci95_cm"] == {"worn/ours": None}
    assert tables(runs, seed=0)["abs_error_ci95_cm"]["worn/ours/box_60_20"] is None


def test_robots_are_drawn_again_with_all_they_did() -> None:
    """Twenty jumps of each of two robots tell little about a third."""
    runs = [run([error], robot=robot) for robot, error in (("a", 1.0), ("b", 3.0)) for _ in range(20)]
    assert tables(runs, seed=0)["abs_error_ci95_cm"]["worn/ours/jump_60"] == [1.0, 3.0]
    assert mean_over_tasks(runs, ["jump_60"], seed=0)["mean_abs_error_ci95_cm"] == {"worn/ours": [1.0, 3.0]}


def test_the_interval_of_a_mean_has_its_coverage() -> None:
    rng, hits = np.random.default_rng(1), 0
    for seed in range(200):
        errors = rng.normal(2.0, 1.0, 20)
        low, high = tables([run([e]) for e in errors], seed)["error_ci95_cm"]["worn/ours/jump_60"]
        hits += low <= 2.0 <= high
    assert 0.85 <= hits / 200 <= 0.99
