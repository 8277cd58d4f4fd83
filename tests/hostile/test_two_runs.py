"""Two runs into one output: the second is told who holds it, and nothing of the first is harmed."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import HOST, partial, whole_file, write_text
from leapgap.runtime.output_folder import MARKER, claim_folder, folder_lock, whole_folder
from tests.code import ROOT
from tests.commands import assert_refused, environment, stage
from tests.logs.test_importers import write_published

TEST = "leapgap test"
HOLD = """
import sys, time
from pathlib import Path
from leapgap.runtime.output_folder import whole_folder
with whole_folder(Path(sys.argv[1]), "leapgap test") as folder:
    (folder / "a.txt").write_text("first")
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(out: Path) -> subprocess.Popen:
    """Another process that writes into a folder until its input is closed."""
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(out)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_the_second_of_two_runs_is_told_who_holds_the_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = holder(out)
    says = rf"found another run that writes here: process {first.pid} \(-c\), since \d{{4}}-.* UTC; expected one run"
    with pytest.raises(InputError, match=says), whole_folder(out, TEST):
        pass
    first.communicate("")
    assert first.returncode == 0
    assert (out / "a.txt").read_text() == "first"
    with whole_folder(out, TEST) as folder:  # and now it is free
        (folder / "a.txt").write_text("second")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_killed_run_holds_nothing_and_what_it_left_is_cleared(tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = holder(out)
    first.kill()
    first.wait()
    assert len(list(tmp_path.glob(".out.*.partial"))) == 1
    with whole_folder(out, TEST) as folder:
        (folder / "a.txt").write_text("second")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_folder_of_the_users_that_looks_like_a_partial_one_is_kept(tmp_path: Path) -> None:
    mine = [tmp_path / ".out.partial", partial(tmp_path / "out")]
    for folder in mine:
        folder.mkdir()
        (folder / "thesis.txt").write_text("mine")
    with whole_folder(tmp_path / "out", TEST) as folder:
        (folder / "a.txt").write_text("1")
    assert all((folder / "thesis.txt").read_text() == "mine" for folder in mine)


def test_an_output_that_a_killed_run_had_moved_away_comes_back(tmp_path: Path) -> None:
    """The kill falls between the two renames that replace an output."""
    out = tmp_path / "out"
    with whole_folder(out, TEST) as folder:
        (folder / "a.txt").write_text("1")
    out.rename(partial(out).with_name(partial(out).name.removesuffix(".partial") + ".replaced.partial"))
    with pytest.raises(RuntimeError), whole_folder(out, TEST):
        raise RuntimeError
    assert (out / "a.txt").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_imports_into_one_folder(tmp_path: Path, robot: Robot) -> None:
    for i in range(12):
        write_published(tmp_path / "raw" / str(i + 1), robot)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "stages.import_logs", f"import_logs.source={tmp_path / 'raw'}"]
    both = [
        subprocess.Popen([*command, f"import_logs.out={out}"], cwd=ROOT, env=environment(), stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    said = [process.communicate()[1].decode() for process in both]
    codes = [process.returncode for process in both]
    assert len(list(out.glob("*.parquet"))) == 12
    assert 0 in codes and set(codes) <= {0, 2}
    assert all("another run that writes here: process" in text for text, code in zip(said, codes, strict=True) if code)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "raw"]


def test_a_stage_holds_a_folder_that_it_adds_to(tmp_path: Path) -> None:
    """Also one that keeps its results, and from before the work on: here by its first message."""
    out = tmp_path / "models"
    with folder_lock(out):
        refused = stage("train", f"train.out={out}", f"train.windows={tmp_path / 'windows'}")
    assert_refused(refused, f"{out}: found another run that writes here: process {os.getpid()}")


@pytest.mark.parametrize("is_windows", [False, True])
def test_a_folder_is_free_when_the_last_block_that_holds_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_windows: bool
) -> None:
    """Whichever began first: a thread may outlast the one that took the folder."""
    if is_windows:
        monkeypatch.setattr("leapgap.runtime.output_folder.fcntl", None)
    first, second = folder_lock(tmp_path / "out"), folder_lock(tmp_path / "out")
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert (tmp_path / ".out.lock").exists()
    second.__exit__(None, None, None)
    assert not list(tmp_path.iterdir())


def test_files_of_two_threads_at_one_place_are_whole(tmp_path: Path) -> None:
    texts = ["a" * 200_000, "b" * 200_000]
    threads = [
        threading.Thread(target=lambda text=text: [write_text(tmp_path / "file", text) for _ in range(40)])  # type: ignore[misc]
        for text in texts
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if (tmp_path / "file").exists():
            assert (tmp_path / "file").read_text() in texts
        time.sleep(0.001)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_temporary_files_of_dead_processes_are_cleared_and_of_living_ones_kept(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left, living, of_another_machine = (
        tmp_path / f".file.{host}-{pid}-0123abcd.partial"
        for host, pid in ((HOST, dead.pid), (HOST, os.getpid()), ("elsewhere", dead.pid))
    )
    for path in (left, living, of_another_machine):
        path.write_text("half")
    with whole_file(tmp_path / "file") as beside:
        beside.write_text("whole")
    assert not left.exists()
    assert living.exists() and of_another_machine.exists()


def test_temporary_files_in_a_kept_folder_are_cleared_when_it_is_taken(tmp_path: Path) -> None:
    """They would otherwise become part of an output, whose bytes would then depend on the kill."""
    out = tmp_path / "models"
    claim_folder(out, TEST)
    (out / ".splits.json.elsewhere-12-0123abcd.partial").write_text("half")
    claim_folder(out, TEST)
    assert [path.name for path in out.iterdir()] == [MARKER]
