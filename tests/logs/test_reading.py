"""Bad logs: what is refused when a log is read, and that the rest goes on."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from leapgap.cli import main
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo, read_log, read_logs, write_log
from leapgap.logs.reading import read_folder
from tests import plain_arm
from tests.hostile.base_logs import arm_log, hopper_log, write_own


def stored(folder: Path, log: int = 0, about: dict | None = None, **changed: np.ndarray) -> Path:
    """A file of the hopper's log, some of its columns changed, without checksums."""
    path = folder / f"log_{log}.parquet"
    write_own(hopper_log(log) | changed, path, about, checksum=False)
    return path


@pytest.mark.parametrize(
    ("column", "change", "says"),
    [
        ("base_pos_x", lambda x: x + 1e9, r"column base_pos_x: found 1e\+09 in row 0"),
        ("cmd_kp/hip", lambda x: -x, "cmd_kp/hip: found -40 in row 0 .160 such values.; expected 0 to 1e\\+06"),
        ("joint_pos/hip", np.rad2deg, r"displacements of 57\.\d times the integral of joint_vel/hip \(degrees for rad"),
        (
            "joint_vel/hip",
            np.rad2deg,
            r"displacements of 0\.017\d* times the integral of joint_vel/hip \(degrees for rad",
        ),
        ("base_angvel_y", np.rad2deg, r"the attitude turns 0\.017\d times as much \(degrees for radians"),
        ("base_linvel_x", lambda x: 1e2 * x, r"times the integral of base_linvel_x \(cm for m"),
        ("joint_vel/knee", lambda x: -x, "a motion that is not the one of joint_vel/knee .correlation -1.00"),
        ("joint_pos/knee", np.round, "whole numbers alone|displacements|motion that is not"),
    ],
)
def test_what_physics_excludes_is_refused_by_name(tmp_path: Path, column: str, change, says: str) -> None:
    whole = hopper_log(0)
    read_log(stored(tmp_path))
    with pytest.raises(InputError, match=says):
        read_log(stored(tmp_path, **{column: change(whole[column])}))


def test_quaternions_in_the_order_x_y_z_w_are_told(tmp_path: Path) -> None:
    whole = hopper_log(0)
    moved = {f"base_quat_{a}": whole[f"base_quat_{b}"] for a, b in zip("wxyz", "xyzw", strict=True)}
    with pytest.raises(InputError, match=r"turns that are not those of base_angvel_.; read as x y z w they would be"):
        read_log(stored(tmp_path, **moved))


def test_rows_that_are_lost_or_there_twice_are_told(tmp_path: Path) -> None:
    whole = hopper_log(0)
    twice = {name: np.repeat(values, 2) for name, values in whole.items()}
    with pytest.raises(InputError, match="160 rows are there twice, equal in every column"):
        read_log(stored(tmp_path, **twice))
    rows = np.delete(np.arange(160), slice(50, 80))
    lost = {name: values[rows] for name, values in whole.items()} | {"time": whole["time"][: len(rows)]}
    with pytest.raises(InputError, match="row 50: found a leap of half of the columns from the row before"):
        read_log(stored(tmp_path, **lost))


def test_gaps_in_time_are_told_and_used(tmp_path: Path) -> None:
    whole, rows = hopper_log(0), np.delete(np.arange(160), slice(50, 80))
    kept = {name: values[rows] for name, values in whole.items()}
    for number in range(2):
        stored(tmp_path, number, {"sample_period_s": float(kept["time"][-1] / (len(rows) - 1))}, **kept)
    assert read_folder(tmp_path).lines()[0] == "log_0: about 30 samples lost in 1 places, the first after row 49"


def test_a_changed_bit_is_seen_by_the_checksums_that_we_write(tmp_path: Path) -> None:
    columns = arm_log(0)
    info = LogInfo("arm", 0.01, "a test")
    path = tmp_path / "log.parquet"
    write_log(Log("log", columns, info), path)
    whole = path.read_bytes()
    group = pq.ParquetFile(path).metadata.row_group(0)
    page = next(group.column(i) for i in range(group.num_columns) if group.column(i).path_in_schema == "joint_pos/hip")
    middle = page.data_page_offset + page.total_compressed_size - 40
    for at in (middle, whole.index(b'"source": "a test"') + 12):
        damaged = bytearray(whole)
        damaged[at] ^= 1
        path.write_bytes(bytes(damaged))
        with pytest.raises(InputError):
            read_log(path)


@pytest.mark.parametrize(
    ("about", "says"),
    [
        ({"sample_period_s": True}, "sample_period_s: found true; expected a number from"),
        ({"sample_period_s": "0.01"}, 'sample_period_s: found "0.01"'),
        ({"target": "far"}, 'target: found "far"; expected a JSON object'),
        ({"schedule": "soon"}, 'schedule: found "soon"'),
        (
            {"terrain": [{"x_m": float("nan"), "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}]},
            r"terrain\[0\]\.x_m: found NaN",
        ),
        ({"segments": [{"name": "a", "begin_s": 1.0, "end_s": 0.5}]}, r"segments\[0\]\.end_s: found 0\.5"),
    ],
)
def test_metadata_are_typed_and_bounded(tmp_path: Path, about: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_log(stored(tmp_path, about=about))


def test_bad_logs_are_set_aside_and_all_of_them_are_told(tmp_path: Path) -> None:
    folder = plain_arm.write_parquet(tmp_path / "logs", logs=4)
    (folder / "swing_1.parquet").write_bytes(b"PAR1 no more")
    table = pq.read_table(folder / "swing_3.parquet")
    info = json.loads(table.schema.metadata[b"leapgap"]) | {"sample_period_s": True}
    pq.write_table(table.replace_schema_metadata({"leapgap": json.dumps(info)}), folder / "swing_3.parquet")
    readings = read_folder(folder)
    assert [log.name for log in readings.logs] == ["swing_0", "swing_2"]
    assert [one.name for one in readings.set_aside] == ["swing_1.parquet", "swing_3.parquet"]
    with pytest.raises(InputError, match=r"2 logs that cannot be used:\n.*swing_1.*\n.*swing_3.*sample_period_s"):
        read_logs(folder)
    (folder / "swing_0.parquet").unlink()
    with pytest.raises(InputError, match=r"2 of 3 logs that cannot be used:\n  swing_1.*\n  swing_3.*"):
        read_folder(folder)


def test_an_import_goes_on_without_a_bad_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = plain_arm.write_csv(tmp_path / "tables", logs=3)
    (folder / "swing_1.csv").write_text("time,joint_pos_shoulder\n0,broken\n")
    options = {"columns": {f"{q}/*": f"{q}_*" for q in ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel")}}
    options["columns"] |= {f"{q}/*": f"{q}_*" for q in ("cmd_kp", "cmd_kd")}
    (tmp_path / "options.json").write_text(json.dumps(options))
    model = plain_arm.write_model(tmp_path)
    call = ["import", str(folder), str(model), "--format", "csv", "--options", str(tmp_path / "options.json")]
    assert main([*call, "--out", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").glob("*.parquet")) == ["swing_0.parquet", "swing_2.parquet"]
    assert "set aside swing_1" in capsys.readouterr().err
    (folder / "swing_0.csv").write_text("")
    assert main([*call, "--out", str(tmp_path / "other")]) == 2
    said = capsys.readouterr().err
    assert "swing_0" in said and "swing_1" in said and not (tmp_path / "other").exists()
