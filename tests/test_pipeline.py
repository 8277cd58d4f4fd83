"""The whole pipeline through DVC, in a copy of the project, at size tiny."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.files import read_json
from tests.code import ROOT

pytestmark = pytest.mark.pipeline
DVC = str(Path(sys.executable).with_name("dvc"))


class Project:
    """A copy of the working tree as a git repository of its own, set to size tiny."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for name in listed:
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        self.change("conf/config.yaml", "size: default", "size: tiny")
        self.git("init", "-q", "-b", "main")
        self.commit("start")

    @property
    def environment(self) -> dict[str, str]:
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("DVC_", "GIT_"))}
        path = f"{Path(sys.executable).parent}{os.pathsep}{kept['PATH']}"
        return kept | {"PATH": path, "PYTHONPATH": str(self.folder / "src"), "DVC_NO_ANALYTICS": "1"}

    def run(self, *command: str, code: int | None = 0) -> str:
        done = subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )
        said = done.stdout + done.stderr
        assert code is None or done.returncode == code, said[-6000:]
        return said

    def dvc(self, *arguments: str, code: int | None = 0) -> str:
        return self.run(DVC, *arguments, code=code)

    def git(self, *arguments: str) -> str:
        identity = ("-c", "user.name=tester", "-c", "user.email=tester@example.org", "-c", "commit.gpgsign=false")
        return self.run("git", *identity, *arguments)

    def commit(self, message: str) -> None:
        self.git("add", "-A")
        self.git("commit", "-q", "-m", message)

    def change(self, file: str, old: str, new: str) -> None:
        path = self.folder / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def outputs(self) -> dict[str, str]:
        """Hash of every output that must repeat byte for byte (recordings do not)."""
        lock = OmegaConf.to_container(OmegaConf.load(self.folder / "dvc.lock"))
        return {
            out["path"]: out["md5"]
            for stage in lock["stages"].values()
            for out in stage.get("outs", [])  # type: ignore[index,call-overload]
            if not out["path"].startswith(("data/views", "data/reports"))
        }


def ran(said: str) -> set[str]:
    """Names of the stages that DVC says it ran."""
    return set(re.findall(r"Running stage '([^']+)'", said))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project without a log of a real robot, run once."""
    project = Project(tmp_path_factory.mktemp("simulated"))
    project.said = project.dvc("repro")  # type: ignore[attr-defined]
    project.commit("run")
    return project


def test_without_real_logs_everything_runs_and_says_so(simulated: Project) -> None:
    said = simulated.said  # type: ignore[attr-defined]
    assert "no logs in data/raw" in said
    assert (simulated.folder / "data/reports/damped/report.html").exists()
    assert not (simulated.folder / "data/reports/real/report.html").exists()
    assert list((simulated.folder / "data/views").glob("simulated_*.rrd"))
    assert list((simulated.folder / "data/views").glob("reference_*.rrd"))
    where = simulated.run(sys.executable, "-m", "leapgap.view.where")
    assert "data/reports/damped/report.html" in where
    assert "no logs of a real robot" in where


def test_committed_figures_of_real_jumps_are_kept_where_there_are_no_logs(simulated: Project) -> None:
    for name in ("learning", "diagnosis"):
        committed = ROOT / "metrics" / "real" / f"{name}.json"
        if committed.exists():
            assert (simulated.folder / committed.relative_to(ROOT)).read_text() == committed.read_text()


def test_second_run_does_nothing(simulated: Project) -> None:
    assert ran(simulated.dvc("repro")) == set()


def test_the_simulated_diagnosis_names_what_was_injected(simulated: Project) -> None:
    report = read_json(simulated.folder / "data/reports/damped/report.json")
    assert report["answer"] == [["joint_damping"]]


def test_a_changed_setting_reruns_what_depends_on_it_and_nothing_else(simulated: Project) -> None:
    simulated.change("conf/view/default.yaml", "most_predictions: 4", "most_predictions: 3")
    assert ran(simulated.dvc("repro")) == {"params", "view"}
    simulated.change("conf/collect/default.yaml", "seed: 1", "seed: 2")
    assert ran(simulated.dvc("repro")) == {
        "params",
        "collect@simulated",
        "collect@damped",
        "chunk@simulated",
        "chunk@simulated_25_25",
        "train@simulated",
        "train@simulated_25_25",
        "evaluate@simulated",
        "diagnose@damped",
        "land",
        "view",
    }


def test_metrics_params_and_plots_tell_the_difference(simulated: Project) -> None:
    """After the changed seed above, against the commit before it."""
    assert "gap_nominal" in simulated.dvc("metrics", "diff")
    assert "collect.seed" in simulated.dvc("params", "diff")
    assert "metrics/diagnosis.json" in simulated.dvc("metrics", "show")
    simulated.dvc("plots", "show", "-o", "plots_page")
    page = (simulated.folder / "plots_page" / "index.html").read_text()
    assert "train_loss" in page
    simulated.git("checkout", "-q", ".")


def test_edits_of_params_by_hand_are_not_lost(simulated: Project) -> None:
    simulated.change("params.yaml", "seed: 1", "seed: 7")
    said = simulated.dvc("repro", code=None)
    assert "seed: 7 in params.yaml, 1 in conf/" in said
    assert "seed: 7" in (simulated.folder / "params.yaml").read_text()
    simulated.git("checkout", "-q", "params.yaml")


def test_an_experiment_sets_params_itself(simulated: Project) -> None:
    said = simulated.dvc("exp", "run", "-S", "view.most=1", "view")
    assert "view" in ran(said)
    assert "most: 1" in (simulated.folder / "params.yaml").read_text()
    simulated.git("checkout", "-q", ".")
    simulated.dvc("checkout", code=None)


def test_a_run_killed_at_any_stage_ends_with_the_same_bytes(simulated: Project, tmp_path: Path) -> None:
    project = Project(tmp_path / "killed")
    for victim, seconds in {"collect@simulated": 1.5, "train@simulated": 8.0, "diagnose@damped": 3.0}.items():
        process = subprocess.Popen(
            [DVC, "repro"],
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
    project.dvc("repro")
    expected = simulated.outputs()
    assert project.outputs() == expected
    leftover = [path.name for path in (project.folder / "data").rglob(".*.partial")]
    assert not leftover, "half-written folders stay behind"


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory, raw: Path) -> Project:
    """A project with four real jumps under DVC, run once as far as real jumps go: landings and blind check do not."""
    project = Project(tmp_path_factory.mktemp("real"))
    folders = sorted((path.parent for path in raw.rglob("joint_act.txt")), key=lambda path: int(path.name))
    for folder in folders[:4]:
        shutil.copytree(folder, project.folder / "data/raw/a1_hardware" / folder.name)
    project.dvc("add", "data/raw/a1_hardware")
    project.commit("four real jumps")
    project.said = project.dvc("repro", "view")  # type: ignore[attr-defined]
    project.commit("run")
    return project


def test_real_jumps_go_from_raw_logs_to_report_and_recording(real: Project) -> None:
    assert "4 jumps imported" in real.said  # type: ignore[attr-defined]
    report = read_json(real.folder / "data/reports/real/report.json")
    assert report["gap"]["nominal"] > 5 * report["gap"]["noise_floor"]
    (clock,) = [check for check in report["checks"] if check["name"] == "joint_clock"]
    assert not clock["passed"]  # the real loop is slower than its log claims, on every jump
    assert min(clock["per_log"].values()) > 1.05
    assert (real.folder / "data/reports/real/diagnosis.rrd").exists()
    assert list((real.folder / "data/views").glob("real_*.rrd"))
    assert read_json(real.folder / "metrics/real/learning.json")["jumps"] == 4
    assert "data/reports/real/report.html" in real.run(sys.executable, "-m", "leapgap.view.where")


def test_push_and_pull_bring_data_to_a_second_clone(real: Project, tmp_path: Path) -> None:
    real.dvc("remote", "add", "-d", "-f", "store", str(tmp_path / "store"))
    real.commit("a remote in a local folder")
    real.dvc("push")
    second = tmp_path / "second"
    subprocess.run(["git", "clone", "-q", str(real.folder), str(second)], check=True)
    clone = Project.__new__(Project)
    clone.folder = second
    clone.dvc("pull")
    for name in ("data/raw/a1_hardware/1/pos.txt", "data/jumps/real/jump_01.parquet", "data/reports/real/report.html"):
        assert (second / name).read_bytes() == (real.folder / name).read_bytes()
    assert ran(clone.dvc("repro", "view")) == set()


def test_raw_logs_can_be_imported_from_another_repository(real: Project, tmp_path: Path) -> None:
    source = tmp_path / "source"
    shutil.copytree(real.folder / "data/raw/a1_hardware/1", source / "set" / "1")
    for command in (
        ["init", "-q"],
        ["add", "-A"],
        ["-c", "user.name=t", "-c", "user.email=t@example.org", "commit", "-q", "-m", "logs"],
    ):
        subprocess.run(["git", *command], cwd=source, check=True)
    real.dvc("import", str(source), "set", "-o", "data/raw/imported")
    assert (real.folder / "data/raw/imported/1/pos.txt").exists()
    assert "import_logs" in real.dvc("status")
    shutil.rmtree(real.folder / "data/raw/imported")
    (real.folder / "data/raw/imported.dvc").unlink()


def test_a_damaged_log_stops_repro_with_its_message_and_spoils_nothing(real: Project) -> None:
    path = real.folder / "data/raw/a1_hardware/2/torque.txt"
    whole = path.read_text()
    path.unlink()  # a link into DVC's cache, perhaps: never write through it
    path.write_text(whole.replace(whole.split()[0], "nan", 1))
    said = real.dvc("repro", "view", code=None)
    assert "torque.txt: found 1 values that are no number, first in row 0" in said
    assert "exited with 2" in said
    assert "Traceback" not in said
