"""Kills, Ctrl-C, full disks and folders that nobody may write to."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from leapgap.robot.model import Robot
from leapgap.runtime.executor import Executor
from tests.code import ROOT
from tests.commands import assert_refused, environment, python
from tests.hostile.kills import (
    CALLS,
    ORPHAN_S,
    SOON_S,
    Running,
    command,
    files,
    kill_and_resume,
    prepare,
    run,
)
from tests.logs.test_importers import write_published

pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are listed by /proc")
BY_NAME = {call.name: call for call in CALLS}
FAST = ("collect", "withhold")
"""Stages that are killed in the suite; ``make hostile`` kills all."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    prepare(folder, ("collect", "train", "withhold"))
    return folder


@pytest.mark.long
@pytest.mark.parametrize("name", FAST)
def test_a_killed_stage_leaves_no_worker_and_no_half_output(name: str, inputs: Path, tmp_path: Path) -> None:
    call = BY_NAME[name]
    run(call, inputs, tmp_path / "whole" / "out")
    expected = files(tmp_path / "whole" / "out")
    tally = kill_and_resume(call, inputs, tmp_path / "killed", expected, 0.1)
    assert tally.kills == 1, "the stage ended before it was killed"
    assert (tally.orphans, tally.partial_visible, tally.bytes_differ) == (0, 0, 0)


@pytest.mark.parametrize("after_s", [0.0, 0.4])
def test_workers_that_are_still_starting_end_with_their_parent(after_s: float, inputs: Path, tmp_path: Path) -> None:
    """They import the stage for seconds before they run anything that they are given."""
    running = Running(BY_NAME["collect"], inputs, tmp_path / "out")
    try:
        assert running.wait_for(1)
        time.sleep(after_s)
        running.process.kill()
        running.process.wait()
        assert running.left_after(ORPHAN_S) == []
    finally:
        running.kill_all()


@pytest.mark.long
@pytest.mark.parametrize(("name", "after_s"), [("collect", 0.2), ("collect", 2.0), ("train", 0.2), ("train", 2.0)])
def test_ctrl_c_ends_a_stage_and_its_workers_with_one_line(
    name: str, after_s: float, inputs: Path, tmp_path: Path
) -> None:
    """While the workers start, and while they work."""
    call = BY_NAME[name]
    running = Running(call, inputs, tmp_path / "out")
    try:
        assert running.wait_for(call.workers)
        time.sleep(after_s)
        assert_stops(running, f"stages.{name}: stopped by Ctrl-C; {tmp_path / 'out'} ")
    finally:
        running.kill_all()
    assert not list(tmp_path.glob(".*")), "a lock or a temporary folder was left"


def assert_stops(running: Running, says: str) -> None:
    """Ctrl-C goes to every process of the terminal's foreground."""
    began = time.monotonic()
    os.killpg(running.process.pid, signal.SIGINT)
    _, said = running.process.communicate(timeout=30)
    assert time.monotonic() - began < SOON_S
    assert running.process.returncode == 130
    assert said.startswith(says) and len(said.splitlines()) == 1, said
    assert running.left_after(1.0) == []


def test_ctrl_c_in_a_training_without_workers(inputs: Path, tmp_path: Path) -> None:
    """Lightning catches ``KeyboardInterrupt`` itself."""
    call = BY_NAME["train"]
    alone = type(call)("train", (*call.arguments, "train.processes=1", "train.networks.fitting.steps=100000"), 0)
    running = Running(alone, inputs, tmp_path / "out")
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.rglob("last.ckpt")) and time.monotonic() < deadline:
            time.sleep(0.05)
        says = f"stages.train: stopped by Ctrl-C; {tmp_path / 'out'} keeps what is finished: run again to go on"
        assert_stops(running, says)
    finally:
        running.kill_all()


@pytest.mark.parametrize("after_s", [0.0, 0.5])
def test_ctrl_c_while_a_stage_is_imported(after_s: float, inputs: Path, tmp_path: Path) -> None:
    """From the moment on at which the package of the stages is there, which has a second thread."""
    running = Running(BY_NAME["collect"], inputs, tmp_path / "out")
    try:
        threads = Path(f"/proc/{running.process.pid}/task")
        while len(list(threads.iterdir())) < 2:
            time.sleep(0.01)
        time.sleep(after_s)
        assert_stops(running, "stages.collect: stopped by Ctrl-C; ")
    finally:
        running.kill_all()


@pytest.mark.parametrize("name", ["collect", "train"])
def test_a_worker_that_a_busy_machine_never_lets_run_ends_with_its_parent(
    name: str, inputs: Path, tmp_path: Path
) -> None:
    """It is stopped before it has run a line of ours, so that only others can end it."""
    running = Running(BY_NAME[name], inputs, tmp_path / "out")
    try:
        while not (workers := [pid for pid in running.workers() if is_told_its_parent(pid)]):
            assert running.process.poll() is None
            time.sleep(0.002)
        for pid in workers:
            os.kill(pid, signal.SIGSTOP)
        running.process.kill()
        running.process.wait()
        assert running.left_after(ORPHAN_S) == []
    finally:
        running.kill_all()


def is_told_its_parent(pid: int) -> bool:
    """Whether a process has left its fork and has the environment of a worker."""
    try:
        return b"LEAPGAP_PARENT=" in Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:
        return False


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw")
    write_published(folder / "3", Robot.load())
    return folder


def import_logs(raw: Path, out: Path, most_bytes: int | None = None) -> subprocess.CompletedProcess:
    arguments = (f"import_logs.source={raw}", f"import_logs.out={out}")
    return python("-m", "stages.import_logs", *arguments, most_bytes=most_bytes)


def test_a_full_disk_is_a_message_that_says_what_was_kept(raw: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert import_logs(raw, out).returncode == 0
    before = files(out)
    assert_refused(import_logs(raw, out, 50_000), "File too large", f"{out} is as it was")
    assert files(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.filterwarnings("error")
def test_work_of_others_that_an_error_leaves_unused_is_no_warning() -> None:
    """A disk that is full while workers go on is one message; joblib would say how many results are lost."""
    results = Executor("joblib", 2).map(abs, [-1, -2, -3, -4])
    assert next(results) == 1
    results.close()  # type: ignore[attr-defined]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_nobody_may_write_to_is_a_message(raw: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert_refused(import_logs(raw, tmp_path / "out"), f"{tmp_path / 'out'}", "Permission denied")
    tmp_path.chmod(0o700)


@pytest.mark.long
def test_a_reader_that_has_enough_ends_a_stage_without_a_traceback(raw: Path, tmp_path: Path) -> None:
    running = subprocess.Popen(
        command(BY_NAME["collect"], tmp_path, tmp_path / "out"),
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert running.stdout is not None and running.stderr is not None
    running.stdout.close()
    assert "Traceback" not in running.stderr.read()
    assert running.wait() == 2
