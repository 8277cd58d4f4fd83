"""What identification compares of a motion."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.experiments.identification import difference
from leapgap.robot.model import Robot
from tests.conftest import standing


@pytest.mark.parametrize(("rate_hz", "instants"), [(1000, 50), (500, 50), (200, 50)])
def test_motions_are_compared_every_20_ms_at_any_rate(robot: Robot, rate_hz: int, instants: int) -> None:
    still = standing(robot, rate_hz)
    columns = dict(still.columns) | {"time": np.arange(rate_hz) / rate_hz}
    log = replace(still, columns=columns, info=replace(still.info, sample_period_s=1 / rate_hz))
    qpos = np.tile(robot.model.qpos0, (rate_hz, 1))
    assert len(difference(qpos, log, robot)) == (3 + len(robot.joints)) * instants
