"""A multirun ends with one table and plot, goes on where it ended, and outlives a job that fails."""

import csv
import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from leapgap.jumping.learning import windows as windows_module
from leapgap.runtime.atomic_io import read_json, write_json
from stages.compose import compose_conf
from stages.sweep import HELD, Table
from tests import plain_arm
from tests.commands import environment, python, stage
from tests.jumping.learning.conftest import jumps, windows  # noqa: F401 - fixtures

ROOT = Path(__file__).parents[2]


def test_a_multirun_of_train_ends_with_one_table(windows, tmp_path):  # noqa: F811
    windows_module.write(windows, tmp_path / "windows")
    arguments = [
        "train.models=[kernel]",
        "train.sessions=null",
        "train.folds=2",
        "train.processes=1",
        "train.curvature=0",  # as the jumps were made
        f"train.windows={tmp_path / 'windows'}",
        "train.kernel.ridge_contact=10,0.02",
        "train.kernel.length_contact=1,2",
        f"hydra.sweep.dir={tmp_path / 'sweep'}",
    ]
    done = stage("train", "-m", *arguments)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "sweep" / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 and f"4 runs -> {tmp_path / 'sweep' / 'table.csv'}" in done.stdout
    errors = [float(row["kernel"]) for row in rows]
    assert errors == sorted(errors) and len(set(errors)) == 4
    varied = {(row["train.kernel.ridge_contact"], row["train.kernel.length_contact"]) for row in rows}
    assert varied == {("10", "1"), ("10", "2"), ("0.02", "1"), ("0.02", "2")}


def multirun(*arguments: str, code: int = 0, path: str = "") -> str:
    """A sweep of a stage; what it printed."""
    own = {"PYTHONPATH": os.pathsep.join((environment()["PYTHONPATH"], path))} if path else {}
    done = python("-m", *arguments, **own)
    assert done.returncode == code, done.stdout[-2000:] + done.stderr[-3000:]
    return done.stdout + done.stderr


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    plain_arm.write_model(folder)
    plain_arm.write_parquet(folder / "logs")
    return folder


def diagnoses(arm: Path, folder: Path, *arguments: str, **more: Any) -> str:
    """A sweep of quick diagnoses of the arm."""
    quick = ["noise_draws=1", "bootstrap_draws=50", "most_pieces=12", "best=false"]
    return multirun(
        "stages.diagnose", "-m", f"diagnose.robot={arm / 'arm.xml'}", "diagnose.recordings=false", "diagnose.threads=1",
        *(f"diagnose.settings.{one}" for one in quick), f"hydra.sweep.dir={folder}", *arguments, **more,
    )  # fmt: skip


@pytest.mark.long
def test_a_job_that_fails_is_shown_and_the_next_run_makes_only_what_is_missing(arm: Path, tmp_path: Path) -> None:
    logs = [
        f"diagnose.logs={arm / 'logs'},{tmp_path / 'later'}",
        "diagnose.settings.effects=[joint_damping],[armature]",
    ]
    (tmp_path / "later").write_text("no folder yet")
    said = diagnoses(arm, tmp_path / "sweep", *logs, code=1)
    rows = table(tmp_path / "sweep")
    assert len(rows) == 4 and sum(bool(row["failed"]) for row in rows) == 2
    assert "2 of 4 runs failed; the same command with hydra.sweep.dir=" in said
    assert rows[0]["diagnose.settings.effects"] == "[joint_damping]"  # what is hidden leaves the smallest gap
    assert float(rows[0]["gap_corrected"]) < float(rows[1]["gap_corrected"])
    page = (tmp_path / "sweep" / "plot.html").read_text()
    assert "<h1>4 runs</h1>" in page and page.count('class="failed"') == 2 and 'data-figure="figure0"' in page
    reports = sorted(tmp_path.glob("sweep/*/out/report.json"))
    (tmp_path / "later").unlink()
    shutil.copytree(arm / "logs", tmp_path / "later")
    said = diagnoses(arm, tmp_path / "sweep", *logs)
    assert said.count("kept: ") == 2
    rows = table(tmp_path / "sweep")
    assert len(rows) == 4 and "failed" not in rows[0]
    assert rows[0]["gap_corrected"] == rows[1]["gap_corrected"]  # the same logs under two names
    assert set(reports) < set(tmp_path.glob("sweep/*/out/report.json"))


@pytest.mark.long
def test_a_job_of_other_code_is_made_again(arm: Path, tmp_path: Path) -> None:
    settings = [f"diagnose.logs={arm / 'logs'}", "diagnose.settings.effects=[joint_damping]"]
    diagnoses(arm, tmp_path / "sweep", *settings)
    [path] = (tmp_path / "sweep/jobs").iterdir()
    before = read_json(path)
    write_json(path, before | {"code": "of another day"})
    said = diagnoses(arm, tmp_path / "sweep", *settings)
    assert "again, since the code has changed: " in said and "kept: " not in said
    assert read_json(path) == before
    assert "kept: " in diagnoses(arm, tmp_path / "sweep", *settings)


def test_the_folder_of_somebody_else_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/table.csv").write_text("mine\n")
    said = multirun("stages.collect", "-m", "collect.jumps=0,-1", f"hydra.sweep.dir={tmp_path / 'mine'}", code=2)
    assert said.startswith(f"stages.collect: {tmp_path / 'mine'}: found table.csv in it, which leapgap did not write")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["table.csv"]
    assert (tmp_path / "mine/table.csv").read_text() == "mine\n"


@pytest.mark.long
@pytest.mark.parametrize("content", ["garbage", "{}", '{"overrides": [3]}', '{"overrides": [], "figures": 3}'])
def test_a_damaged_result_of_a_job_is_one_message(tmp_path: Path, content: str) -> None:
    arguments = ("stages.collect", "-m", "collect.jumps=0", f"hydra.sweep.dir={tmp_path / 'sweep'}")
    multirun(*arguments, code=1)
    (tmp_path / "sweep/jobs/other.json").write_text(content)
    said = multirun(*arguments, code=2)
    assert f"stages.collect: {tmp_path / 'sweep/jobs/other.json'}: found " in said and "Warning" not in said


def test_the_table_goes_to_workers_while_its_folder_is_held(tmp_path: Path) -> None:
    """Launchers pickle it for them with all callbacks of the multirun."""
    config = OmegaConf.create({"hydra": {"job": {"name": "train"}, "sweep": {"dir": str(tmp_path / "sweep")}}})
    callback = Table()
    callback.on_multirun_start(config)
    try:
        assert (tmp_path / ".sweep.lock").is_file()
        assert isinstance(pickle.loads(pickle.dumps(callback)), Table)
    finally:
        HELD.close()


@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_jobs_in_other_processes_come_to_the_same_table(arm: Path, tmp_path: Path, launcher: str) -> None:
    pytest.importorskip(f"hydra_plugins.hydra_{launcher.partition('_')[0]}_launcher")
    varied = [f"diagnose.logs={arm / 'logs'}", "diagnose.settings.effects=[joint_damping],[armature]"]
    diagnoses(arm, tmp_path / "here", *varied)
    diagnoses(arm, tmp_path / "there", *varied, f"hydra/launcher={launcher}")
    assert (tmp_path / "here/table.csv").read_bytes() == (tmp_path / "there/table.csv").read_bytes()


def test_optuna_finds_the_smallest_figure(arm: Path, tmp_path: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    pytest.importorskip("sqlalchemy")
    diagnoses(
        arm, tmp_path / "sweep", f"diagnose.logs={arm / 'logs'}", "hydra/sweeper=optuna", "hydra.sweeper.n_trials=2",
        "hydra.sweeper.n_jobs=1", "diagnose.settings.effects=choice([joint_damping],[armature])",
        "hydra/sweeper/sampler=grid",
    )  # fmt: skip
    best = OmegaConf.load(tmp_path / "sweep" / "optimization_results.yaml")
    assert best.best_params["diagnose.settings.effects"] == "[joint_damping]"


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "conf/experiment").glob("*.yaml")))
def test_every_experiment_composes_and_says_how_it_is_run(name: str) -> None:
    assert compose_conf([f"experiment={name}"])
    text = (ROOT / "conf/experiment" / f"{name}.yaml").read_text()
    assert text.startswith("# @package _global_") and f"experiment={'<name>' if name == 'default' else name}" in text
    sections = {line.split(":")[0] for line in text.splitlines() if line and line[0].isalpha()} - {"defaults"}
    stages = {path.stem for path in (ROOT / "stages").glob("*.py")}
    assert sections <= stages | {"robot"}
