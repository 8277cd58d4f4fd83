"""Curves of the page of landings."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.reports.landing import forces, joints, mean_over_steps, times
from leapgap.logs.log import Log
from leapgap.logs.metadata import Segment
from leapgap.logs.schema import PAIR_FORCE_AXES
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


def test_methods_are_compared_from_where_their_jumps_begin(robot: Robot, hop: Log) -> None:
    """One stands for 0.3 s and then does what the other does at once."""
    sources = [f"{source}/{axis}" for source in ("ground_force", "mpc_force") for axis in PAIR_FORCE_AXES]
    at_once = replace(hop, columns=dict(hop.columns) | dict.fromkeys(sources, 100 * hop["base_pos_z"]))
    stood = 300
    columns = {name: np.concatenate([np.full(stood, values[0]), values]) for name, values in at_once.columns.items()}
    columns["time"] = np.arange(stood + len(hop)) / 1000
    stands = (Segment("stand", 0.0, 0.3), Segment("double_contact", 0.3, 9.0))
    stood_first = Log("stands", columns, replace(hop.info, stated_segments=stands))
    logs = {("jump_60", "joint_pd"): at_once, ("jump_60", "ours"): stood_first}
    for figure in (joints(logs), forces(logs)):
        half = len(figure.data) // 2
        for early, late in zip(figure.data[:half], figure.data[half:], strict=True):
            moving = late.x > 0
            assert late.x[0] == pytest.approx(-0.2975)
            assert late.x[moving] == pytest.approx(early.x)
            assert late.y[moving] == pytest.approx(early.y, nan_ok=True)
