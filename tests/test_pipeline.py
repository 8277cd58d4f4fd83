"""The whole pipeline through DVC on simulated hardware, in a copy of the project, at size tiny."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from leapgap.runtime.atomic_io import read_json
from tests.code import ROOT
from tests.project import DVC, SAID, Project, ran

pytestmark = [pytest.mark.pipeline, pytest.mark.long]


@pytest.fixture(scope="module")
def simulated_project(simulated_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project without a log of a real robot, run once."""
    return Project.copy_of(simulated_run, tmp_path_factory.mktemp("simulated"))


def test_without_real_logs_everything_runs_and_says_so(simulated_project: Project, simulated_run: Path) -> None:
    said = (simulated_run.parent / SAID).read_text()
    assert "import_logs" not in said  # jumps of others have a pipeline of their own
    assert (simulated_project.folder / "data/reports/damped/report.html").exists()
    assert not (simulated_project.folder / "data/reports/published/report.html").exists()
    assert list((simulated_project.folder / "data/views").glob("simulated_*.rrd"))
    assert list((simulated_project.folder / "data/views").glob("reference_*.rrd"))
    where = simulated_project.run(sys.executable, "-m", "stages.print_results")
    assert "data/reports/damped/report.html" in where
    assert "no published jumps" in where


def test_committed_figures_of_real_jumps_are_kept_where_there_are_no_logs(simulated_project: Project) -> None:
    for name in ("learning", "diagnosis"):
        committed = ROOT / "metrics" / "published" / f"{name}.json"
        if committed.exists():
            assert (simulated_project.folder / committed.relative_to(ROOT)).read_text() == committed.read_text()


BENCHMARKS = sorted(path.stem for path in (ROOT / "tests" / "benchmarks").glob("*.py") if path.stem != "__init__")


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_starts_after_the_pipeline(simulated_project: Project, tmp_path: Path, name: str) -> None:
    """With the smallest counts; what it measures means nothing then."""
    if name == "sysid" and not hasattr(pytest.importorskip("mujoco.sysid"), "ParameterDict"):
        pytest.skip('no peer: pip install -e ".[peers]"')
    if name == "exported_tick" and shutil.which("gcc") is None:
        pytest.skip("no gcc")
    simulated_project.run(sys.executable, "-m", f"tests.benchmarks.{name}", "--tiny", "--json", str(tmp_path / "found"))
    assert read_json(tmp_path / "found")


def test_second_run_does_nothing(simulated_project: Project) -> None:
    assert ran(simulated_project.dvc("repro")) == {"code"}
    assert simulated_project.git("status", "--short") == ""


def test_the_simulated_diagnosis_names_what_was_injected(simulated_project: Project) -> None:
    report = read_json(simulated_project.folder / "data/reports/damped/report.json")
    assert report["answer"] == [["joint_damping"]]


def test_a_changed_setting_reruns_what_depends_on_it_and_nothing_else(simulated_project: Project) -> None:
    simulated_project.change("conf/view/default.yaml", "most_predictions: 4", "most_predictions: 3")
    assert ran(simulated_project.dvc("repro")) == {"code", "params", "view"}
    simulated_project.change("conf/collect/default.yaml", "seed: 1", "seed: 2")
    simulated_project.run(sys.executable, "-m", "stages.params")
    changed = ran(simulated_project.dvc("repro", "--dry"))
    assert changed == {"code", "params", "collect@simulated", "collect@damped"}
    assert simulated_project.after(changed - {"code", "params"}) == {
        "chunk@damped",
        "chunk@simulated",
        "chunk@simulated_25_25",
        "train@damped",
        "train@simulated",
        "train@simulated_25_25",
        "evaluate@simulated",
        "diagnose@damped",
        "report@damped",
        "land",
        "land_corrected",
        "land_page@landings",
        "land_page@landings_corrected",
        "view",
        "index",
    }
    assert ran(simulated_project.dvc("repro", "diagnose@damped", "train@damped")) == {
        "code",
        "params",
        "collect@damped",
        "chunk@damped",
        "train@damped",
        "diagnose@damped",
    }


def test_metrics_params_and_plots_tell_the_difference(simulated_project: Project) -> None:
    """After the changed seed above, against the commit before it."""
    assert "gap_nominal" in simulated_project.dvc("metrics", "diff")
    assert "collect.seed" in simulated_project.dvc("params", "diff")
    assert "metrics/damped/diagnosis.json" in simulated_project.dvc("metrics", "show")
    simulated_project.dvc("plots", "show", "-o", "plots_page")
    page = (simulated_project.folder / "plots_page" / "index.html").read_text()
    assert "train_loss" in page
    simulated_project.git("checkout", "-q", ".")
    simulated_project.dvc("checkout", code=None)  # else the next run fetches each output from the cache of runs


def test_edits_of_params_by_hand_are_not_lost(simulated_project: Project) -> None:
    simulated_project.change("params.yaml", "seed: 1", "seed: 7")
    said = simulated_project.dvc("repro", code=None)
    assert "seed: 7 in params.yaml, 1 in conf/" in said
    assert "seed: 7" in (simulated_project.folder / "params.yaml").read_text()
    simulated_project.git("checkout", "-q", "params.yaml")


def test_an_experiment_sets_params_itself(simulated_project: Project) -> None:
    said = simulated_project.dvc("exp", "run", "-S", "view.most=1", "view")
    assert "view" in ran(said)
    assert "most: 1" in (simulated_project.folder / "params.yaml").read_text()
    simulated_project.git("checkout", "-q", ".")
    simulated_project.dvc("checkout", code=None)


def test_a_run_killed_at_any_stage_ends_with_the_same_bytes(simulated_project: Project, tmp_path: Path) -> None:
    """As far as the diagnosis; landings and the benchmark, which keep what they have, have tests of their own.

    The run that is killed has workers and the one that it is compared with has none.
    """
    goals = ("evaluate@simulated", "diagnose@damped")
    project = Project(tmp_path / "killed")
    (project.folder / "dvc.lock").unlink(missing_ok=True)
    for victim, seconds in {"collect@simulated": 1.5, "train@simulated": 8.0, "diagnose@damped": 3.0}.items():
        process = subprocess.Popen(
            [DVC, "repro", victim],
            cwd=project.folder,
            env=project.environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        assert process.stdout is not None
        for line in process.stdout:
            if f"Running stage '{victim}'" in line:
                time.sleep(seconds)
                break
        else:
            pytest.fail(f"{victim} never ran")
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    project.dvc("repro", *goals)
    outputs, expected = project.outputs(), simulated_project.outputs()
    outputs = {path: of for path, of in outputs.items() if path not in ("params.yaml", "data/code")}  # workers, folders
    assert outputs["data/models/simulated"]
    assert outputs == {path: expected[path] for path in outputs}
    leftover = [path.name for path in (project.folder / "data").rglob(".*.partial")]
    assert not leftover, "half-written folders stay behind"
