"""What is done is kept: a killed run goes on, and nothing stale is taken for done."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.experiments.goal_directed_jump import LandingSamples
from leapgap.jumping.experiments.method import JointPdMethod, JumpTask
from leapgap.jumping.experiments.rig import Bench, TrialRunner
from leapgap.jumping.experiments.trial import Landing, RunMetrics, TrialResult, TrialSpec
from leapgap.runtime import cache
from leapgap.runtime.atomic_io import read_json
from leapgap.runtime.cache import ResultCache

TASK = JumpTask("jump_50", 0.5)
CONDUCT = RunMetrics(0.4, 200.0, 0.02, 30.0, 0.1)


def quick(trial: TrialSpec) -> TrialResult:
    """Stands for a trial: a result that depends on its seed."""
    value = trial.seed / 3
    tried = LandingSamples(np.full((1, 3), value), np.full(1, value), np.full((1, 3), value))
    return TrialResult((Landing(value, None, value, 1.0, True),), None, {"late": 2}, ((0.025, "late"),), CONDUCT, tried)


@pytest.fixture
def trials(bench: Bench, joint_pd: JointPdMethod) -> list[TrialSpec]:
    return [bench.trial("joint_pd", joint_pd, TASK, number) for number in range(4)]


@pytest.fixture
def runner(bench: Bench, counted, monkeypatch: pytest.MonkeyPatch) -> TrialRunner:
    monkeypatch.setattr(TrialSpec, "run", quick)
    return replace(bench.runner, map=counted[1])


def places(numbers: str) -> list[str]:
    return [f"ideal/joint_pd/jump_50_{number}" for number in numbers]


def test_a_killed_run_goes_on_where_it_ended(
    runner: TrialRunner, trials: list[TrialSpec], counted, monkeypatch
) -> None:
    made, _ = counted

    def dies_at_the_third(trial: TrialSpec) -> TrialResult:
        if trial.place.endswith("_2"):
            raise KeyboardInterrupt
        return quick(trial)

    monkeypatch.setattr(TrialSpec, "run", dies_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        runner.results(trials)
    monkeypatch.setattr(TrialSpec, "run", quick)
    made.clear()
    found = runner.results(trials)
    assert made == places("23")
    assert [one.landings[0].error_cm for one in found] == [trial.seed / 3 for trial in trials]


def test_what_is_read_is_what_was_made(runner: TrialRunner, trials: list[TrialSpec]) -> None:
    (read,), made = runner.results(trials[:1]), quick(trials[0])
    assert (read.landings, read.fallbacks, read.substituted) == (made.landings, made.fallbacks, made.substituted)
    assert read.metrics == made.metrics
    for name in ("goal", "stance_pitch", "landing"):
        assert np.array_equal(getattr(read.samples, name), getattr(made.samples, name))


@pytest.mark.parametrize("change", ["seed", "task", "method", "code"])
def test_a_change_of_anything_makes_it_anew(
    change: str, runner: TrialRunner, trials: list[TrialSpec], counted, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, _ = counted
    runner.results(trials)
    made.clear()
    trial = trials[1]
    if change == "seed":
        trial = replace(trial, seed=trial.seed + 1)
    elif change == "task":
        trial = replace(trial, task=replace(TASK, block_m=(0.0, 0.001)))
    elif change == "method":
        trial = replace(trial, method=replace(trial.method, shift_m=0.01))
    else:
        monkeypatch.setattr(cache, "code_hash", lambda *roots: "other code")
    runner.results([trials[0], trial])
    assert made == places("01" if change == "code" else "1")


def test_a_result_that_is_half_written_is_made_anew(runner: TrialRunner, trials: list[TrialSpec], counted) -> None:
    runner.results(trials)
    kept = runner.cache.folder / f"{trials[0].place}.json"
    kept.rename(kept.with_name(f".{kept.name}.partial"))  # what a kill leaves
    counted[0].clear()
    runner.results(trials)
    assert counted[0] == places("0")


def test_what_nobody_asks_for_is_swept_away(runner: TrialRunner, trials: list[TrialSpec]) -> None:
    runner.results(trials)
    later = replace(runner, cache=ResultCache(runner.cache.folder))
    later.results(trials[:1])
    later.cache.sweep()
    left = [
        path.relative_to(runner.cache.folder).as_posix() for path in runner.cache.folder.rglob("*") if path.is_file()
    ]
    assert sorted(left) == [f"{trials[0].place}.json", f"{trials[0].place}.key"]


def test_other_values_are_kept_by_their_inputs(runner: TrialRunner) -> None:
    calls = []

    def found(number: int) -> dict[str, int]:
        calls.append(number)
        return {"calls": len(calls)}

    assert [runner.value("ideal/identified", found, number)["calls"] for number in (1, 1, 2, 2)] == [1, 1, 2, 2]


def test_threads_that_ask_for_the_same_result_compute_it_once(runner: TrialRunner) -> None:
    calls = []

    def found(number: int) -> dict[str, int]:
        calls.append(number)
        time.sleep(0.2)
        return {"calls": len(calls)}

    with ThreadPoolExecutor(4) as threads:
        asked = [threads.submit(runner.value, "ideal/identified", found, 7) for _ in range(4)]
        assert [one.result()["calls"] for one in asked] == [1] * 4
    assert calls == [7]


def test_who_waits_for_a_result_gets_its_error(runner: TrialRunner) -> None:
    begun = threading.Event()

    def found() -> dict[str, int]:
        begun.set()
        time.sleep(0.2)
        raise InputError("jump", "none", "one", "make one")

    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(runner.value, "ideal/identified", found)
        begun.wait()
        second = threads.submit(runner.value, "ideal/identified", found)
        for one in (first, second):
            with pytest.raises(InputError, match="make one"):
                one.result()


def test_a_real_trial_repeats_bit_for_bit_and_keeps_its_log(bench: Bench, joint_pd: JointPdMethod) -> None:
    uneven = replace(TASK, slope_rad=(-0.005, 0.005))
    trial = bench.trial("joint_pd", joint_pd, uneven, 0, with_log=True)
    (kept,), again = bench.runner.results([trial]), trial.run()
    assert kept.landings == again.landings
    assert kept.log is not None and again.log is not None
    assert all(np.array_equal(kept.log[name], again.log[name]) for name in again.log.columns)
    other = bench.trial("joint_pd", joint_pd, uneven, 1).run()
    assert other.landings != kept.landings  # from other ground
    assert read_json(bench.runner.cache.folder / f"{trial.place}.json")["conduct"]["force_n"] > 100
