"""What users of DVC do all day, on a small project: experiments, queues, differences, plots, remotes."""

import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from tests.code import ROOT
from tests.project import DVC, environment
from tests.reports.browser import DESKTOP, Browser, needs_chromium

PIPELINE = """stages:
  score:
    cmd: python score.py
    deps: [score.py]
    params: [score]
    outs: [curves.csv]
    metrics:
      - metrics.json: {cache: false}
artifacts:
  curves: {path: curves.csv, type: model}
plots:
  - learning curves:
      template: curves
      x: step
      y: {curves.csv: validation_loss}
"""
SCORE = """import json, yaml
gain = yaml.safe_load(open("params.yaml"))["score"]["gain"]
rows = [f"{model},{fold},{step},{gain / step},{gain / step}" for model in "ab" for fold in (0, 1) for step in (1, 2, 3)]
open("curves.csv", "w").write("model,split,step,train_loss,validation_loss\\n" + "\\n".join(rows))
json.dump({"error": 2.0 * gain}, open("metrics.json", "w"))
"""


class Small:
    """A git repository with one stage."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "dvc.yaml").write_text(PIPELINE)
        (folder / "score.py").write_text(SCORE)
        (folder / "params.yaml").write_text("score:\n  gain: 1.0\n")
        self.run("git", "init", "-q", "-b", "main")
        self.run(DVC, "init", "-q")
        (folder / ".dvc/plots").mkdir(exist_ok=True)
        for path in (ROOT / ".dvc/plots").glob("*.json"):
            (folder / ".dvc/plots" / path.name).write_text(path.read_text())
        self.run(DVC, "repro", "-q")
        self.commit("start")

    def run(self, *command: str, code: int | None = 0) -> str:
        identity = {
            f"GIT_{who}_{what}": "tester@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
        }
        own = environment(ROOT) | identity | {"PYTHONPATH": f"{os.environ.get('PYTHONPATH', '')}{os.pathsep}{ROOT}"}
        done = subprocess.run(command, cwd=self.folder, env=own, capture_output=True, text=True)
        assert code is None or done.returncode == code, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout + done.stderr

    def commit(self, message: str) -> None:
        self.run("git", "add", "-A")
        self.run("git", "commit", "-q", "-m", message)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    return Small(tmp_path_factory.mktemp("small"))


@pytest.mark.long
def test_experiments_one_by_one_and_from_a_queue_stand_in_one_table(small: Small) -> None:
    small.run(DVC, "exp", "run", "-n", "double", "-S", "score.gain=2.0")
    small.run("git", "checkout", "-q", ".")
    small.run(DVC, "exp", "run", "--queue", "-n", "third", "-S", "score.gain=3.0")
    small.run(DVC, "exp", "run", "--queue", "-n", "fourth", "-S", "score.gain=4.0")
    small.run(DVC, "exp", "run", "--run-all")
    shown = {row["Experiment"]: row for row in csv_rows(small.run(DVC, "exp", "show", "--csv"))}
    assert {name: float(shown[name]["error"]) for name in ("double", "third", "fourth")} == {
        "double": 4.0,
        "third": 6.0,
        "fourth": 8.0,
    }


def csv_rows(text: str) -> list[dict[str, str]]:
    lines = [line.split(",") for line in text.splitlines() if "," in line]
    return [dict(zip(lines[0], line, strict=False)) for line in lines[1:]]


def test_params_and_metrics_tell_what_a_change_did(small: Small) -> None:
    small.run("git", "checkout", "-q", ".")
    (small.folder / "params.yaml").write_text("score:\n  gain: 5.0\n")
    small.run(DVC, "repro", "-q")
    (params,) = json.loads(small.run(DVC, "params", "diff", "--json"))["params.yaml"].items()
    assert params == ("score.gain", {"old": 1.0, "new": 5.0, "diff": 4.0})
    assert json.loads(small.run(DVC, "metrics", "diff", "--json"))["metrics.json"]["error"]["diff"] == 8.0


@pytest.mark.skipif(not find_spec("vl_convert"), reason="no vl-convert-python: pip install -e '.[plots]'")
@needs_chromium
def test_plots_open_without_a_network_and_show_the_curves(small: Small, tmp_path: Path) -> None:
    for what in (["show"], ["diff", "HEAD"]):
        small.run(sys.executable, "-m", "stages.plots", *what)
        page = small.folder / "plots" / "index.html"
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<script[^>]*\ssrc=", text)
        assert "learning curves" in text and "validation_loss" in text
    before, end, after = text.rpartition("</head>")
    page.write_text(f"{before}<script>leapgap = {{ready: null}}</script>{end}{after}", encoding="utf-8")
    script = """(async () => { await new Promise((go) => setTimeout(go, 1500));
      return { drawn: document.querySelectorAll("canvas, svg.marks").length }; })()"""
    assert Browser(DESKTOP).evaluate(page, script, tmp_path)["drawn"] > 0


def test_without_vega_it_says_what_to_install(small: Small) -> None:
    hide = "import runpy, sys; sys.modules['vl_convert'] = None; sys.argv = ['plots']; "
    said = small.run(sys.executable, "-c", f"{hide}runpy.run_module('stages.plots', run_name='__main__')", code=2)
    assert "found no package vl-convert-python" in said and "'.[plots]'" in said


def test_a_remote_in_a_local_folder_brings_a_second_clone_its_data(small: Small, tmp_path: Path) -> None:
    small.run("git", "checkout", "-q", ".")
    small.run(DVC, "checkout", "-q")
    small.run(DVC, "remote", "add", "-d", "-f", "store", str(tmp_path / "store"))
    small.run(DVC, "push", "-q")
    small.commit("a remote")
    small.run("git", "clone", "-q", str(small.folder), str(tmp_path / "clone"))
    assert not (tmp_path / "clone/curves.csv").exists()
    small.run(DVC, "--cd", str(tmp_path / "clone"), "pull", "-q")
    assert (tmp_path / "clone/curves.csv").read_bytes() == (small.folder / "curves.csv").read_bytes()


def test_an_artifact_is_fetched_by_its_name_from_the_commit_that_a_tag_names(small: Small, tmp_path: Path) -> None:
    small.run("git", "tag", "-a", "curves@v1.0.0", "-m", "the first")
    small.run(DVC, "artifacts", "get", str(small.folder), "curves", "-o", str(tmp_path / "fetched.csv"))
    small.run(DVC, "get", str(small.folder), "curves.csv", "-o", str(tmp_path / "by_path.csv"))
    assert (tmp_path / "fetched.csv").read_bytes() == (small.folder / "curves.csv").read_bytes()
    assert (tmp_path / "by_path.csv").read_bytes() == (small.folder / "curves.csv").read_bytes()


def test_artifacts_are_outputs_of_the_pipeline() -> None:
    text = (ROOT / "dvc.yaml").read_text()
    artifacts, variants = yaml.safe_load(text)["artifacts"], OmegaConf.load(ROOT / "params.yaml").variants
    assert artifacts
    for name, one in artifacts.items():
        assert re.fullmatch(r"[a-z0-9-]+", name) and one["desc"]
        folder = one["path"].split("/")
        stage = {"models": "train", "reports": "diagnose"}[folder[1]]  # stage report runs on what is diagnosed
        assert folder[2] in variants[stage]
