"""More torque asked than the model gives: told with rows, joints and numbers, and whether the robot delivered it."""

from pathlib import Path

import pytest

from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.checks.torque_limits import TorqueLimits
from tests.diagnosis import pd_arms
from tests.diagnosis.pd_arms import Truth


def checked(truth: Truth, folder: Path, torque: bool = False) -> CheckResult:
    result = TorqueLimits().run(pd_arms.logs(truth, torque=torque), pd_arms.robot(folder, limit=8.0), 0.5)
    assert result is not None
    return result


@pytest.mark.parametrize("torque", [False, True])
@pytest.mark.parametrize("effects", [{}, {"damping": 0.5, "friction": 0.3, "mass": 1.3}])
def test_a_robot_that_gives_more_than_its_model_says_so(torque: bool, effects: dict, tmp_path: Path) -> None:
    result = checked(Truth(size=0.8, **effects), tmp_path, torque)
    assert not result.passed and result.statistic == pytest.approx(1.0, abs=0.4)
    assert "% of the samples command more torque than the model's limit: " in result.says
    assert "of 8 N·m at most" in result.says and "the model's limit is too low" in result.says
    assert f"by the {'measured torque' if torque else 'motion'} the robot delivered it" in result.says
    assert max(result.per_log.values()) > 0.02


@pytest.mark.parametrize("torque", [False, True])
def test_a_robot_that_is_limited_as_its_model_is(torque: bool, tmp_path: Path) -> None:
    result = checked(Truth(size=0.8, limit=8.0), tmp_path, torque)
    assert result.passed and "the robot did not deliver it" in result.says


def test_nothing_asked_beyond_a_limit(tmp_path: Path) -> None:
    result = TorqueLimits().run(pd_arms.logs(number=2), pd_arms.robot(tmp_path), 0.5)
    assert result is not None and result.passed
    assert result.says == "no sample commands more torque than the model's limit"
