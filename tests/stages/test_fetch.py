"""`make data`: the pinned import is fetched where its repository answers; elsewhere nothing changes, exit code 2."""

import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from leapgap.robot.model_file import PREFIX
from leapgap.validation.real_robots import PACKAGE
from tests.code import ROOT
from tests.project import environment

PINNED = ROOT / "imports/a1_hardware.dvc"
PLACE = "residual_learning/data/mix-20traj"


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def public(tmp_path: Path) -> Path:
    """A repository that holds logs in the place of the published ones, and a later commit that changed them."""
    folder = tmp_path / "public"
    (folder / PLACE / "1").mkdir(parents=True)
    (folder / PLACE / "1/pos.txt").write_text("0 1 2\n")
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "logs")
    return folder


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository under git and DVC with the import file and what DVC leaves out, and no logs."""
    folder = tmp_path / "project"
    (folder / "imports").mkdir(parents=True)
    (folder / "data/raw").mkdir(parents=True)
    shutil.copy(PINNED, folder / "imports")
    shutil.copy(ROOT / ".dvcignore", folder)
    (folder / "stages").symlink_to(ROOT / "stages")
    git(folder, "init", "-q")
    run(folder, "dvc", "init", "-q")
    (folder / "dvc.yaml").write_text(
        "stages: {list: {cmd: ls -R data/raw > listed.txt, deps: [data/raw], outs: [listed.txt]}}\n"
    )
    return folder


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    variables = environment(ROOT) | {
        "GIT_TERMINAL_PROMPT": "0",
        "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), "."]),
    }
    return subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)


def fetch(folder: Path, *names: str) -> subprocess.CompletedProcess[str]:
    return run(folder, sys.executable, "-m", "stages.fetch", *names)


def pin(project: Path, url: str, revision: str | None = None) -> None:
    """Let the project's import file name another address, and another commit if one is given."""
    text = (project / "imports/a1_hardware.dvc").read_text()
    repository = OmegaConf.load(PINNED).deps[0].repo
    text = text.replace(repository.url, url)
    (project / "imports/a1_hardware.dvc").write_text(text.replace(repository.rev, revision or repository.rev))


def test_the_pin_is_a_whole_commit_of_the_public_repository() -> None:
    (dependency,) = OmegaConf.load(PINNED).deps
    assert dependency.path == PLACE
    assert dependency.repo.url == "https://github.com/DRCL-USC/Learning_MPC_Jumping"
    assert len(dependency.repo.rev) == 40 == len(dependency.repo.rev_lock)
    assert OmegaConf.load(PINNED).outs[0].path == "a1_hardware"


def test_logs_come_as_they_were_at_the_pinned_commit_and_dvc_knows_them(project: Path, public: Path) -> None:
    pinned = git(public, "rev-parse", "HEAD")
    (public / PLACE / "1/pos.txt").write_text("changed later\n")
    git(public, "commit", "-qam", "later")
    pin(project, str(public), pinned)
    done = fetch(project)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (project / "data/raw/a1_hardware/1/pos.txt").read_text() == "0 1 2\n"
    assert "data/raw/a1_hardware: 1 files" in done.stdout
    assert run(project, "dvc", "repro", "-q").returncode == 0
    assert "pos.txt" in (project / "listed.txt").read_text()
    assert "Data and pipelines are up to date." in run(project, "dvc", "status").stdout
    public.rename(public.with_name("gone"))  # what was fetched needs no network any more
    assert run(project, "dvc", "repro").returncode == 0
    again = fetch(project)
    assert again.returncode == 0
    assert "there already, left as it is" in again.stdout


def test_without_a_network_nothing_changes_and_the_message_says_what_to_do(project: Path) -> None:
    pin(project, "https://nobody.invalid/Learning_MPC_Jumping")
    done = fetch(project)
    assert done.returncode == 2
    assert done.stderr.startswith("stages.fetch: https://nobody.invalid/Learning_MPC_Jumping: found no answer (")
    assert "expected a repository that a network reaches; run it where there is a network, or copy" in done.stderr
    assert "without them everything runs on simulated hardware and says so" in done.stderr
    assert "Traceback" not in done.stderr
    assert list((project / "data/raw").iterdir()) == []


def test_a_commit_that_is_gone_leaves_nothing_behind(project: Path, public: Path) -> None:
    pin(project, str(public), "ab" * 20)
    done = fetch(project)
    assert done.returncode == 2
    assert f"{public}: found no such data at abababa (" in done.stderr
    assert not [path for path in (project / "data/raw").iterdir() if path.name != ".gitignore"]


def test_dvc_misses_no_import_where_nothing_was_fetched(project: Path) -> None:
    """An import file that DVC sees would make `dvc status`, `pull` and `repro` ask for a network."""
    pin(project, "https://nobody.invalid/Learning_MPC_Jumping")
    assert run(project, "dvc", "repro", "-q").returncode == 0
    done = run(project, "dvc", "pull", "--allow-missing")
    assert "nobody.invalid" not in done.stdout + done.stderr


def test_logs_that_somebody_brought_are_left_alone(project: Path) -> None:
    own = project / "data/raw/a1_hardware/1/pos.txt"
    own.parent.mkdir(parents=True)
    own.write_text("mine\n")
    done = fetch(project)
    assert done.returncode == 0, done.stderr
    assert own.read_text() == "mine\n"
    assert not (project / "data/raw/a1_hardware.dvc").exists()


def test_a_fetch_that_was_killed_leaves_no_half_of_the_logs(project: Path, public: Path, tmp_path: Path) -> None:
    pin(project, str(public), git(public, "rev-parse", "HEAD"))
    slow = tmp_path / "bin" / "dvc"
    slow.parent.mkdir()
    slow.write_text("#!/bin/sh\ncd data/raw\nmkdir -p a1_hardware/1\necho half > a1_hardware/1/half.txt\nsleep 60\n")
    slow.chmod(0o755)
    variables = environment(ROOT) | {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), "."])}
    variables["PATH"] = f"{slow.parent}{os.pathsep}{variables['PATH']}"
    killed = subprocess.Popen([sys.executable, "-m", "stages.fetch"], cwd=project, env=variables)
    half = project / "data/raw/a1_hardware/1/half.txt"
    deadline = time.monotonic() + 60
    while not half.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    killed.kill()
    killed.wait()
    assert half.exists()
    done = fetch(project)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [path.name for path in (project / "data/raw/a1_hardware").rglob("*.txt")] == ["pos.txt"]
    left = {path.name for path in (project / "data/raw").iterdir()}
    assert left == {"a1_hardware", "a1_hardware.dvc", ".gitignore"}


@pytest.mark.parametrize("content", ["outs: [", "[1, 2]", "deps: []\nouts: []\n", "deps: [1]\nouts: [2]\n"])
def test_an_import_file_that_is_none_is_one_message(project: Path, content: str) -> None:
    (project / "imports/a1_hardware.dvc").write_text(content)
    done = fetch(project)
    assert done.returncode == 2
    assert done.stderr.startswith("stages.fetch: imports/a1_hardware.dvc: found no import of DVC (")
    assert len(done.stderr.splitlines()) == 1


IMPORTS = sorted((ROOT / "imports").glob("*.dvc"))


@pytest.mark.parametrize("file", IMPORTS, ids=lambda file: file.stem)
def test_every_import_names_a_public_repository_and_a_commit(file: Path) -> None:
    (dependency,), (out,) = OmegaConf.load(file).deps, OmegaConf.load(file).outs
    assert dependency.repo.url.startswith("https://github.com/")
    assert 7 <= len(dependency.repo.rev) <= 40 and int(dependency.repo.rev, 16) > 0
    own = Path(os.environ.get("LEAPGAP_ROBOTS", ROOT / "data/raw")) / out.path
    if own.is_file() and "md5" in out:
        content = own.read_bytes()
        assert (hashlib.md5(content).hexdigest(), len(content)) == (out.md5, out.size)


def test_imports_bring_what_make_robots_reads() -> None:
    brought = {OmegaConf.load(file).outs[0].path for file in IMPORTS}
    for name, case in OmegaConf.load(ROOT / "conf/robots/default.yaml").cases.items():
        assert case.robot in brought or case.robot.startswith((PACKAGE, PREFIX)), name
        assert any(Path(case.source) in (Path(path), Path(path).parent) for path in brought - {case.robot}), name


@pytest.fixture
def arm(project: Path, tmp_path: Path) -> Path:
    """A public repository of two files, which two import files of the project name by the beginning of a commit."""
    folder = tmp_path / "arm"
    (folder / "logs/1").mkdir(parents=True)
    (folder / "logs/1/trajectory.csv").write_text("0 1\n")
    (folder / "arm.urdf").write_text("<robot/>\n")
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "logs")
    for name, path, out in (
        ("log", "logs/1/trajectory.csv", "arm/sent/one.csv"),
        ("model", "arm.urdf", "arm/arm.urdf"),
    ):
        content = (folder / path).read_bytes()
        repository = {"url": str(folder), "rev": git(folder, "rev-parse", "--short", "HEAD")}
        known = {"hash": "md5", "md5": hashlib.md5(content).hexdigest(), "size": len(content), "path": out}
        stated = {"frozen": True, "deps": [{"path": path, "repo": repository}], "outs": [known]}
        OmegaConf.save(OmegaConf.create(stated), project / f"imports/arm_{name}.dvc")
    (folder / "arm.urdf").write_text("<robot name='later'/>\n")
    git(folder, "commit", "-qam", "later")
    return folder


def test_a_source_of_several_files_comes_whole_and_beside_those_that_are_there(project: Path, arm: Path) -> None:
    (project / "data/raw/arm/sent").mkdir(parents=True)
    (project / "data/raw/arm/sent/one.csv").write_text("mine\n")
    done = fetch(project, "arm")
    assert done.returncode == 0, done.stdout + done.stderr
    assert (project / "data/raw/arm/arm.urdf").read_text() == "<robot/>\n"
    assert (project / "data/raw/arm/sent/one.csv").read_text() == "mine\n"
    (project / "data/raw/arm/sent/one.csv").unlink()
    assert fetch(project, "arm").returncode == 0
    assert (project / "data/raw/arm/sent/one.csv").read_text() == "0 1\n"
    assert "there already, left as it is" in fetch(project, "arm").stdout


def test_other_content_than_the_import_file_states_is_refused_and_removed(project: Path, arm: Path) -> None:
    file = project / "imports/arm_model.dvc"
    file.write_text(file.read_text().replace(OmegaConf.load(file).outs[0].md5, "ab" * 16))
    done = fetch(project, "arm")
    assert done.returncode == 2
    assert f"{arm}, arm.urdf: found other content (md5 " in done.stderr and f"expected md5 {'ab' * 16}" in done.stderr
    assert not [path for path in (project / "data/raw").iterdir() if path.name != ".gitignore"]


def test_an_unknown_source_is_told_with_those_that_are_known(project: Path, arm: Path) -> None:
    done = fetch(project, "arn")
    assert done.returncode == 2
    assert "source: found arn; expected one of a1_hardware, arm; did you mean arm?" in done.stderr


def test_make_data_runs_the_stage_and_hands_on_its_exit_code() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert "\ndata: .venv/ready\n\t@python -m stages.fetch\n" in text
