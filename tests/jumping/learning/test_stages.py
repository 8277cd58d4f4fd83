"""The three stages in a row, on synthetic logs and on none."""

import re
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from omegaconf import DictConfig, OmegaConf

from leapgap.errors import InputError
from leapgap.logs import log as jump_module
from leapgap.logs.log import Log
from leapgap.robot.model import DEFAULT_MODEL
from leapgap.runtime.atomic_io import read_json
from stages.chunk import chunk
from stages.compose import compose_conf
from stages.evaluate import evaluate
from stages.train import train
from tests.code import ROOT


def config(folder: Path, **changes: object) -> DictConfig:
    """The defaults of conf/, with folders below ``folder`` and models that are fitted at once."""
    conf = OmegaConf.create(compose_conf())
    sections = {name: conf[name] for name in ("chunk", "train", "evaluate")}
    places = {
        "chunk.logs": folder / "logs",
        "chunk.out": folder / "windows",
        "train.windows": folder / "windows",
        "train.out": folder / "models",
        "train.models": ["nominal", "nominal_fitted", "playback", "kernel"],
        "evaluate.windows": folder / "windows",
        "evaluate.models": folder / "models",
        "evaluate.metrics": folder / "metrics.json",
        "evaluate.out": folder / "predictions",
        "train.curvature": 0.0,  # as the jumps were made
    }
    whole = OmegaConf.create({**sections, "robot": {**conf.robot, "model": str(DEFAULT_MODEL)}})
    for key, value in {**places, **changes}.items():
        OmegaConf.update(whole, key, str(value) if isinstance(value, Path) else value)
    return whole


def run_all(whole: DictConfig) -> None:
    for stage in (chunk, train, evaluate):
        stage(whole)


def write_logs(jumps: list[Log], folder: Path) -> None:
    folder.mkdir()
    for jump in jumps:
        jump_module.write_log(jump, folder / f"{jump.name}.parquet")


def test_logs_become_metrics_and_predictions(jumps, tmp_path):
    write_logs(jumps, tmp_path / "logs")
    whole = config(tmp_path)
    run_all(whole)
    found = read_json(tmp_path / "metrics.json")
    assert (found["jumps"], found["windows"]) == (6, 162)
    assert found["cv_mse"]["nominal_fitted"] < 1e-12 < found["cv_mse"]["playback"]
    assert {path.name for path in (tmp_path / "predictions").iterdir()} == {
        ".leapgap.json",
        "error_by_step.csv",
        "calibration.csv",
        "report.html",
        *(f"{jump.name}.parquet" for jump in jumps),
    }
    models = set(pq.read_table(tmp_path / "predictions" / "jump_00.parquet")["model"].to_pylist())
    assert models == {"measured", "nominal", "nominal_fitted", "playback", "kernel"}

    first = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    run_all(whole)
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == first

    evaluate(config(tmp_path, **{"evaluate.logs": tmp_path / "logs", "evaluate.out": tmp_path / "by_hand"}))
    mse = read_json(tmp_path / "by_hand" / "learning.json")["mse"]
    assert mse["nominal_fitted"] < 1e-12 and set(mse) == {"nominal", "nominal_fitted", "playback", "kernel"}

    other = tmp_path / "other.xml"
    other.write_text(re.sub(r'mass="([0-9.]+)"', r'mass="1\1"', DEFAULT_MODEL.read_text()))
    with pytest.raises(InputError, match="a model for robot_sha256"):
        evaluate(config(tmp_path, **{"evaluate.logs": tmp_path / "logs", "robot.model": other}))


def test_no_logs_keep_the_committed_figures(tmp_path, capsys):
    (tmp_path / "logs").mkdir()
    run_all(config(tmp_path))
    assert read_json(tmp_path / "metrics.json") == {"jumps": 0}
    (tmp_path / "metrics.json").write_text('{"jumps": 16}')
    run_all(config(tmp_path))
    assert (tmp_path / "metrics.json").read_text() == '{"jumps": 16}'
    assert "metrics.json kept" in capsys.readouterr().out


def test_one_jump_is_trained_on_but_cannot_be_judged(jumps, tmp_path):
    write_logs(jumps[:1], tmp_path / "logs")
    run_all(config(tmp_path))
    assert read_json(tmp_path / "metrics.json") == {"jumps": 1, "windows": 27}


def test_judging_needs_no_torch():
    """Trained models are read in NumPy; torch takes seconds to import and is not there at control time."""
    code = "import sys, stages.evaluate, stages.train; sys.exit('torch' in sys.modules or 'lightning' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
