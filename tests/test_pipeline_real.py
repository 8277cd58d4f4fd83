"""Real jumps through DVC, from raw logs to report, in a copy of the project, at size tiny."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from leapgap.atomic_io import read_json
from tests.project import Project, ran

pytestmark = pytest.mark.pipeline


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory, raw: Path) -> Project:
    """A project with four real jumps under DVC, run once as far as real jumps go: the blind check does not."""
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
    assert "4 logs imported" in real.said  # type: ignore[attr-defined]
    report = read_json(real.folder / "data/reports/real/report.json")
    assert report["gap"]["nominal"] > 5 * report["gap"]["noise_floor"]
    (clock,) = [check for check in report["checks"] if check["name"] == "joint_clock"]
    assert not clock["passed"]  # the real loop is slower than its log claims, on every jump
    assert min(clock["per_log"].values()) > 1.05
    assert (real.folder / "data/reports/real/diagnosis.rrd").exists()
    assert list((real.folder / "data/views").glob("real_*.rrd"))
    assert read_json(real.folder / "metrics/real/learning.json")["jumps"] == 4
    assert "data/reports/real/report.html" in real.run(sys.executable, "-m", "leapgap.reports.print_results")


def test_push_and_pull_bring_data_to_a_second_clone(real: Project, tmp_path: Path) -> None:
    real.dvc("remote", "add", "-d", "-f", "store", str(tmp_path / "store"))
    real.commit("a remote in a local folder")
    real.dvc("push")
    second = tmp_path / "second"
    subprocess.run(["git", "clone", "-q", str(real.folder), str(second)], check=True)
    clone = Project.__new__(Project)
    clone.folder = second
    clone.dvc("pull", "--allow-missing")  # the blind check was not run here
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
