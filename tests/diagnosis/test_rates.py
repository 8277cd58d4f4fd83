"""What is meant as a time lasts as long at any rate of a log: 1 kHz, 500 Hz, 200 Hz."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leapgap.diagnosis.checks import clocks as local
from leapgap.diagnosis.checks.free_fall import GRAVITY, FreeFall
from leapgap.diagnosis.checks.planted_feet import PlantedFeet
from leapgap.diagnosis.full_rollouts import FullRollouts
from leapgap.diagnosis.short_rollouts import Pieces, StateChannels
from leapgap.jumping.task import ContactSchedule, Target, jump_info, schedule_of
from leapgap.logs.log import Log
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from tests.conftest import standing


def log(robot: Robot, rate_hz: int, seconds: float = 1.3, **changed: np.ndarray) -> Log:
    """A robot that stands still, logged at a rate."""
    rows = round(seconds * rate_hz) + 1
    jump = standing(robot, rows)
    info = replace(jump.info, sample_period_s=1 / rate_hz)
    return replace(jump, columns=dict(jump.columns) | {"time": np.arange(rows) / rate_hz} | changed, info=info)


@pytest.mark.parametrize(("rate_hz", "rows"), [(1000, 20), (500, 10), (200, 4), (40, 1), (10, 1)])
def test_a_time_is_as_many_rows_as_it_lasts_and_one_at_least(rate_hz: int, rows: int) -> None:
    info = jump_info("a1", 1 / rate_hz, ContactSchedule(), Target(0.0), "a test")
    assert info.rows(0.02) == rows


@pytest.mark.parametrize("rate_hz", [1000, 500, 200])
def test_a_local_clock_has_a_value_every_20_ms(robot: Robot, rate_hz: int) -> None:
    clocks = local.local_clocks([moving(log(robot, rate_hz, 1.0), robot)], robot)
    assert len(clocks["standing"].values) == pytest.approx(50, abs=1)
    assert clocks["standing"].values == pytest.approx(1.0, abs=0.01)


def moving(jump: Log, robot: Robot) -> Log:
    """The same with joints that swing, positions the integral of velocities."""
    phase = 2 * np.pi * jump.time
    columns = dict(jump.columns)
    for joint in robot.joints:
        columns |= {f"joint_pos/{joint}": np.sin(phase), f"joint_vel/{joint}": 2 * np.pi * np.cos(phase)}
    return replace(jump, columns=columns)


@pytest.mark.parametrize("rate_hz", [1000, 200, 100])
def test_a_fall_of_300_ms_is_judged_at_any_rate(robot: Robot, rate_hz: int) -> None:
    jump = log(robot, rate_hz)
    since = np.clip(jump.time - schedule_of(jump).take_off_s, 0, None)
    falling = replace(jump, columns=dict(jump.columns) | {"base_pos_z": 1.0 - GRAVITY * since**2 / 2})
    check = FreeFall().run([falling], robot, 0.08)
    assert check is not None
    assert check.statistic < 0.01


def test_a_fall_is_held_against_the_gravity_of_the_model(tmp_path: Path) -> None:
    """A robot of the moon falls as its model says; the check does not blame the clock of its log."""
    text = Robot.load().path.read_text()
    assert "gravity=" not in text
    (tmp_path / "moon.xml").write_text(text.replace("<option ", '<option gravity="0 0 -1.62" ', 1))
    moon = Robot.load(tmp_path / "moon.xml")
    assert moon.model.opt.gravity[2] == -1.62
    jump = log(moon, 1000)
    since = np.clip(jump.time - schedule_of(jump).take_off_s, 0, None)
    falling = replace(jump, columns=dict(jump.columns) | {"base_pos_z": 1.0 - 1.62 * since**2 / 2})
    check = FreeFall().run([falling], moon, 0.08)
    assert check is not None and check.passed and check.statistic < 0.01
    assert FreeFall().run([falling], Robot.load(), 0.08).statistic == pytest.approx(1 - 1.62 / 9.81, abs=0.01)


@pytest.mark.parametrize("rate_hz", [1000, 200])
def test_a_foot_that_wanders_for_15_ms_is_seen_at_any_rate(robot: Robot, rate_hz: int) -> None:
    jump = log(robot, rate_hz)
    away = np.where((jump.time > 0.0524) & (jump.time < 0.0676), 0.05, 0.0)  # rows 11 to 13 at 200 Hz
    check = PlantedFeet().run([replace(jump, columns=dict(jump.columns) | {"base_pos_x": away})], robot, 0.01)
    assert check.statistic == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize("rate_hz", [1000, 500, 200])
def test_a_piece_starts_within_9_ms_of_smoothing(robot: Robot, rate_hz: int) -> None:
    """A parabola through ±9 ms of a 10 Hz sine follows it within 4 % of its amplitude; through ±45 ms it does not."""
    jump = log(robot, rate_hz)
    wave = 0.01 * np.sin(2 * np.pi * 10 * jump.time)
    jump = replace(jump, columns=dict(jump.columns) | {"base_pos_x": wave})
    row = round(0.325 * rate_hz)  # the crest
    pieces = Pieces.of(States.of(jump, robot), [row], np.array([1]), StateChannels.of([jump], robot))
    assert pieces.starts.states[0, 0] == pytest.approx(wave[row], abs=0.04 * 0.01)


@pytest.mark.parametrize(("rate_hz", "values"), [(1000, 50), (500, 50), (200, 50), (20, 20)])
def test_whole_jumps_are_compared_every_20_ms(robot: Robot, rate_hz: int, values: int) -> None:
    jumps = [log(robot, rate_hz, 1.0).first_rows(rate_hz)] * 2
    judged = SimpleNamespace(logs=jumps, rows=[len(jump) for jump in jumps], channels=["x", "z", "pitch"])
    whole = FullRollouts(SimpleNamespace(judged=judged))  # type: ignore[arg-type]
    errors = whole.sample([np.zeros((rows, 3)) for rows in judged.rows])
    assert np.bincount(whole.log_of_value).tolist() == [3 * values] * 2
    assert len(errors.sampled) == 6 * values
