"""Set points that stand in the log: whether they stand in the robot too is told by its motion."""

from pathlib import Path

import numpy as np
import pytest

from leapgap.diagnosis.checks import as_read
from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.checks.held_set_points import HeldSetPoints
from leapgap.logs.held_set_points import hold_of, on_lines
from leapgap.logs.log import Log
from tests.diagnosis import pd_arms
from tests.diagnosis.pd_arms import Truth


def checked(logs: list[Log], folder: Path) -> CheckResult | None:
    return HeldSetPoints().run(logs, pd_arms.robot(folder), HeldSetPoints.threshold)


STRONG = {"delay_s": 0.03, "damping": 0.5, "friction": 0.4, "mass": 1.5, "gains": 1.5}


@pytest.mark.parametrize("effects", [{}, STRONG])
def test_set_points_that_are_coarser_in_the_log_are_read_on_lines(effects: dict, tmp_path: Path) -> None:
    logs = pd_arms.logs(Truth(points_s=0.02, line="ahead", logged_s=0.02, **effects))
    result = checked(logs, tmp_path)
    assert result is not None and not result.passed and result.statistic == pytest.approx(1.0, abs=0.3)
    assert result.says.startswith("set points are held for 4 samples (20 ms) at a time while the robot goes on (")
    assert "to the next one" in result.says or effects
    fine = pd_arms.logs(Truth(points_s=0.02, line="ahead", **effects))
    for read, true in zip(as_read(logs, [result]), fine, strict=True):
        part = slice(0, len(read) - 4)
        off = read["cmd_pos/elbow"][part] - true["cmd_pos/elbow"][part]
        assert effects or np.abs(off).max() < 0.1 * np.abs(np.diff(logs[0]["cmd_pos/elbow"])).max()


def test_a_controller_that_does_not_know_the_next_point_is_late(tmp_path: Path) -> None:
    result = checked(pd_arms.logs(Truth(points_s=0.04, line="late", logged_s=0.04)), tmp_path)
    assert result is not None and not result.passed and "from the one before" in result.says


@pytest.mark.parametrize("effects", [{}, STRONG, {"gains": 4.0}, {"gains": 0.4}])
def test_set_points_that_stand_in_the_robot_too_are_left_as_they_are(effects: dict, tmp_path: Path) -> None:
    """A policy at 50 Hz above a drive at 200 Hz."""
    result = checked(pd_arms.logs(Truth(points_s=0.02, logged_s=0.02, **effects)), tmp_path)
    assert result is not None and result.passed and result.reads is None
    assert result.says.startswith("set points are held for 4 samples (20 ms) at a time")
    assert effects or "and so they do in the robot" in result.says


def test_set_points_of_every_row_are_no_matter(tmp_path: Path) -> None:
    assert checked(pd_arms.logs(number=2), tmp_path) is None


def test_steps_at_odd_times_are_no_held_set_points() -> None:
    log = pd_arms.logs(number=1)[0]
    stairs = np.floor(np.cumsum(np.random.default_rng(1).uniform(0, 0.3, len(log))))
    assert hold_of(pd_arms.changed(log, lambda _: {f"cmd_pos/{joint}": stairs for joint in pd_arms.JOINTS})) is None


def test_lines_go_through_the_set_points_and_end_with_the_last() -> None:
    log = pd_arms.logs(Truth(logged_s=0.02), number=1)[0]
    log = pd_arms.changed(log, lambda columns: {"cmd_vel/base": 0 * columns["time"]})
    read, late = on_lines(log), on_lines(log, late=True)
    held, lines = log["cmd_pos/base"], read["cmd_pos/base"]
    assert np.array_equal(lines[::4], held[::4]) and lines[2] == pytest.approx((held[0] + held[4]) / 2)
    assert np.allclose(late["cmd_pos/base"][4:-4], lines[:-8])
    assert np.array_equal(read["cmd_kp/base"], log["cmd_kp/base"])


def test_a_trajectory_with_its_velocities_is_read_on_cubics() -> None:
    time = np.arange(400) * 0.005
    point = np.floor(time / 0.02 + 1e-6) * 0.02
    log = pd_arms.changed(
        pd_arms.logs(number=1, seconds=2.0)[0],
        lambda _: (
            {f"cmd_pos/{j}": np.sin(9 * point) for j in pd_arms.JOINTS}
            | {f"cmd_vel/{j}": 9 * np.cos(9 * point) for j in pd_arms.JOINTS}
        ),
    )
    read = on_lines(log)
    assert np.abs(read["cmd_pos/elbow"] - np.sin(9 * time))[:-4].max() < 1e-5
    assert np.abs(read["cmd_vel/elbow"] - 9 * np.cos(9 * time))[:-4].max() < 5e-3
