import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leapgap.errors import InputError
from leapgap.logs import log as jump_log
from leapgap.logs.metadata import segment_of_rows
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from tests.conftest import standing


def test_a_log_comes_back_as_it_was_written_and_bytes_repeat(robot: Robot, tmp_path: Path) -> None:
    log = standing(robot, rows=50)
    log = dataclasses.replace(
        log, info=dataclasses.replace(log.info, terrain=(Box(0.2, 0.0, (0.2, 0.5, 0.03), 0.03, estimated=True),))
    )
    jump_log.write_log(log, tmp_path / "a.parquet")
    jump_log.write_log(log, tmp_path / "b.parquet")
    back = jump_log.read_log(tmp_path / "a.parquet")
    assert back.info == log.info
    assert list(back.columns) == list(log.columns)
    assert all(np.array_equal(back[name], log[name]) for name in log.columns)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_pitch_is_positive_nose_down_and_yaw_to_the_left(robot: Robot) -> None:
    half = 0.15
    down = standing(robot, 10, base_quat_w=np.full(10, np.cos(half)), base_quat_y=np.full(10, np.sin(half)))
    assert down.pitch == pytest.approx(np.full(10, 2 * half))
    left = standing(robot, 10, base_quat_w=np.full(10, np.cos(half)), base_quat_z=np.full(10, np.sin(half)))
    assert left.yaw == pytest.approx(np.full(10, 2 * half))


def test_first_change_of_gains_is_found(robot: Robot) -> None:
    kp = np.full(100, 300.0)
    kp[70:] = 80.0
    assert standing(robot, 100, **{"cmd_kp/FR_calf": kp}).rows_before_gain_change == 70
    assert standing(robot, 100).rows_before_gain_change == 100


def test_every_other_row_carries_the_mean_of_what_was_sent(robot: Robot) -> None:
    rows = np.arange(101.0)
    log = standing(robot, 101, **{"cmd_tau/FR_calf": rows, "joint_pos/FR_calf": -rows})
    half = log.downsample(2)
    assert len(half) == 50
    assert half.info.sample_period_s == pytest.approx(2 * log.info.sample_period_s)
    assert half["cmd_tau/FR_calf"] == pytest.approx(rows[:100:2] + 0.5)
    assert half["joint_pos/FR_calf"] == pytest.approx(-rows[:100:2])
    assert half["cmd_kp/FR_calf"] == pytest.approx(log["cmd_kp/FR_calf"][:100:2])
    assert log.downsample(1) is log


def ridden(column: str) -> dict:
    values = np.zeros(100)
    values[[40, 60]] = np.nan
    return {column: values}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (ridden("base_pos_z"), "column base_pos_z: found 2 values that are no number, first in row 40"),
        ({"time": np.arange(100)[::-1] / 1000}, "a step of -0.001 s after row 0; expected strictly increasing times"),
        ({"time": np.arange(99) / 1000}, r"found shape \(100,\); expected \(99,\)"),
        ({"base_quat_w": np.full(100, 2.0)}, "found length 2; expected unit quaternions"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(robot: Robot, changed: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        standing(robot, 100, **changed)


def test_a_log_without_commands_says_of_which_joints(robot: Robot) -> None:
    log = standing(robot, 10)
    columns = {name: values for name, values in log.columns.items() if name != "cmd_kp/RL_calf"}
    with pytest.raises(InputError, match="no cmd_kp of RL_calf"):
        jump_log.Log("x", columns, log.info)


def test_unreadable_files_are_input_errors(robot: Robot, tmp_path: Path) -> None:
    jump_log.write_log(standing(robot, 10), tmp_path / "whole.parquet")
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "whole.parquet").read_bytes()[:2000])
    with pytest.raises(InputError, match=r"cut\.parquet: found no readable Parquet"):
        jump_log.read_log(tmp_path / "cut.parquet")
    pq.write_table(pa.table({"time": [0.0, 0.1]}), tmp_path / "foreign.parquet")
    with pytest.raises(InputError, match="no metadata 'leapgap'"):
        jump_log.read_log(tmp_path / "foreign.parquet")
    with pytest.raises(InputError, match="no such file"):
        jump_log.read_log(tmp_path / "missing.parquet")


def write_table(path: Path, columns: dict[str, np.ndarray], about: dict) -> Path:
    """A log file written by pyarrow alone."""
    table = pa.table(columns).replace_schema_metadata({"leapgap": json.dumps(about)})
    pq.write_table(table, path)
    return path


def swing(seconds: float, **further: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of one joint that was asked to stay where it is, at 100 Hz."""
    time = np.arange(round(100 * seconds)) / 100
    names = ("joint_pos/j", "joint_vel/j", "cmd_tau/j", "cmd_pos/j", "cmd_vel/j", "cmd_kp/j", "cmd_kd/j")
    return {"time": time} | {name: np.zeros(len(time)) for name in names} | further


PLAIN = {"format_version": 2, "robot": "one", "sample_period_s": 0.01, "source": "a test"}


def test_a_log_needs_no_schedule_target_or_terrain(tmp_path: Path) -> None:
    read = jump_log.read_log(write_table(tmp_path / "a.parquet", swing(4.0), PLAIN))
    assert (read.info.terrain, read.info.extra, read.info.segments) == ((), {}, ())
    assert [(one.name, one.begin_s) for one in read.segments] == [
        ("part_1", 0.0),
        ("part_2", pytest.approx(3.99 / 4)),
        ("part_3", pytest.approx(3.99 / 2)),
        ("part_4", pytest.approx(3 * 3.99 / 4)),
    ]
    jump_log.write_log(read, tmp_path / "b.parquet")
    assert jump_log.read_log(tmp_path / "b.parquet").info == read.info


def test_stated_segments_come_back(tmp_path: Path) -> None:
    stated = [{"name": "reach", "begin_s": 0.0, "end_s": 1.5}, {"name": "return", "begin_s": 2.0, "end_s": 3.0}]
    read = jump_log.read_log(write_table(tmp_path / "a.parquet", swing(4.0), PLAIN | {"segments": stated}))
    assert [one.name for one in read.segments] == ["reach", "return"]
    rows = segment_of_rows(read.segments, read.time)
    assert [rows[row] for row in (0, 149, 150, 199, 200, 299, 300)] == [0, 0, -1, -1, 1, 1, -1]
    jump_log.write_log(read, tmp_path / "b.parquet")
    assert jump_log.read_log(tmp_path / "b.parquet").info == read.info


def test_feet_in_contact_divide_a_log_that_states_nothing(tmp_path: Path) -> None:
    rows = np.arange(400)
    left, right = ((rows // 100) % 2 == 0).astype(float), ((rows // 100) % 2 == 1).astype(float)
    left[350:], right[350:] = 0.0, 0.0
    columns = swing(4.0, **{"contact/L": left, "contact/R": right})
    read = jump_log.read_log(write_table(tmp_path / "a.parquet", columns, PLAIN))
    assert [one.name for one in read.segments] == ["L", "R", "L", "R", "no_foot"]
    assert [one.begin_s for one in read.segments] == [0.0, 1.0, 2.0, 3.0, 3.5]


def test_a_jump_of_version_1_has_its_phases_as_segments(tmp_path: Path) -> None:
    about = PLAIN | {
        "format_version": 1,
        "schedule": {"double_contact_s": 0.4, "rear_contact_s": 0.3, "flight_s": 0.5},
        "target": {"x_m": 0.6, "z_m": 0.0},
        "terrain": [],
    }
    read = jump_log.read_log(write_table(tmp_path / "a.parquet", swing(2.0), about))
    assert [(one.name, round(one.begin_s, 3)) for one in read.segments] == [
        ("double_contact", 0.0),
        ("rear_contact", 0.4),
        ("lift_off", 0.65),
        ("flight", 0.75),
        ("touch_down", 1.2),
    ]
    del about["schedule"]["flight_s"]
    with pytest.raises(InputError, match="flight_s"):
        jump_log.read_log(write_table(tmp_path / "b.parquet", swing(2.0), about))


def test_a_log_whose_time_is_in_ms_is_refused() -> None:
    """2000 rows of 1 ms that claim 1 s each: in a claimed 50 ms nothing moves, so longer times are looked at."""
    time = np.arange(2000) / 1000
    columns = {"time": 1000 * time, "joint_pos/knee": np.sin(3 * time), "joint_vel/knee": 3 * np.cos(3 * time)}
    columns |= {f"cmd_{name}/knee": np.zeros(2000) for name in ("tau", "pos", "vel", "kp", "kd")}
    log = jump_log.Log("run", columns, jump_log.LogInfo("leg", 1.0, "a test"))
    with pytest.raises(InputError, match=r"a log of 1999 s with steps of 1000 ms.*moves 0.001 times as far"):
        jump_log.check_read(log, "run")
    right = jump_log.Log("run", columns | {"time": time}, jump_log.LogInfo("leg", 0.001, "a test"))
    jump_log.check_read(right, "run")
