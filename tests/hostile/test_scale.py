"""What a diagnosis leaves out of many logs stands in its report."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from leapgap.diagnosis.diagnose import Settings
from leapgap.logs import stretches
from leapgap.reports.diagnosis import REPORT, diagnose_folder
from leapgap.robot.model import Robot
from tests.code import ROOT


def test_the_report_says_which_logs_were_diagnosed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four logs of 2000 rows, three where 6000 rows are allowed; the effect is found all the same."""
    subprocess.run([sys.executable, str(ROOT / "docs/examples/arm_logs.py"), str(tmp_path)], check=True)
    monkeypatch.setattr(stretches, "MOST_ROWS", 6000)
    settings = Settings(effects=["joint_damping"], folds=2, pieces_per_log=4, bootstrap_draws=50)
    said: list[str] = []
    report = diagnose_folder(tmp_path / "logs", Robot.load(tmp_path / "robot.xml"), settings, said.append)
    assert report is not None
    sentence = "3 of 4 logs, spread evenly over 4 logs, were diagnosed (6000 of 8000 rows)"
    assert said[0].startswith(sentence)
    assert [log.name for log in report.logs] == ["swing_0", "swing_1", "swing_2"]
    report.write(tmp_path)
    written = json.loads((tmp_path / REPORT).read_text())
    assert written["not_judged"][0].startswith(sentence)
    assert sentence in str(report)
    assert sorted(written["provenance"]["logs"]) == ["swing_0", "swing_1", "swing_2", "swing_3"]
    assert report.answer == (("joint_damping",),)
