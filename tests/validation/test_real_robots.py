"""The table of real robots: what counts as right, and that absent data are left out."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.report import Cause, ParameterEstimate
from leapgap.validation.real_robots import RealCase, is_expected, is_here, outcome_of
from tests.code import ROOT

FRICTION = {"joint_friction": {"torque_nm": [-0.1, 0.9]}}


def cause(effect: str, **values: float) -> Cause:
    """A cause with these values."""
    numbers = {name: ParameterEstimate(value, (value, value), 0.0, "1", False) for name, value in values.items()}
    return Cause(effect, "all", 1.0, numbers, {}, Interval(1, 1, 1), 0.1, ())


@pytest.mark.parametrize(
    ("found", "right"),
    [
        (cause("joint_friction", torque_nm=0.5), True),
        (cause("joint_friction", torque_nm=1.5), False),
        (cause("joint_damping", damping=0.5), False),
    ],
)
def test_a_cause_is_right_if_it_is_listed_with_its_value_in_the_range(found: Cause, right: bool) -> None:
    assert is_expected(found, FRICTION) is right
    assert not is_expected(found, {})


def test_a_case_without_a_published_answer_is_neither_right_nor_false() -> None:
    """Whatever is named; a case whose answer is to name nothing is another matter."""
    named = cause("joint_friction", torque_nm=0.5)
    content = SimpleNamespace(
        causes=(named,), answer=(("joint_friction",),), closure_of_answer=None, verdict="named", gap_nominal=1.0
    )
    content.headline, content.gap_per_log = SimpleNamespace(horizon_s=None), {}
    case = RealCase("arm", "logs", "robot.xml", "nothing", None, False)
    for expected, right, false_name in ((None, None, False), ({}, False, True), (FRICTION, True, False)):
        row = outcome_of(replace(case, expected=expected), content, 1.0)
        assert (row["right"], row["false_name"]) == (right, false_name)


def test_a_case_is_left_out_where_its_files_are_absent(tmp_path: Path) -> None:
    case = RealCase("acrobot", "logs", "robot.xml", "nothing", {}, False)
    assert not is_here(case, tmp_path)
    (tmp_path / "logs").mkdir()
    assert not is_here(case, tmp_path)
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    assert is_here(case, tmp_path) and not is_here(replace(case, source="others"), tmp_path)


def test_without_any_data_the_stage_says_so_and_writes_no_metrics(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "stages.robots",
        f"robots.raw={tmp_path / 'raw'}",
        f"robots.out={tmp_path / 'out'}",
    ]
    command += [f"robots.metrics={tmp_path / 'metrics.json'}", f"hydra.run.dir={tmp_path / 'run'}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("left out") == 6
    assert not (tmp_path / "metrics.json").exists()
