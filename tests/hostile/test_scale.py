"""What a diagnosis leaves out of many logs stands in its report, and takes no memory."""

import gc
import json
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import pytest

from leapgap import api
from leapgap.diagnosis.settings import Settings
from leapgap.logs import cutting
from leapgap.logs.log import Log, read_log
from leapgap.logs.reading import Readings, read_folder
from leapgap.reports import diagnosis as reports
from leapgap.reports.diagnosis import REPORT, diagnose_folder
from leapgap.robot.model import Robot
from tests import plain_arm
from tests.code import ROOT


def test_the_report_says_which_logs_were_diagnosed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four logs of 2000 rows, three where 6000 rows are allowed; the effect is found all the same."""
    subprocess.run([sys.executable, str(ROOT / "docs/examples/arm_logs.py"), str(tmp_path)], check=True)
    monkeypatch.setattr(cutting, "MOST_ROWS", 6000)
    settings = Settings(effects=["joint_damping"], folds=2, pieces_per_log=4, bootstrap_draws=50)
    said: list[str] = []
    report = diagnose_folder(tmp_path / "logs", Robot.load(tmp_path / "robot.xml"), settings, said.append)
    assert report is not None
    sentence = "3 of 4 logs, spread evenly over 4 logs, were diagnosed (6000 of 8000 samples)"
    assert said[0].startswith(sentence)
    assert [log.name for log in report.logs] == ["swing_0", "swing_1", "swing_2"]
    report.write(tmp_path)
    written = json.loads((tmp_path / REPORT).read_text())
    assert written["not_judged"][0].startswith(sentence)
    assert sentence in str(report)
    assert sorted(written["provenance"]["logs"]) == ["swing_0", "swing_1", "swing_2", "swing_3"]
    assert report.answer == (("joint_damping",),)


def test_logs_that_are_not_diagnosed_leave_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five hundred jumps are more than a gigabyte; a diagnosis takes forty of them."""
    folder, model = plain_arm.write_parquet(tmp_path / "logs", logs=4), plain_arm.write_model(tmp_path)
    monkeypatch.setattr(cutting, "MOST_ROWS", 4000)
    read: dict[str, weakref.ref[Log]] = {}
    alive: list[str] = []

    def reading(*arguments: Any) -> Readings:
        readings = read_folder(*arguments)
        read.update({log.name: weakref.ref(log) for log in readings.logs})
        return readings

    def diagnosis(*_: object) -> None:
        gc.collect()
        alive.extend(name for name, log in read.items() if log() is not None)
        raise KeyboardInterrupt

    monkeypatch.setattr(reports, "read_folder", reading)
    monkeypatch.setattr(reports, "diagnose", diagnosis)
    with pytest.raises(KeyboardInterrupt):
        api.diagnose(folder, model)
    assert len(read) == 4 and alive == ["swing_0", "swing_2"]


def test_a_log_takes_no_more_memory_than_its_values(tmp_path: Path) -> None:
    """Arrays of a Parquet table lie in buffers that are twice as large."""
    log = read_log(next(plain_arm.write_parquet(tmp_path, logs=1).glob("*.parquet")))
    assert all(values.flags.owndata and not values.flags.writeable for values in log.columns.values())
