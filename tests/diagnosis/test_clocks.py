"""Clocks of logs that cannot tell the time: too short, or nothing moves."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import leapgap as lg
from leapgap.diagnosis.checks import clock_of, run_checks
from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.checks.clocks import clock_scale, local_clock, local_clocks
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.conftest import standing

CLOCKS = ("joint_clock", "even_clock", "base_clock")


def swinging(robot: Robot, true_over_claimed: float = 1.0, rows: int = 600, name: str = "swinging") -> Log:
    """A log at 1 kHz whose joints and base move as sines, in time that runs at another pace than the log claims."""
    still = standing(robot, rows)
    phase = 2 * np.pi * np.arange(rows) * 0.001 * true_over_claimed
    position, velocity = 0.3 * np.sin(phase), 0.3 * 2 * np.pi * np.cos(phase)
    columns = dict(still.columns)
    for joint in robot.joints:
        columns |= {f"joint_pos/{joint}": position, f"joint_vel/{joint}": velocity}
    for axis in "xz":
        columns |= {f"base_pos_{axis}": position, f"base_linvel_{axis}": velocity}
    return replace(still, name=name, columns=columns)


def results(logs: list[Log], robot: Robot) -> dict[str, CheckResult]:
    """The results of the clocks; any warning, such as one of a division by zero, is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = {check.name: check for check in run_checks(logs, robot, {})}
    return {name: found[name] for name in CLOCKS if name in found}


@pytest.mark.parametrize("rows", [600, 21, 20, 2])
def test_logs_in_which_nothing_moves_have_no_clock(robot: Robot, rows: int) -> None:
    assert results([standing(robot, rows)], robot) == {}


@pytest.mark.parametrize("rows", [20, 2])
def test_logs_shorter_than_the_span_of_the_regression_have_no_clock(robot: Robot, rows: int) -> None:
    moving = swinging(robot, rows=rows)
    assert results([moving], robot) == {} and local_clocks([moving], robot) is None


def test_a_still_log_is_left_out_of_the_clocks_of_the_others(robot: Robot) -> None:
    logs = [swinging(robot, 1.07), standing(robot, 600), swinging(robot, 1.07, rows=10, name="short")]
    found = results(logs, robot)
    assert set(found) == set(CLOCKS)
    for name in ("joint_clock", "base_clock"):
        assert set(found[name].per_log) == {"swinging"} and not found[name].passed
        assert found[name].statistic == pytest.approx(0.07, abs=1e-3)
    assert set(found["even_clock"].per_log) == {"swinging"} and found["even_clock"].passed


def test_a_still_log_is_replayed_by_the_clock_that_it_claims(robot: Robot) -> None:
    """A diagnosis asks for the clock of each log where the others say that the loop is slow."""
    logs = [swinging(robot, 1.07), standing(robot, 600)]
    found = results(logs, robot)
    clock = clock_of([found["joint_clock"]])
    assert clock is not None and set(clock) == {"swinging", "standing"}
    assert clock["standing"] == (1.0,) and clock["swinging"] == pytest.approx((1.07,), abs=1e-3)
    uneven = clock_of([replace(found["even_clock"], passed=False)])
    assert uneven is not None and uneven["standing"] == (1.0,) and len(uneven["swinging"]) == 30


def test_a_user_is_told_that_still_logs_cannot_be_checked(robot: Robot) -> None:
    told = str(lg.check([standing(robot, 600)]))
    assert told == "nothing could be checked: the logs lack the columns, or are short or still"


def test_a_clock_of_noise_alone_is_still_a_number() -> None:
    """Only what is exactly still has none: a channel with noise has one, however poor."""
    noise = np.random.default_rng(0).standard_normal((2, 300, 3))
    assert np.isfinite(clock_scale(noise[0], noise[1], 0.001) or np.nan)
    local = local_clock(noise[0], noise[1], 0.001, 20)
    assert local is not None and np.isfinite(local.values).all() and np.isfinite(local.error)


def test_a_clock_that_drifts_by_three_per_cent_is_told(robot: Robot) -> None:
    """The local clock of an even log scatters by 0.2 %; the threshold is well above that and not far above."""
    moving = swinging(robot, rows=1500)
    length = 1 + 0.03 * np.sin(2 * np.pi * np.arange(1500) / 1500)
    phase = 2 * np.pi * 3 * 0.001 * np.concatenate([[0.0], np.cumsum(length[:-1])])
    noise = np.random.default_rng(1)
    columns = dict(moving.columns)
    for joint in robot.joints:
        columns[f"joint_pos/{joint}"] = 0.3 * np.sin(phase) + 6e-4 * noise.standard_normal(1500)
        columns[f"joint_vel/{joint}"] = 0.3 * 2 * np.pi * 3 * np.cos(phase) + 0.06 * noise.standard_normal(1500)
    (found,) = [one for one in run_checks([replace(moving, columns=columns)], robot, {}) if one.name == "even_clock"]
    assert not found.passed and found.statistic == pytest.approx(0.03 / np.sqrt(2), rel=0.1)


def test_a_clock_three_quarters_of_the_claimed_one_is_within_what_is_searched(robot: Robot) -> None:
    (clock,) = list_hypotheses(["sample_period"], robot, {"slow": (0.75,), "fast": (1.75,)})
    for log, scale in (("slow", 0.75), ("fast", 1.75)):
        assert clock.values(log, np.ones(1)) == {"scale": pytest.approx(scale)}
