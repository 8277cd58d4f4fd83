"""Loggers of trainings: what they were given can be read back, and no result depends on them."""

import csv
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning import model_grid
from leapgap.jumping.learning.loggers import LoggerConfig
from leapgap.jumping.learning.models.residual_networks import NetworksConfig
from leapgap.jumping.learning.recipe import Fitting
from leapgap.jumping.learning.windows import Windows
from leapgap.runtime.atomic_io import read_json
from stages.compose import compose_conf
from tests.jumping.learning.test_training import INPUTS, config

PACKAGES = {"dvclive": "dvclive", "tensorboard": "tensorboard", "mlflow": "sqlalchemy", "wandb": "wandb"}
NETWORKS = NetworksConfig(inputs=INPUTS, hidden=[8], seeds=2, fitting=Fitting(steps=6))
FIT = {"models": ["nominal_fitted", "networks"], "folds": 2, "steps_an_epoch": 2}
SPLITS = ("fold_0", "fold_1", "all")


def train(windows: Windows, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **changes: int) -> Path:
    """Fit in a working folder of its own, as a stage does; that folder."""
    (tmp_path / name).mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path / name)
    chosen = config(**FIT, model_settings={"networks": NETWORKS}, logger=LoggerConfig(name), **changes)
    model_grid.train(windows, chosen, Path("models"))
    return tmp_path / name


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of the models by its path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def curves(folder: Path) -> dict[str, list[list[float | None]]]:
    """Rows of step, training loss and held-out loss of each training, by its run's name."""
    paths = sorted(folder.glob("models/*/networks.curve.json"))
    return {f"{path.parent.name}/networks": read_json(path)["rows"] for path in paths}


@pytest.fixture
def by_csv(windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return train(windows, "csv", tmp_path, monkeypatch)


@pytest.mark.parametrize("name", PACKAGES)
def test_results_are_the_same_bytes_whatever_logger(
    name: str, by_csv: Path, windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(PACKAGES[name])
    pytest.importorskip(name)
    logged = train(windows, name, tmp_path, monkeypatch)
    assert contents(logged / "models") == contents(by_csv / "models")
    assert [path.name for path in logged.iterdir()].count("lightning_logs") == 1
    assert {path.name for path in logged.iterdir()} == {"models", "lightning_logs"}  # nothing is written elsewhere


def test_by_default_nothing_but_the_models_is_written(by_csv: Path) -> None:
    assert {path.name for path in by_csv.iterdir()} == {"models"}
    assert len((by_csv / "models/curves.csv").read_text().splitlines()) == 1 + 3 * len(curves(by_csv))


@pytest.mark.long
def test_tensorboard_reads_the_curve_of_every_training(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    folder = train(windows, "tensorboard", tmp_path, monkeypatch, processes=2)
    assert len(curves(folder)) == 3
    for run, rows in curves(folder).items():
        found = accumulators.EventAccumulator(str(folder / "lightning_logs/models" / run / "version_0")).Reload()
        for column, tag in ((1, "train_loss"), (2, "validation_loss")):
            known = [(row[0], row[column]) for row in rows if row[column] is not None]
            seen = [(event.step, event.value) for event in found.Scalars(tag)] if known else []
            assert seen == [(step, pytest.approx(value, rel=1e-6)) for step, value in known]


def test_dvclive_keeps_a_table_of_every_training(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dvclive")
    folder = train(windows, "dvclive", tmp_path, monkeypatch)
    assert len(curves(folder)) == 3
    for run, rows in curves(folder).items():
        with (folder / "lightning_logs/models" / run / "plots/metrics/train/loss.tsv").open() as file:
            found = [(int(row["step"]), float(row["loss"])) for row in csv.DictReader(file, delimiter="\t")]
        assert found == [(step, pytest.approx(loss, rel=1e-6)) for step, loss, _ in rows]


def test_mlflow_reads_the_curve_of_every_training(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sqlalchemy")
    mlflow = pytest.importorskip("mlflow")
    folder = train(windows, "mlflow", tmp_path, monkeypatch, processes=2)
    store = folder / "lightning_logs/mlflow.db"
    client = mlflow.MlflowClient(f"sqlite:///{store}")
    (experiment,) = [one for one in client.search_experiments() if one.name == "models"]
    runs = {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}
    assert set(runs) == set(curves(folder))
    for name, rows in curves(folder).items():
        assert runs[name].info.status == "FINISHED"
        assert runs[name].data.params["learning_rate"] == str(NETWORKS.fitting.learning_rate)
        history = client.get_metric_history(runs[name].info.run_id, "train_loss")
        assert sorted((one.step, one.value) for one in history) == [(row[0], row[1]) for row in rows]
    sqlite3.connect(store).close()


def test_wandb_keeps_one_offline_run_a_training(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")  # nothing answers there
    folder = train(windows, "wandb", tmp_path, monkeypatch)
    kept = [path.read_bytes() for path in (folder / "lightning_logs/wandb").glob("offline-run-*/*.wandb")]
    assert len(kept) == len(curves(folder)) == 3
    for run in curves(folder):
        (own,) = [content for content in kept if run.encode() in content]
        assert b"train_loss" in own


def test_a_trained_model_is_kept_when_another_logger_is_chosen(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("tensorboard")
    train(windows, "csv", tmp_path, monkeypatch)
    fitted = model_grid.train(
        windows,
        config(**FIT, model_settings={"networks": NETWORKS}, logger=LoggerConfig("tensorboard")),
        Path("models"),
    )
    assert fitted == []


def test_a_missing_package_is_named_with_its_extra_before_any_work(
    windows: Windows, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "wandb", None)
    with pytest.raises(InputError, match=r"what the extra 'wandb' installs; pip install 'leapgap\[wandb\]'"):
        train(windows, "wandb", tmp_path, monkeypatch)
    assert not list((tmp_path / "wandb/models").rglob("*.npz"))


def test_an_unknown_logger_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(ValueError, match="logger abacus: one of csv, tensorboard, dvclive, mlflow, wandb"):
        LoggerConfig("abacus")


@pytest.mark.parametrize("name", ["csv", *PACKAGES])
def test_the_group_of_hydra_chooses_each(name: str) -> None:
    conf = compose_conf([f"train/logger={name}"])
    assert conf["train"]["logger"] == {"name": name, "folder": "lightning_logs"}


def test_defaults_of_the_group_are_those_of_the_library() -> None:
    assert replace(LoggerConfig()) == LoggerConfig("csv", "lightning_logs")
    assert compose_conf() == compose_conf(["train/logger=csv"])
