"""The arm that effects are tested on, and a log of it without any effect."""

import pytest

from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.effects import moving_arm as arm


@pytest.fixture(scope="package")
def robot_arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return arm.load(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="package")
def log() -> Log:
    return arm.as_log("nominal", arm.SENT, *arm.simulate(arm.SENT))
