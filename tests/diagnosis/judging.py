"""Diagnoses without their proposal of the next experiment."""

from collections.abc import Sequence

import pytest

from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


def judge(logs: Sequence[Log], robot: Robot, settings: Settings) -> Diagnosis:
    """The diagnosis of logs without its proposal, which takes up to a third of the time, where no test looks at it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leapgap.diagnosis.diagnose.propose", lambda *_: None)
        return diagnose(logs, robot, settings)
