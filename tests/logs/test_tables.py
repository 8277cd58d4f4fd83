"""Tables of strangers become logs: maps, units, sums, names, clocks, cuts. Files are written by hand or by numpy."""

import json
from pathlib import Path

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.logs.importers.csv import Csv, CsvOptions
from leapgap.logs.log import Log, read_log, write_log
from leapgap.logs.metadata import Segment
from leapgap.robot.model import Robot

NO_COMMANDS = {f"{name}/*": 0.0 for name in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}


def write_table(path: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
    return path


def plain(rows: int = 50, period_s: float = 0.01) -> dict[str, np.ndarray]:
    """Columns with names of their own, each of other values."""
    time = np.arange(rows) * period_s
    return {"t": 7 + time, "q1": 0.1 * time, "q2": -0.2 * time, "u1": 1 + time, "u2": 2 + time, "f1": 0.5 + 0 * time}


def read(path: Path, robot: Robot, **options: object) -> Log:
    """The only log of a file, its commands zero unless they are mapped."""
    return Csv().read(path, path.stem, robot, CsvOptions(**{"constants": NO_COMMANDS, **options}))  # type: ignore[arg-type]


NAMES = {"joint_names": {"1": "shoulder", "2": "elbow"}}
POSITIONS = {"columns": {"time": "t", "joint_pos/*": "q*"}, **NAMES}


def test_joints_are_found_by_their_names_there_or_by_their_number(arm: Robot, tmp_path: Path) -> None:
    columns = plain()
    table = write_table(tmp_path / "a.csv", columns)
    log = read(table, arm, **POSITIONS)
    assert log["joint_pos/shoulder"] == pytest.approx(columns["q1"])
    assert log["joint_pos/elbow"] == pytest.approx(columns["q2"])
    swapped = write_table(tmp_path / "b.csv", {"t": columns["t"], "q0": columns["q1"], "q1": columns["q2"]})
    log = read(swapped, arm, columns=POSITIONS["columns"], joint_order=["elbow", "shoulder"])
    assert log["joint_pos/elbow"] == pytest.approx(columns["q1"])
    with pytest.raises(InputError, match="found wrist; expected joints of the robot: shoulder, elbow"):
        read(table, arm, columns=POSITIONS["columns"], joint_names={"1": "wrist"})


def test_values_are_multiplied_by_unit_and_factor_and_then_shifted(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", plain())
    log = read(
        table,
        arm,
        **POSITIONS,
        units={"joint_pos/*": "deg", "time": "ms"},
        factors={"joint_pos/*": [1.0, -2.0]},
        offsets={"joint_pos/*": [0.5, 0.0], "joint_pos/elbow": 0.25},
    )
    degree = np.pi / 180
    assert log["joint_pos/shoulder"] == pytest.approx(0.5 + degree * plain()["q1"])
    assert log["joint_pos/elbow"] == pytest.approx(0.25 - 2 * degree * plain()["q2"])
    assert log.time[-1] == pytest.approx(0.49e-3)


@pytest.mark.parametrize(
    ("column", "unit", "value"),
    [
        ("joint_vel/elbow", "rpm", 2 * np.pi / 60),
        ("cmd_tau/elbow", "Ncm", 0.01),
        ("cmd_tau/elbow", "ozfin", 0.0070615518),
        ("cmd_kp/elbow", "Nm/deg", 180 / np.pi),
        ("base_linvel_x", "km/h", 1 / 3.6),
        ("imu_acc_z", "g", 9.80665),
        ("joint_pos/elbow", "mm", 1e-3),
        ("supply_voltage", "mV", 1e-3),
    ],
)
def test_units_by_name(arm: Robot, tmp_path: Path, column: str, unit: str, value: float) -> None:
    table = write_table(tmp_path / "a.csv", {**plain(), "x": np.ones(50)})
    columns = {**POSITIONS["columns"], column: "x"}
    constants = {
        f"{key[:-2]}/{joint}": 0.0 for key in NO_COMMANDS for joint in arm.joints if f"{key[:-2]}/{joint}" != column
    }
    log = read(table, arm, columns=columns, **NAMES, units={column: unit}, constants=constants)
    assert log[column][3] == pytest.approx(value, rel=1e-6)


def test_a_unit_of_another_dimension_is_refused(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", plain())
    with pytest.raises(
        InputError, match=r"units, joint_pos/shoulder: found the unit rpm; expected one of rad, mrad, deg"
    ):
        read(table, arm, **POSITIONS, units={"joint_pos/*": "rpm"})


def test_columns_are_summed_with_their_factors(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", {**plain(), "f2": np.full(50, 0.25)})
    columns = {**POSITIONS["columns"], "cmd_tau/*": {"u*": 2, "f*": -1}}
    constants = {key: value for key, value in NO_COMMANDS.items() if key != "cmd_tau/*"}
    log = read(table, arm, columns=columns, **NAMES, constants=constants)
    assert log["cmd_tau/shoulder"] == pytest.approx(2 * plain()["u1"] - 0.5)
    assert log["cmd_tau/elbow"] == pytest.approx(2 * plain()["u2"] - 0.25)
    with pytest.raises(
        InputError, match=r"cmd_tau/\*: found {'u\*': 'x'}; expected the name of a column, or a mapping"
    ):
        read(table, arm, columns={**columns, "cmd_tau/*": {"u*": "x"}}, **NAMES, constants=constants)


def test_constants_may_differ_by_joint_and_stand_before_columns_of_all_joints(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", plain())
    constants = {**NO_COMMANDS, "cmd_kp/*": [40.0, 30.0], "cmd_tau/elbow": 9.0}
    log = read(table, arm, **POSITIONS, constants=constants)
    assert [log[f"cmd_kp/{joint}"][0] for joint in arm.joints] == [40, 30]
    assert [log[f"cmd_tau/{joint}"][0] for joint in arm.joints] == [0, 9]
    with pytest.raises(InputError, match=r"cmd_kp/\*: found a list of 3; expected one number, or with \* a list of 2"):
        read(table, arm, **POSITIONS, constants={**constants, "cmd_kp/*": [1.0, 2.0, 3.0]})


def test_uneven_time_stays_and_the_period_is_the_mean_step(arm: Robot, tmp_path: Path) -> None:
    """Steps of a slow loop: 8 to 13 ms, median 10, mean 10.5. A median as period was read as a wrong clock."""
    steps = np.tile([0.008, 0.010, 0.010, 0.010, 0.0145], 20)
    time = np.concatenate([[0.0], np.cumsum(steps)])
    table = write_table(tmp_path / "a.csv", {**plain(101), "t": 3 + time})
    log = read(table, arm, **POSITIONS)
    assert log.time == pytest.approx(time, abs=1e-12)
    assert log.info.sample_period_s == pytest.approx(0.0105)
    assert read(table, arm, **POSITIONS, period_s=0.0104).info.sample_period_s == pytest.approx(0.0105)
    with pytest.raises(
        InputError, match=r"time: found steps of 0\.0105 s on average; expected the stated period of 0\.01 s"
    ):
        read(table, arm, **POSITIONS, period_s=0.01)


def test_without_time_stamps_the_stated_period_is_the_clock(arm: Robot, tmp_path: Path) -> None:
    columns = plain()
    del columns["t"]
    table = write_table(tmp_path / "a.csv", columns)
    log = read(table, arm, columns={"joint_pos/*": "q*"}, **NAMES, period_s=0.004)
    assert log.time == pytest.approx(0.004 * np.arange(50))
    with pytest.raises(InputError, match="found no column time; expected a strictly increasing time, s; map it"):
        read(table, arm, columns={"joint_pos/*": "q*"}, **NAMES)


def test_time_stamps_that_repeat_or_run_back_are_refused_or_dropped_with_a_word(arm: Robot, tmp_path: Path) -> None:
    columns = plain()
    columns["t"][10], columns["t"][20:22] = columns["t"][9], columns["t"][15:17].copy()
    table = write_table(tmp_path / "a.csv", columns)
    with pytest.raises(InputError, match="column time: found a step of 0 s after row 9"):
        read(table, arm, **POSITIONS)
    log = read(table, arm, **POSITIONS, repeated_times="drop")
    assert len(log) == 47
    assert log.info.extra["derived"]["time"] == "3 rows left out, whose time stamps repeat or run back"
    assert "3 rows left out" in log.info.source
    with pytest.raises(InputError, match="repeated_times: found sort; expected one of refuse, drop"):
        read(table, arm, **POSITIONS, repeated_times="sort")


def test_a_missing_time_stamp_takes_no_other_row_with_it(arm: Robot, tmp_path: Path) -> None:
    columns = plain()
    columns["t"][20] = np.nan
    log = read(write_table(tmp_path / "a.csv", columns), arm, repeated_times="drop", **POSITIONS)
    assert len(log) == 49 and log.time[-1] == pytest.approx(0.49)
    assert log.info.extra["derived"]["time"].startswith("1 rows left out")


def test_a_blank_line_before_columns_between_spaces(arm: Robot, tmp_path: Path) -> None:
    columns = plain()
    rows = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True))
    (tmp_path / "a.csv").write_text("\n" + " ".join(columns) + "\n" + rows + "\n")
    log = read(tmp_path / "a.csv", arm, delimiter=" ", **POSITIONS)
    assert log["joint_pos/elbow"] == pytest.approx(columns["q2"])


def test_whole_numbers_of_nanoseconds_keep_all_their_digits(arm: Robot, tmp_path: Path) -> None:
    lines = ["t,q1,q2", *(f"{1_700_000_000_000_000_000 + 1001 * row},0,0" for row in range(20))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    log = read(tmp_path / "a.csv", arm, **POSITIONS, units={"time": "ns"})
    assert log.time == pytest.approx(1001e-9 * np.arange(20), abs=1e-15)


def test_resampling_holds_commands_and_joins_measurements(arm: Robot, tmp_path: Path) -> None:
    time = np.array([0.0, 0.011, 0.018, 0.031, 0.04, 0.052])
    columns = {"t": time, "q1": 2 * time, "q2": -time, "u1": np.arange(6.0), "u2": np.zeros(6)}
    table = write_table(tmp_path / "a.csv", columns)
    mapping = {**POSITIONS["columns"], "cmd_tau/*": "u*"}
    constants = {key: value for key, value in NO_COMMANDS.items() if key != "cmd_tau/*"}
    log = read(table, arm, columns=mapping, **NAMES, constants=constants, resample_s=0.01)
    assert log.time == pytest.approx([0, 0.01, 0.02, 0.03, 0.04, 0.05])
    assert log["joint_pos/shoulder"] == pytest.approx(2 * log.time)
    assert log["cmd_tau/shoulder"].tolist() == [0, 0, 2, 2, 4, 4]
    assert log.info.sample_period_s == 0.01
    assert "resampled to 0.01 s" in log.info.source


def test_missing_velocities_are_fitted_only_if_asked_for_and_the_log_says_so(arm: Robot, tmp_path: Path) -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(1e-3, 4e-3, 300))
    table = write_table(tmp_path / "a.csv", {"t": time, "q1": np.sin(3 * time), "q2": time**2, "v2": 7 + 0 * time})
    assert "joint_vel/elbow" not in read(table, arm, **POSITIONS)
    columns = {**POSITIONS["columns"], "joint_vel/elbow": "v2"}
    log = read(table, arm, columns=columns, **NAMES, velocities="fit", velocity_window_s=0.02)
    assert log["joint_vel/shoulder"] == pytest.approx(3 * np.cos(3 * time), abs=2e-3)
    assert set(log["joint_vel/elbow"]) == {7.0}  # measured: left alone
    write_log(log, tmp_path / "log.parquet")
    back = read_log(tmp_path / "log.parquet")
    assert back.info.extra["derived"]["joint_vel"] == (
        "not measured: slope of parabolas through joint_pos within 0.02 s"
    )


def test_the_base_gets_its_velocities_from_its_pose(arm: Robot, tmp_path: Path) -> None:
    """A body that yaws by ψ and then pitches by θ, w x y z with signs that flip half-way.

    Its angular velocity in its own axes is (−ψ̇ sin θ, θ̇, ψ̇ cos θ).
    """
    time = 0.002 * np.arange(400)
    yaw, pitch = 1.5 * time, 0.4 * np.sin(5 * time)
    (cy, sy), (cp, sp) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (yaw, pitch))
    turn = np.column_stack([cy * cp, -sy * sp, cy * sp, sy * cp])
    turn[200:] *= -1
    expected = np.column_stack([-1.5 * np.sin(pitch), 2.0 * np.cos(5 * time), 1.5 * np.cos(pitch)])
    names = ("base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z")
    pose = {"base_pos_x": time**2, "base_pos_y": 0 * time, "base_pos_z": -time}
    columns = {"t": time, "q1": 0 * time, "q2": 0 * time, **pose, **dict(zip(names, turn.T, strict=True))}
    log = read(write_table(tmp_path / "a.csv", columns), arm, **POSITIONS, velocities="fit")
    assert log["base_linvel_x"] == pytest.approx(2 * time, abs=1e-9)
    spin = log.stack(["base_angvel_x", "base_angvel_y", "base_angvel_z"])
    assert spin[10:-10] == pytest.approx(expected[10:-10], abs=2e-3)


def test_one_file_is_cut_into_named_pieces(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", plain(100))
    pieces = [Segment("rise", 0.1, 0.3), Segment("fall", 0.5, 0.9)]
    logs = Csv().read_all(table, "a", arm, CsvOptions(**POSITIONS, constants=NO_COMMANDS, pieces=pieces))  # type: ignore[arg-type]
    assert [(log.name, len(log)) for log in logs] == [("a_rise", 20), ("a_fall", 40)]
    assert logs[1].time[0] == 0
    assert logs[1]["joint_pos/shoulder"][0] == pytest.approx(0.05)
    with pytest.raises(InputError, match="found 2 logs; expected one"):
        read(table, arm, **POSITIONS, pieces=pieces)


def test_one_file_is_cut_where_a_flag_changes_and_rows_are_dropped(arm: Robot, tmp_path: Path) -> None:
    mode = np.repeat([0, 1, 2, 1, 1, 0], 20)
    mode[60] = 3  # one stray row between two runs of mode 1
    bad = np.zeros(120)
    bad[45:50] = 1
    columns = {**plain(120), "mode": mode, "bad": bad}
    table = write_table(tmp_path / "a.csv", columns)
    options = {**POSITIONS, "constants": NO_COMMANDS, "cut_by": "mode", "drop_rows": {"bad": [1.0]}}
    logs = Csv().read_all(table, "a", arm, CsvOptions(**options, cut_values=[1.0, 2.0]))  # type: ignore[arg-type]
    assert [(log.name, len(log)) for log in logs] == [("a_1", 20), ("a_2", 15), ("a_3", 39)]
    assert logs[1]["joint_pos/shoulder"][5] == pytest.approx(columns["q1"][50])  # after the rows that are dropped
    with pytest.raises(InputError, match=r"no column state; expected the column that csv\.cut_by names"):
        Csv().read_all(table, "a", arm, CsvOptions(**{**options, "cut_by": "state"}))  # type: ignore[arg-type]


def test_a_long_log_is_cut_into_parts_of_equal_length(arm: Robot, tmp_path: Path) -> None:
    table = write_table(tmp_path / "a.csv", plain(250))
    logs = Csv().read_all(table, "a", arm, CsvOptions(**POSITIONS, constants=NO_COMMANDS, piece_s=1.0))  # type: ignore[arg-type]
    assert [(log.name, len(log)) for log in logs] == [("a_part1", 100), ("a_part2", 100)]


def test_a_text_in_a_column_is_named_with_its_row_and_matters_only_where_it_is_mapped(
    arm: Robot, tmp_path: Path
) -> None:
    lines = ["t,q1,q2,note", *(f"{0.01 * row},0,{'stuck' if row == 7 else 0},fine" for row in range(20))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"a\.csv, column q2, row 7: found 'stuck'; expected a number"):
        read(tmp_path / "a.csv", arm, **POSITIONS)
    columns = {"time": "t", "joint_pos/shoulder": "q1"}
    assert len(read(tmp_path / "a.csv", arm, columns=columns)) == 20


def test_semicolons_missing_headers_and_lines_before_them(arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("made on Monday\n" + "\n".join(f"{0.1 * row};{row};5" for row in range(12)))
    options = {"delimiter": ";", "header": False, "skip_rows": 1, "columns": {"time": "0", "joint_pos/shoulder": "1"}}
    assert read(tmp_path / "a.csv", arm, **options)["joint_pos/shoulder"].tolist() == list(range(12))


def test_files_that_are_too_large_are_refused_before_they_are_read(
    arm: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = write_table(tmp_path / "a.csv", plain(50))
    with pytest.raises(InputError, match=r"found 50 rows; expected at most 40 \(most_rows\)"):
        read(table, arm, **POSITIONS, most_rows=40)
    monkeypatch.setattr("leapgap.logs.importers.tables.MOST_BYTES", 1000)
    with pytest.raises(InputError, match="values; expected at most 125"):
        read(table, arm, **POSITIONS)


def test_options_come_from_yaml_as_conf_writes_them_and_from_json(
    arm: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from leapgap.cli import main

    (tmp_path / "logs").mkdir()
    write_table(tmp_path / "logs" / "a.csv", plain())
    csv = {"columns": POSITIONS["columns"], "constants": {**NO_COMMANDS, "cmd_kp/*": 25}, **NAMES, "velocities": "fit"}
    text = """
source: anywhere
format: csv
csv:
  columns: {time: t, 'joint_pos/*': q*}
  joint_names: {1: shoulder, 2: elbow}
  constants: {'cmd_tau/*': 0, 'cmd_pos/*': 0, 'cmd_vel/*': 0, 'cmd_kp/*': 2.5e1, 'cmd_kd/*': 0e-3}
  velocities: fit
"""
    (tmp_path / "map.yaml").write_text(text)
    (tmp_path / "map.json").write_text(json.dumps(csv))
    command = ("import", tmp_path / "logs", tmp_path / "two.xml", "--out")
    assert main([str(one) for one in (*command, tmp_path / "x", "--options", tmp_path / "map.yaml")]) == 0
    said = capsys.readouterr().out
    assert "a: 50 samples, 0.490 s, mean step 10 ms; joint_vel: not measured" in said
    options = ("--format", "csv", "--options", tmp_path / "map.json")
    assert main([str(one) for one in (*command, tmp_path / "y", *options)]) == 0
    assert (tmp_path / "x" / "a.parquet").read_bytes() == (tmp_path / "y" / "a.parquet").read_bytes()
    assert read_log(tmp_path / "x" / "a.parquet")["cmd_kp/elbow"][0] == 25
    assert main([str(one) for one in (*command, tmp_path / "z", "--options", tmp_path / "map.json")]) == 2
    assert "found no format; expected the format of the logs" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"joint_position/*": "q*"}, "found joint_position/shoulder; expected time, or one of base_pos, base_quat,"),
        ({"joint_pos": "q1"}, "found joint_pos; expected time, or one of base_pos, base_quat,"),
        ({"joint_pos/wrist": "q1"}, "found joint_pos/wrist; expected a joint of the robot: shoulder, elbow; correct"),
    ],
)
def test_a_name_of_ours_that_means_nothing_is_refused(
    arm: Robot, tmp_path: Path, columns: dict[str, str], message: str
) -> None:
    """A misspelt quantity would be imported under that name, and the log would lack it without a word."""
    table = write_table(tmp_path / "a.csv", plain())
    with pytest.raises(InputError, match=message):
        read(table, arm, columns={"time": "t", **columns}, **NAMES)


def test_headers_with_spaces_and_byte_order_marks_and_decimal_commas(arm: Robot, tmp_path: Path) -> None:
    rows = "\n".join(f"{0.01 * row:.2f}; {0.5 * row:.1f} ; 0,0".replace(".", ",") for row in range(12))
    (tmp_path / "a.csv").write_text(f"\ufefft; q1 ;q2\n{rows}", encoding="utf-8")
    log = read(tmp_path / "a.csv", arm, **POSITIONS, delimiter=";", decimal_point=",")
    assert log["joint_pos/shoulder"] == pytest.approx(0.5 * np.arange(12))


def test_two_columns_of_one_name_are_refused_where_they_are_mapped(arm: Robot, tmp_path: Path) -> None:
    lines = ["t,q1,q2,x,x", *(f"{0.01 * row},{row},0,1,2" for row in range(12))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert len(read(tmp_path / "a.csv", arm, **POSITIONS)) == 12
    with pytest.raises(InputError, match=r"a\.csv: found 2 columns x; expected one of each name; rename them"):
        read(tmp_path / "a.csv", arm, columns={"time": "t", "joint_pos/shoulder": "x"})
