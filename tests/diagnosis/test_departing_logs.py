"""Logs that depart from their fellows are found; logs that only differ are not."""

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from leapgap.cli import main
from leapgap.diagnosis.departing_logs import without_departing
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from tests import plain_arm
from tests.conftest import standing
from tests.hostile.base_logs import JOINTS, KD, KP, Columns, arm_log

INFO = LogInfo("arm", 0.01, "a test")


def arms(number: int = 4, **harmed: np.ndarray) -> list[Log]:
    """Logs of the arm, the second one with columns that are changed."""
    logs: list[Columns] = [arm_log(k) for k in range(number)]
    logs[1] |= harmed
    return [Log(f"log_{k}", columns, INFO) for k, columns in enumerate(logs)]


def spike(name: str, height: float) -> dict[str, np.ndarray]:
    values = arm_log(1)[name].copy()
    values[60] += height
    return {name: values}


def degrees() -> dict[str, np.ndarray]:
    names = [name for name in arm_log(1) if name.startswith(("joint_pos", "joint_vel", "cmd_pos", "cmd_vel"))]
    return {name: np.rad2deg(arm_log(1)[name]) for name in names}


@pytest.mark.parametrize(
    ("harmed", "says"),
    [
        (spike("joint_pos/hip", 0.6), "joint_pos/hip has a spike of a few samples"),
        (spike("joint_vel/hip", -60.0), "joint_vel/hip has a spike of a few samples"),
        (spike("cmd_kp/hip", 30.0), "cmd_kp/hip has a spike of a few samples"),
        (spike("tau/knee", 400.0), "tau/knee has a spike of a few samples"),
        (degrees(), "positions and set points of its joints are"),
        ({"tau/hip": 1e3 * arm_log(1)["tau/hip"]}, "tau/hip is 1e+03 times what belongs to it"),
    ],
)
def test_a_log_that_departs_is_left_out_and_named(harmed: dict, says: str) -> None:
    kept, aside = without_departing(arms(**harmed))
    assert [log.name for log in kept] == ["log_0", "log_2", "log_3"]
    assert [one.name for one in aside] == ["log_1"] and says in aside[0].reason


def steps() -> dict[str, np.ndarray]:
    """The arm held still but for two steps of its set points: it gets there in two rows, in which its PD pulls."""
    found, row = {}, np.arange(160)
    for joint in JOINTS:
        wanted = np.where((row > 60) & (row < 120), 0.4, 0.0)
        position = wanted.copy()
        for begin, change in ((61, 0.4), (120, -0.4)):
            position[begin : begin + 3] -= change * np.array([1.0, 0.3, 0.05])
        velocity = np.gradient(position, 0.01)
        found |= {f"cmd_pos/{joint}": wanted, f"joint_pos/{joint}": position, f"joint_vel/{joint}": velocity}
        found |= {f"cmd_vel/{joint}": 0 * wanted, f"cmd_tau/{joint}": 0 * wanted}
        found[f"tau/{joint}"] = KP * (wanted - position) - KD * velocity
    return found


def test_a_robot_that_is_held_and_steps_departs_from_nothing() -> None:
    kept, aside = without_departing(arms(**steps()))
    assert len(kept) == 4 and not aside, [one.reason for one in aside]


def test_a_sensor_that_stands_while_its_joint_is_asked_to_step_departs() -> None:
    held = np.full(160, 0.1)
    stands = {"joint_pos/hip": held, "joint_vel/hip": 0 * held, "tau/hip": KP * (steps()["cmd_pos/hip"] - held)}
    _, aside = without_departing(arms(**steps() | stands))
    assert [one.name for one in aside] == ["log_1"] and "hip stands still while it is asked to" in aside[0].reason


def test_two_logs_are_never_left_with_one(robot: Robot) -> None:
    kept, aside = without_departing(arms(2, **spike("joint_pos/hip", 0.6)))
    assert len(kept) == 2 and not aside


def test_a_clock_a_pause_and_a_step_of_the_command_are_no_departure() -> None:
    step = np.where(np.arange(160) > 80, 5.0, 0.0)
    sent = {name: arm_log(1)[name] + step for name in ("cmd_tau/hip", "tau/hip")}
    slow = arms(**sent, time=1.1 * arm_log(1)["time"])
    assert without_departing(slow)[1] == []
    still = {name: np.full(160, values[0]) for name, values in arm_log(1).items() if name not in ("time",)}
    noise = np.random.default_rng(1)
    for name in [name for name in still if name.startswith(("joint_", "tau/"))]:
        still[name] = still[name] + 1e-4 * noise.standard_normal(160)
    assert without_departing(arms(**still))[1] == []


def swings(number: int = 4) -> list[dict[str, np.ndarray]]:
    """Logs of the arm of the guide, by plain MuJoCo."""
    return [plain_arm.swing(k) for k in range(number)]


def left_out(columns: list[dict[str, np.ndarray]]) -> dict[str, str]:
    logs = [Log(f"log_{k}", of_log, LogInfo("arm", 0.001, "a test")) for k, of_log in enumerate(columns)]
    return {one.name: one.reason for one in without_departing(logs)[1]}


def test_a_log_with_gains_of_zero_that_follows_its_set_points_is_left_out() -> None:
    logs = swings()
    logs[2] |= {name: np.zeros(2000) for name in logs[2] if name.startswith(("cmd_kp", "cmd_kd"))}
    found = left_out(logs)
    assert set(found) == {"log_2"}
    assert "its gains of shoulder, elbow are 0, and the joints follow their set points" in found["log_2"]


@pytest.mark.parametrize("logged_as_set_point", [True, False])
def test_a_robot_that_was_really_let_go_is_kept(logged_as_set_point: bool) -> None:
    """Without gains nobody is near his set points, unless these are where he is."""
    logs = swings()
    names = [name for name in logs[2] if name.startswith(("cmd_kp", "cmd_kd"))]
    logs[2] |= {name: np.zeros(2000) for name in names}
    for joint in plain_arm.JOINTS:
        if logged_as_set_point:
            logs[2][f"cmd_pos/{joint}"] = logs[2][f"joint_pos/{joint}"]
        else:
            logs[2][f"joint_pos/{joint}"] = logs[3][f"joint_pos/{joint}"]
            logs[2][f"joint_vel/{joint}"] = logs[3][f"joint_vel/{joint}"]
    assert left_out(logs) == {}


@pytest.mark.parametrize(("rows", "says"), [(200, "late"), (-200, "early")])
def test_a_log_whose_commands_are_of_another_time_is_left_out(rows: int, says: str) -> None:
    logs = swings()
    for name in [name for name in logs[1] if name.startswith("cmd_")]:
        logs[1][name] = np.roll(logs[1][name], rows)
    found = left_out(logs)
    assert set(found) == {"log_1"}
    told = re.fullmatch(r".*: commands are (\d+) ms too (early|late)", found["log_1"])
    assert told and told[2] == says and float(told[1]) == pytest.approx(200, abs=15)


def test_a_robot_that_is_late_in_every_log_and_by_a_little_more_in_one_is_kept() -> None:
    logs = swings()
    for k, of_log in enumerate(logs):
        for name in [name for name in of_log if name.startswith("cmd_")]:
            of_log[name] = np.roll(of_log[name], -100 - 5 * k)
    assert left_out(logs) == {}


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-7])
def test_a_copy_with_a_little_noise_is_a_copy(noise: float) -> None:
    logs, rng = swings(), np.random.default_rng(3)
    logs[3] = {name: values + noise * rng.standard_normal(2000) for name, values in logs[0].items()}
    logs[3]["time"] = logs[0]["time"]
    found = left_out(logs)
    assert set(found) == {"log_3"} and "equal to log_0 in every column" in found["log_3"]
    assert ("but for less than 5 % of its noise" in found["log_3"]) == (noise > 0)


@pytest.mark.parametrize("rows", [slice(0, 900), slice(700, 2000), slice(1, 2000)])
def test_a_piece_of_another_log_is_left_out(rows: slice) -> None:
    """The longer one stays, whichever comes first."""
    logs = swings()
    logs[0] = {name: values[rows].copy() for name, values in logs[3].items()}
    logs[0]["time"] -= logs[0]["time"][0]
    assert left_out(logs) == {"log_0": "it is a part of log_3, which says nothing more"}


def test_a_second_run_of_the_same_commands_is_no_copy() -> None:
    """Two runs differ by the noise of their sensors, however well the robot repeats itself."""
    logs, rng = swings(3), np.random.default_rng(3)
    again = {name: values.copy() for name, values in logs[0].items()}
    for name in again:
        if name.startswith("joint_"):
            noise = 2e-4 if "pos" in name else 5e-3
            again[name] += noise * rng.standard_normal(2000)
    assert left_out([*logs, again]) == {}


def test_signs_of_quaternions_that_flip_from_row_to_row_are_no_spike(robot: Robot) -> None:
    logs = []
    for k in range(4):
        tilt = 0.3 * np.sin(np.arange(400) * 0.01 + k)
        columns = {"base_quat_w": np.cos(tilt / 2), "base_quat_y": np.sin(tilt / 2)}
        if k == 1:
            signs = np.random.default_rng(4).choice([-1.0, 1.0], 400)
            columns = {name: signs * values for name, values in columns.items()}
        logs.append(replace(standing(robot, **columns), name=f"log_{k}"))
    assert without_departing(logs)[1] == []
    assert np.abs(np.diff(logs[1]["base_quat_w"])).max() < 0.01
    assert np.abs(logs[1].pitch - 0.3 * np.sin(np.arange(400) * 0.01 + 1)).max() < 1e-12


def test_no_published_jump_departs(robot: Robot) -> None:
    if "LEAPGAP_RAW" not in os.environ:
        pytest.skip("no published jumps: set LEAPGAP_RAW")
    layout = log_format("published")
    found = layout.find(Path(os.environ["LEAPGAP_RAW"])).items()
    logs = [layout.read(path, name, robot, layout.Options()) for name, path in found]
    assert len(logs) == 16 and without_departing(logs)[1] == []


def test_a_diagnosis_goes_on_and_names_what_it_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, model = plain_arm.write_parquet(tmp_path / "logs", logs=5), plain_arm.write_model(tmp_path)
    (folder / "swing_1.parquet").write_bytes(b"no Parquet")
    table = pq.read_table(folder / "swing_3.parquet")
    values = table["joint_pos/elbow"].to_numpy().copy()
    values[200] += 1.0
    place = table.column_names.index("joint_pos/elbow")
    pq.write_table(table.set_column(place, "joint_pos/elbow", [values]), folder / "swing_3.parquet")
    call = [
        "diagnose",
        str(folder),
        str(model),
        "--effects",
        "joint_damping",
        "--quiet",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(call) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert sorted(report["set_aside"]) == ["swing_1.parquet", "swing_3"]
    assert "joint_pos/elbow has a spike" in report["set_aside"]["swing_3"]
    assert sorted(report["gap_per_log"]) == ["swing_0", "swing_2", "swing_4"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Left out: swing_3: joint_pos/elbow has a spike" in page and "Left out: swing_1.parquet" in page
    assert report["answer"] == [["joint_damping"]]
    assert "left out swing_3" in capsys.readouterr().out


def test_what_is_unusual_of_a_robot_or_a_log_stands_in_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No answer of a model whose gravity points sideways can be trusted: whoever reads the report must see it."""
    folder, model = plain_arm.write_parquet(tmp_path / "logs", logs=3), plain_arm.write_model(tmp_path)
    model.write_text(model.read_text().replace("<worldbody>", '<option gravity="9.81 0 0"/><worldbody>', 1))
    rows = pq.read_table(folder / "swing_1.parquet")
    pq.write_table(pa.concat_tables([rows.slice(0, 400), rows.slice(420)]), folder / "swing_1.parquet")
    out = tmp_path / "out"
    call = ["diagnose", str(folder), str(model), "--effects", "joint_damping", "--quiet", "--out", str(out)]
    assert main(call) == 0
    notes = [
        "arm: gravity is (9.81, 0, 0) m/s², not 9.81 m/s² downwards",
        "swing_1: about 20 samples lost in 1 places, the first after row 399",
    ]
    assert json.loads((out / "report.json").read_text())["notes"][:2] == notes
    page, said = (out / "report.html").read_text(), capsys.readouterr()
    for note in notes:
        assert f"Note: {note}" in page
        assert said.out.count(note) == 1 and note not in said.err
