"""Practice in rounds: made once, read again, and what is kept of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.experiments.goal_directed_jump import LandingSamples
from leapgap.jumping.experiments.method import MpcMethod
from leapgap.jumping.experiments.methods import mpc
from leapgap.jumping.experiments.methods.mpc import Practised, Round, judged, practise
from leapgap.jumping.experiments.rig import Bench, LearnedMpcConfig, PracticeRounds, TrialRunner
from leapgap.jumping.experiments.trial import TrialSpec
from leapgap.jumping.learning.window_extraction import DeviatingJump
from leapgap.jumping.models.rigid_body import NominalDeviation, PlannedSteps
from leapgap.jumping.task import Target
from leapgap.runtime.cache import ResultCache
from tests.conftest import A1_BODY

CONFIG = LearnedMpcConfig(practice=PracticeRounds(distances_m=(0.5,), first_jumps=2, rounds=1))


def run(bench: Bench, config: LearnedMpcConfig = CONFIG) -> Practised:
    start = MpcMethod(bench.robot, bench.references, config.gains, NominalDeviation(A1_BODY), config.mpc)
    return practise(bench, start, bench.references, config, {}, "practice")


def test_rounds_are_made_once_and_read_again(bench: Bench, counted: tuple[list[str], Callable], tmp_path: Path) -> None:
    made, mapper = counted
    bench = replace(bench, runner=TrialRunner(ResultCache(tmp_path / "runs"), mapper))
    first = run(bench)
    assert made == [f"ideal/practice/round_{name}" for name in ("0_00", "0_01", "1_00")]
    assert [one.jumps for one in first.rounds] == [2, 1]
    assert first.kept == 2
    elsewhere = TrialRunner(ResultCache(tmp_path / "other"), mapper, earlier=ResultCache(tmp_path / "runs"))
    again = run(replace(bench, runner=elsewhere))
    assert len(made) == 3, "the jumps of the other folder are read"
    assert not (tmp_path / "other").exists()
    for name, array in first.model.arrays().items():
        assert np.array_equal(array, again.model.arrays()[name])


def test_a_round_is_jumped_with_the_model_of_those_before(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    models = []

    def noted(trial: TrialSpec) -> object:
        models.append(trial.method.model)  # type: ignore[attr-defined]
        return original(trial)

    original = TrialSpec.run
    monkeypatch.setattr(TrialSpec, "run", noted)
    found = run(bench)
    assert isinstance(models[0], NominalDeviation)
    assert models[0] is models[1]
    assert models[2] is not models[0]
    assert found.model is not models[2]


@pytest.mark.parametrize(("predicted", "kept"), [([30, 9, 2, 4], 4), ([1, 9, 2, 6], 2), ([30, 9, 6, 7], 2)])
def test_a_model_whose_landings_are_not_as_predicted_is_not_kept(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, predicted: list[float], kept: int
) -> None:
    shown = iter([Round(1, 1.0, cm, 0.0) for cm in predicted])
    monkeypatch.setattr(mpc, "judged", lambda *_: next(shown))
    monkeypatch.setattr(mpc, "deviating_jump", lambda *_: None)
    monkeypatch.setattr(mpc, "deviation_recipes", lambda: {"deviation_kernel": Counting()})
    monkeypatch.setattr(TrialSpec, "run", lambda trial: FAST)
    config = replace(CONFIG, practice=replace(CONFIG.practice, rounds=3, trusted_cm=5.0))
    bench = replace(bench, runner=Quick())  # type: ignore[arg-type]
    assert run(bench, config).kept == kept


class Counting:
    """A recipe that fits nothing."""

    def fit(self, task: object) -> NominalDeviation:
        return NominalDeviation(A1_BODY)


class Made:
    log = "a log"
    samples = LandingSamples()


FAST = Made()


class Quick:
    """A runner whose trials take no time."""

    def results(self, trials: list[TrialSpec]) -> list[Made]:
        return [FAST for _ in trials]


def test_landings_are_judged_beside_plan_and_prediction() -> None:
    """A body that flies as the model says lands as predicted; a kick at the end of the push shows."""
    time = np.arange(0.0, 1.2, 0.1)
    pushing = np.column_stack([time < 0.5, time < 0.8 - 1e-9])
    steps = PlannedSteps(time, time + 0.1, np.zeros((12, 4)), pushing, Target(0.5))
    error = np.zeros((13, 6))
    error[:, 3] = 0.1
    error[:, 0] = 0.1 * np.append(time, 1.2)
    error[:, 2] = 0.2
    exact = DeviatingJump("exact", steps, error, np.zeros((12, 4)))
    kicked = error.copy()
    kicked[8:, 0] += np.arange(5) * 0.1 * 0.25
    shown = judged([exact, replace(exact, error=kicked)], NominalDeviation(A1_BODY))
    assert shown.landed_cm == pytest.approx((12 + 22) / 2)
    assert shown.predicted_cm == pytest.approx((0 + 10) / 2)
    assert shown.pitch_deg == pytest.approx(np.rad2deg(0.2))
