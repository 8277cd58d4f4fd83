"""Curves of the page of landings."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.reports.landing import mean_over_steps, times
from leapgap.robot.model import Robot
from tests.conftest import standing


@pytest.mark.parametrize("rate_hz", [1000, 400, 200])
def test_curves_are_means_over_5_ms_at_any_rate(robot: Robot, rate_hz: int) -> None:
    still = standing(robot, rate_hz)
    log = replace(still, info=replace(still.info, sample_period_s=1 / rate_hz))
    values = mean_over_steps(np.arange(rate_hz, dtype=float)[:, None], log)
    assert values.shape == (200, 1)
    assert np.diff(values[:, 0]) == pytest.approx(rate_hz * 0.005)
    assert np.diff(times(log, 200)) == pytest.approx(0.005, abs=1.1e-4)  # rounded to 0.1 ms
