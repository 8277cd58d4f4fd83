"""The registry of models: the names that metrics promise, and a new model that touches no other file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning import evaluation, model_grid
from leapgap.jumping.learning.experiment import fit_task, folds
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.recipe import FitTask, LearningCurve, ModelRecipe
from leapgap.jumping.learning.store import find_recipe, recipes
from leapgap.jumping.learning.windows import RolloutInputs, Windows
from leapgap.jumping.reports import learning as page
from leapgap.runtime.atomic_io import read_json
from tests.code import closure
from tests.jumping.learning.test_training import config


@dataclass(frozen=True)
class StandingStill(Model):
    """Stays where it is."""

    kind: ClassVar[str] = "still"

    def predict(self, inputs: RolloutInputs) -> np.ndarray:
        return np.repeat(inputs.state[:, None], inputs.force.shape[1] + 1, axis=1)

    @classmethod
    def from_parts(cls, arrays: dict[str, np.ndarray], settings: dict[str, Any]) -> "StandingStill":
        return cls()


class StandingStillRecipe(ModelRecipe):
    """Needs no fit, and uses nothing measured later; its name resembles others."""

    name = "networks_free_forecast"
    model = StandingStill
    colour = "#123456"
    can_be_exported = False
    forecast_name = "networks_free_forecast"

    def fit(self, task: FitTask) -> tuple[Model, LearningCurve]:
        return StandingStill(), []


def test_the_registry_has_the_names_that_metrics_promise():
    """Keys that others read in metrics/learning.json; the order is that of the message about an unknown model."""
    assert list(recipes()) == [
        *("blend", "blend_no_phase", "constant_velocity", "kernel", "kernel_forecast", "kernel_no_phase"),
        *("networks", "networks_forecast", "networks_no_phase", "nominal", "nominal_fitted", "nominal_published"),
        *("playback", "published_recipe"),
    ]


def test_what_a_recipe_refers_to_exists():
    for name, recipe in recipes().items():
        assert recipe.name == name
        if recipe.uncertainty_from is not None:
            assert recipes()[recipe.uncertainty_from].uncertainty_file, name
    files = [recipe.uncertainty_file for recipe in recipes().values() if recipe.uncertainty_file]
    assert files == ["spread", "spread_forecast", "spread_no_phase"]


@pytest.mark.parametrize("family", ["kernel", "networks"])
def test_only_the_variant_without_phase_leaves_the_phase_out(windows: Windows, tmp_path, family):
    split, small = folds(windows.jumps, 2)[0], config()
    train, held_out = (windows.of_jumps(part) for part in (split.train, split.held_out))
    inputs = {}
    for name in (family, f"{family}_no_phase"):
        task = fit_task(small, split, name, train, held_out, tmp_path, tmp_path / f".{name}")
        inputs[name] = recipes()[name].fit(task)[0].settings()["inputs"]
    assert [name for name in inputs[family] if name != "phase"] == inputs[f"{family}_no_phase"]
    assert "phase" in inputs[family]


def test_an_ensemble_needs_its_members_first(windows: Windows, tmp_path):
    with pytest.raises(InputError, match=r"train.models: found blend before networks; expected networks before it"):
        model_grid.train(windows, config(models=["blend", "networks", "kernel"]), tmp_path)


def test_a_new_model_is_one_recipe(windows: Windows, tmp_path: Path, monkeypatch):
    """Trained, judged, forecast and shown under its own name, colour and label, whatever its name resembles."""
    recipe = StandingStillRecipe()
    monkeypatch.setitem(recipes(), recipe.name, recipe)
    model_grid.train(windows, config(models=["kernel", recipe.name]), tmp_path / "models")
    assert read_json(tmp_path / "models" / "all" / "networks_free_forecast.json")["kind"] == "still"
    assert not list((tmp_path / "models" / "exported").glob("networks_free_forecast*"))
    found = evaluation.predict_held_out(windows, tmp_path / "models", "fold")
    assert found is not None
    figures = evaluation.metrics(found, None, windows)
    moved = windows.state[:, 1:] - windows.state[:, :1]
    assert figures["cv_mse"]["networks_free_forecast"] == pytest.approx((moved**2).mean(), rel=1e-5)
    assert figures["forecast_cv_mse"] == {"networks_free_forecast": figures["cv_mse"]["networks_free_forecast"]}
    assert set(figures["coverage"]) == {"kernel"}
    evaluation.write_tables(found, tmp_path)
    drawn = page.errors_by_step(page.read_rows(tmp_path / "error_by_step.csv"))
    shown = {trace.name: trace.line.color for trace in drawn.data}
    assert shown == {"kernel": "#14804a", "networks free forecast": "#123456"}


def test_a_model_nobody_knows_is_named():
    with pytest.raises(InputError, match=r"splits.json: found a model named oracle; expected some of blend, "):
        find_recipe("oracle", "splits.json")


def test_models_do_not_import_what_trains_or_exports_them():
    """Whoever adds a model needs only what stands below it; the ONNX graph needs only the flat form."""
    above = {f"leapgap.jumping.learning.{name}" for name in ("store", "experiment", "evaluation")}
    models = (f"models.{name}" for name in ("nominal", "kernel", "residual_networks"))
    for name in ("recipe", "network", *models):
        assert not closure(f"leapgap.jumping.learning.{name}") & above, name
    assert "leapgap.jumping.learning.store" not in closure("leapgap.jumping.learning.onnx_graph")
