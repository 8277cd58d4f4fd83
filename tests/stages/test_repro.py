"""The line of progress of ``make run``: what runs, what is left, and for how long; nothing where nobody looks."""

import io
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stages.repro import Progress, follow, in_words, stage_names
from tests.code import ROOT
from tests.project import DVC, environment

PIPELINE = """stages:
  first:
    cmd: echo one > one.txt
    outs: [one.txt]
  each:
    foreach: {a: 1, b: 2}
    do:
      cmd: sleep 1.3 && echo ${item} > ${key}.txt
      deps: [one.txt]
      outs: ['${key}.txt']
"""


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def progress() -> tuple[Progress, Clock]:
    clock = Clock()
    return Progress(("params", "train@a", "train@b", "land"), {"train@a": 30, "train@b": 40, "land": 200}, clock), clock


def test_the_line_says_what_runs_and_what_the_rest_takes(progress: tuple[Progress, Clock]) -> None:
    now, clock = progress
    now.read("Stage 'params' didn't change, skipping\n")
    now.read("Running stage 'train@a':\n")
    clock.now = 12
    assert now.line == "train@a for 12 s · 1 done, 2 left · at most 4 min"  # 18 + 40 + 200 s
    now.read("Running stage 'train@b':\n")
    clock.now = 72  # 60 s in train@b, longer than it once took: it may end at any time
    assert now.line == "train@b for 60 s · 2 done, 1 left · at most 3 min"
    assert now.taken == {"train@a": 12}


def test_a_stage_from_the_cache_is_done_and_leaves_no_time(progress: tuple[Progress, Clock]) -> None:
    now, clock = progress
    clock.now = 5
    now.read("Stage 'land' is cached - skipping run, checking out outputs\n")
    assert now.done == {"land"} and now.taken == {} and now.running is None
    assert now.line == "between stages · 1 done, 3 left · at most 70 s"


def test_without_known_times_it_promises_none() -> None:
    assert Progress(("a", "b"), {}, Clock()).line == "between stages · 0 done, 2 left"


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0 s"), (99, "99 s"), (100, "2 min"), (4800, "1 h 20 min")])
def test_times_are_as_exact_as_a_person_reads_them(seconds: float, text: str) -> None:
    assert in_words(seconds) == text


def test_every_stage_of_the_pipeline_is_counted() -> None:
    listed = subprocess.run(
        [DVC, "stage", "list", "--name-only"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        env=environment(ROOT),
    )
    assert set(stage_names(ROOT / "dvc.yaml")) == set(listed.stdout.split())


def test_output_without_a_terminal_is_passed_on_as_it_is(progress: tuple[Progress, Clock]) -> None:
    screen, said = io.StringIO(), ["Running stage 'train@a':\n", "> python\n", "fold 1\n"]
    follow(said, progress[0], screen, lines=False)
    assert screen.getvalue() == "".join(said)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pipeline")
    (folder / "dvc.yaml").write_text(PIPELINE)
    subprocess.run([DVC, "init", "-q", "--no-scm"], cwd=folder, check=True, env=environment(ROOT))
    return folder


def on_a_terminal(folder: Path) -> tuple[int, str]:
    """``python -m stages.repro`` with a terminal of 60 columns as its output: exit code and all that it wrote."""
    mine, its = pty.openpty()
    own = environment(ROOT) | {"PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}", "COLUMNS": "60"}
    run = subprocess.Popen([sys.executable, "-m", "stages.repro"], cwd=folder, env=own, stdout=its, stderr=its)
    os.close(its)
    said = b""
    while True:
        try:
            chunk = os.read(mine, 4096)
        except OSError:  # all who wrote have ended
            break
        if not chunk:
            break
        said += chunk
    os.close(mine)
    return run.wait(), said.decode()


def test_on_a_terminal_one_line_is_drawn_and_gone_at_the_end(project: Path) -> None:
    code, said = on_a_terminal(project)
    assert code == 0
    drawn = re.findall(r"\r\x1b\[K([^\r\n]*for \d+ s[^\r\n]*)", said)
    assert any(
        line.startswith("each@a for 1 s · 1 done, 1 left") or line.startswith("each@b for 1 s") for line in drawn
    )
    assert said.endswith("\r\x1b[K"), "the line stays behind"
    times = (project / ".dvc/tmp/stage_seconds.json").read_text()
    assert set(re.findall(r'"([\w@]+)"', times)) == {"first", "each@a", "each@b"}
    (project / "a.txt").unlink()
    code, said = on_a_terminal(project)  # restored, so that nothing is measured
    assert code == 0 and (project / ".dvc/tmp/stage_seconds.json").read_text() == times


def test_a_stage_that_fails_gives_its_exit_code_and_message(project: Path, tmp_path: Path) -> None:
    (tmp_path / "dvc.yaml").write_text("stages:\n  wrong:\n    cmd: echo no logs there >&2; exit 2\n")
    own = environment(ROOT) | {"PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}"}
    subprocess.run([DVC, "init", "-q", "--no-scm"], cwd=tmp_path, check=True, env=own)
    done = subprocess.run([sys.executable, "-m", "stages.repro"], cwd=tmp_path, env=own, capture_output=True, text=True)
    assert done.returncode not in (0, None)
    assert "no logs there" in done.stdout and "\x1b[K" not in done.stdout


@pytest.mark.parametrize(
    ("pipeline", "path", "says"),
    [
        (None, None, "dvc.yaml: found no such file; expected the stages of a pipeline; run it in the project's folder"),
        ("stages: [", None, "dvc.yaml: found no stages ("),
        ("[1]", None, "dvc.yaml: found no stages ("),
        ("stages: {}", "/nowhere", "dvc: found no such program; "),
    ],
)
def test_what_cannot_run_is_one_message(tmp_path: Path, pipeline: str | None, path: str | None, says: str) -> None:
    if pipeline is not None:
        (tmp_path / "dvc.yaml").write_text(pipeline)
    own = environment(ROOT) | {"PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}"} | ({"PATH": path} if path else {})
    done = subprocess.run([sys.executable, "-m", "stages.repro"], cwd=tmp_path, env=own, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith(f"stages.repro: {says}") and len(done.stderr.splitlines()) == 1
