"""Published jumps through DVC, from raw logs to report, in a copy of the project, at size tiny."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from leapgap.runtime.atomic_io import read_json
from tests.project import Project, ran

pytestmark = [pytest.mark.pipeline, pytest.mark.long]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory, simulated_run: Path, raw: Path) -> Project:
    """A project that was run without logs of a real robot, with four published jumps that came later under DVC.

    It is run once as far as they go: the benchmark is left out.
    """
    project = Project.copy_of(simulated_run, tmp_path_factory.mktemp("published"))
    folders = sorted((path.parent for path in raw.rglob("joint_act.txt")), key=lambda path: int(path.name))
    for folder in folders[:4]:
        shutil.copytree(folder, project.folder / "data/raw/a1_hardware" / folder.name)
    project.dvc("add", "data/raw/a1_hardware")
    project.commit("four published jumps")
    project.said = project.dvc("repro", "published/dvc.yaml:view", "published/dvc.yaml:report")  # type: ignore[attr-defined]
    project.commit("run")
    return project


def test_published_jumps_go_from_raw_logs_to_report_and_recording(published: Project) -> None:
    assert "4 logs imported" in published.said  # type: ignore[attr-defined]
    report = read_json(published.folder / "data/reports/published/report.json")
    assert report["gap"]["nominal"] > 5 * report["gap"]["noise_floor"]
    (clock,) = [check for check in report["checks"] if check["name"] == "joint_clock"]
    assert not clock["passed"]  # rows last longer than the log claims, on every jump
    assert min(clock["per_log"].values()) > 1.05
    assert (published.folder / "data/views_published/diagnosis_published.rrd").exists()
    assert list((published.folder / "data/views_published").glob("published_*.rrd"))
    assert read_json(published.folder / "metrics/published/learning.json")["jumps"] == 4
    assert "data/reports/published/report.html" in published.run(sys.executable, "-m", "stages.print_results")


def test_jumps_that_come_later_run_what_depends_on_them_and_nothing_else(published: Project) -> None:
    grids = ("published", "published_25_25")  # recordings show nothing that was learned by the logs' own clock
    stages = [
        "import_logs",
        *(f"{stage}@{grid}" for stage in ("chunk", "train") for grid in grids),
        *("evaluate", "diagnose", "report", "view"),
    ]
    assert ran(published.said) == {"code", *(f"published/dvc.yaml:{one}" for one in stages)}  # type: ignore[attr-defined]


def test_push_and_pull_bring_data_to_a_second_clone(published: Project, tmp_path: Path) -> None:
    published.dvc("remote", "add", "-d", "-f", "store", str(tmp_path / "store"))
    published.commit("a remote in a local folder")
    published.dvc("push")
    second = tmp_path / "second"
    subprocess.run(["git", "clone", "-q", str(published.folder), str(second)], check=True)
    clone = Project.__new__(Project)
    clone.folder = second
    clone.dvc("pull", "--with-deps", "published/dvc.yaml:view", "published/dvc.yaml:report")  # those that were run
    of_jumps = ("jumps/published/jump_01.parquet", "reports/published/report.html")
    for name in ("data/raw/a1_hardware/1/pos.txt", *(f"data/{name}" for name in of_jumps)):
        assert (second / name).read_bytes() == (published.folder / name).read_bytes()
    assert ran(clone.dvc("repro", "published/dvc.yaml:view")) == {"code"}


def test_raw_logs_can_be_imported_from_another_repository(published: Project, tmp_path: Path) -> None:
    source = tmp_path / "source"
    shutil.copytree(published.folder / "data/raw/a1_hardware/1", source / "set" / "1")
    for command in (
        ["init", "-q"],
        ["add", "-A"],
        ["-c", "user.name=t", "-c", "user.email=t@example.org", "commit", "-q", "-m", "logs"],
    ):
        subprocess.run(["git", *command], cwd=source, check=True)
    published.dvc("import", str(source), "set", "-o", "data/raw/imported")
    assert (published.folder / "data/raw/imported/1/pos.txt").exists()
    assert "import_logs" in published.dvc("status", "published/dvc.yaml")
    shutil.rmtree(published.folder / "data/raw/imported")
    (published.folder / "data/raw/imported.dvc").unlink()


def damage(table: Path) -> None:
    """Put a value that is no number in the place of a table's first one."""
    whole = table.read_text()
    table.unlink()  # a link into DVC's cache, perhaps: never write through it
    table.write_text(whole.replace(whole.split()[0], "nan", 1))


def test_a_damaged_log_is_set_aside_and_named_and_too_few_others_stop_repro(published: Project) -> None:
    raw = published.folder / "data/raw/a1_hardware"
    damage(raw / "2/torque.txt")
    said = published.dvc("repro", "published/dvc.yaml:import_logs")
    assert "torque.txt: found 1 values that are no number, first in row 0" in said
    assert "3 logs imported" in said
    for jump in ("1", "3"):
        damage(raw / jump / "torque.txt")
    said = published.dvc("repro", "published/dvc.yaml:view", code=None)
    assert said.count("torque.txt: found 1 values that are no number, first in row 0") == 3
    assert "exited with 2" in said
    assert "Traceback" not in said
