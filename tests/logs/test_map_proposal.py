"""Proposed maps of tables whose truth is known: other names, units, signs and orders. Nothing here uses the importers
to make the tables."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from leapgap.cli import main
from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.log import read_logs
from leapgap.logs.map_proposal.joint_columns import families, quantity_by_words, words
from leapgap.logs.map_proposal.report import propose_map
from leapgap.robot.model import Robot
from tests.logs.test_ros import write_mcap
from tests.logs.test_table_formats import write_lerobot
from tests.logs.test_tables import write_table

KP, KD = np.array([40.0, 25.0]), np.array([1.5, 0.8])
DEGREE = np.pi / 180


def motion(rows: int = 1500) -> dict[str, np.ndarray]:
    """An arm that follows sines late, on an uneven clock: shoulder about 0, elbow between −2 and −0.4 rad."""
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.0015, 0.003, rows))
    rate, phase = np.array([7.0, 11.0]), np.array([0.3, 1.0])

    def angle(t: np.ndarray) -> np.ndarray:
        return np.array([0.0, -1.2]) + np.array([0.9, 0.8]) * np.sin(t[:, None] * rate + phase)

    def speed(t: np.ndarray) -> np.ndarray:
        return np.array([0.9, 0.8]) * rate * np.cos(t[:, None] * rate + phase)

    late = time - 0.01
    found = {"time": time, "q": angle(late), "dq": speed(late), "q_set": angle(time), "dq_set": speed(time)}
    torque = KP * (found["q_set"] - found["q"]) + KD * (found["dq_set"] - found["dq"])
    return {**found, "torque": torque + 0.05 * rng.standard_normal(torque.shape)}


def propose(table: Path, arm: Robot) -> tuple[dict, str]:
    text = propose_map(table, arm).text(arm)
    return yaml.safe_load(text)["csv"], text


def test_words_of_names() -> None:
    assert words("tail_meas_AngVel[2]") == ["tail", "meas", "ang", "vel", "2"]
    for name, quantity in {
        "q": "joint_pos",
        "pos_meas": "joint_pos",
        "dof_vel": "joint_vel",
        "tau_est": "tau",
        "des_dof_pos": "cmd_pos",
        "target_qd": "cmd_vel",
        "tau_con": "cmd_tau",
        "motor_cmd kp": "cmd_kp",
        "A1_actual_deg": "joint_pos",
        "A1_actual_deg_s": "joint_vel",
        "A1_target_rad": "cmd_pos",
        "A1_Nm": "tau",
        "motor 3 rpm": "joint_vel",
    }.items():
        assert quantity_by_words(words(name))[0] == quantity, name  # type: ignore[index]
    assert quantity_by_words(words("tau_fric")) is None
    assert quantity_by_words(words("temperature")) is None
    assert quantity_by_words(words("A1_actual")) is None


def test_joints_in_names_by_name_by_number_and_by_other_words() -> None:
    columns = ["q_elbow", "q_shoulder", "v1", "v2", "left_torque", "right_torque", "note", "n1"]
    found = {one.template: one for one in families(columns, ("shoulder", "elbow"))}
    assert found["q_*"].joints == {"elbow": "elbow", "shoulder": "shoulder"}
    assert found["v*"].members == {"1": "v1", "2": "v2"}
    assert found["*_torque"].members == {"left": "left_torque", "right": "right_torque"}


def test_units_signs_and_order_are_found_by_physics(arm: Robot, tmp_path: Path) -> None:
    """Degrees; rpm with the opposite sign; velocities and set points in another order than positions; a clock in µs."""
    truth = motion()
    rpm = 60 / (2 * np.pi)
    columns = {
        "stamp": 1e6 * (100 + truth["time"]),
        "angle_1": truth["q"][:, 0] / DEGREE,
        "angle_2": truth["q"][:, 1] / DEGREE,
        "speed_1": -rpm * truth["dq"][:, 1],
        "speed_2": -rpm * truth["dq"][:, 0],
        "angle_ref_1": truth["q_set"][:, 1],
        "angle_ref_2": truth["q_set"][:, 0],
    }
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["columns"]["time"] == "stamp"
    assert options["columns"]["joint_pos/*"] == "angle_*"
    assert options["joint_names"] == {"1": "shoulder", "2": "elbow"}
    assert options["columns"]["joint_vel/shoulder"] == "speed_2"
    assert options["columns"]["cmd_pos/shoulder"] == "angle_ref_2"
    assert options["units"] == {"time": "us", "joint_pos/*": "deg", "joint_vel/*": "rpm"}
    assert options["factors"] == {"joint_vel/*": -1.0}
    assert "#   velocities of shoulder, elbow are mirror images of their positions; they are turned round" in text
    assert "#   gains of the joint PD: state constants.cmd_kp/*, constants.cmd_kd/*" in text
    assert "cmd_kp/*" not in options["constants"]  # never filled in without a word


def test_without_positions_the_unit_of_velocities_is_missing(arm: Robot, tmp_path: Path) -> None:
    truth = motion(300)
    columns = {"t": truth["time"], "dq0": truth["dq"][:, 0] / DEGREE, "dq1": truth["dq"][:, 1] / DEGREE}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert "units" not in options
    assert "joint_vel/*" not in options["columns"]
    absent = text.partition("Not in the logs, or left out:")[2]
    assert "measured velocities: left out, their unit is unknown without positions" in absent


def test_a_joint_that_counts_backwards_is_found_by_its_limits(arm: Robot, tmp_path: Path) -> None:
    truth = motion()
    columns = {"t": truth["time"], "q0": truth["q"][:, 0], "q1": -truth["q"][:, 1], "dq0": truth["dq"][:, 0]}
    columns |= {"dq1": -truth["dq"][:, 1], "u0": truth["torque"][:, 0], "u1": truth["torque"][:, 1]}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["factors"] == {"joint_pos/*": [1.0, -1.0], "joint_vel/*": [1.0, -1.0]}
    assert "sign of elbow turned round: only so they lie within their limits" in text
    assert "where makers may have another: 0 = shoulder, 1 = elbow\n" in text
    assert "joint_vel is dq*, by its name; its joints are called the same" in text


def test_gains_are_estimated_from_the_measured_torque(arm: Robot, tmp_path: Path) -> None:
    truth = motion()
    columns = {"time": truth["time"]}
    for quantity, name in {"q": "q", "dq": "dq", "q_set": "q_des", "dq_set": "dq_des", "torque": "tau_meas"}.items():
        columns |= {f"{name}_{joint}": truth[quantity][:, i] for i, joint in enumerate(arm.joints)}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert "joint_names" not in options
    assert options["constants"]["cmd_kp/*"] == pytest.approx(KP.tolist(), rel=0.05)
    assert options["constants"]["cmd_kd/*"] == pytest.approx(KD.tolist(), rel=0.05)
    assert options["constants"]["cmd_tau/*"] == 0
    assert "Guessed, check it:" in text.split("gains of the joint PD by least squares")[0]


def test_a_torque_that_was_sent_and_measured_leaves_no_room_for_a_joint_pd(arm: Robot, tmp_path: Path) -> None:
    truth = motion()
    columns = {"time": truth["time"]}
    for i, key in enumerate(("left", "right")):
        columns |= {f"{key}_angle": truth["q"][:, i], f"{key}_angle_ref": truth["q_set"][:, i]}
        columns |= {f"{key}_torque_cmd": truth["torque"][:, i], f"{key}_torque_meas": 0.95 * truth["torque"][:, i]}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["columns"]["cmd_tau/*"] == "*_torque_cmd"
    assert options["joint_names"] == {"left": "shoulder", "right": "elbow"}
    assert options["constants"] == {f"cmd_{name}/*": 0.0 for name in ("pos", "vel", "kp", "kd")}
    assert "the measured torque is 0.95 times the one that was sent" in text


def test_set_points_beside_a_sent_torque_leave_nothing_in_the_map(arm: Robot, tmp_path: Path) -> None:
    """Ticks of an encoder have their zero in the middle of a turn: their offset goes with the columns."""
    truth, turn = motion(), 2 * np.pi / 4096
    columns = {"time": truth["time"]}
    for i, joint in enumerate(arm.joints):
        ticks = {kind: np.round(truth[of][:, i] / turn + 2048) for kind, of in (("angle", "q"), ("angle_ref", "q_set"))}
        columns |= {f"{joint}_{kind}": values for kind, values in ticks.items()}
        columns |= {f"{joint}_torque_{kind}": truth["torque"][:, i] for kind in ("cmd", "meas")}
    path = write_table(tmp_path / "a.csv", columns)
    options, text = propose(path, arm)
    assert options["offsets"].keys() == {"joint_pos/*"} and "cmd_pos is" not in text
    layout = log_format("csv")
    log = layout.read(path, "a", arm, layout.Options(**options))
    assert log["joint_pos/elbow"] == pytest.approx(truth["q"][:, 1], abs=turn)


def test_what_cannot_be_told_is_missing_and_not_assumed(arm: Robot, tmp_path: Path) -> None:
    truth = motion(300)
    columns = {f"{key}_angle": truth["q"][:, 0] + i for i, key in enumerate(("a", "b", "c"))}
    columns |= {f"{key}_speed": truth["dq"][:, 0] + i for i, key in enumerate(("a", "b", "c"))}
    options, text = propose(write_table(tmp_path / "a.csv", {**columns, "row": np.arange(300.0)}), arm)
    assert options == {}
    missing = text.partition("Missing, nothing is assumed:")[2]
    assert "a column with time stamps: map columns.time, or state period_s if the rows are even" in missing
    assert (
        "which of a, b, c is which joint (shoulder, elbow): state joint_names, {theirs: the robot's}, to map "
        "joint_pos: *_angle, joint_vel: *_speed" in missing
    )
    assert "measured positions" not in missing, "they are there, and only their order is not known"
    assert "measured velocities" not in missing
    assert "commands: no column looks like torques or set points that were sent" in missing


def test_gaps_in_the_clock_are_named_with_the_flag_that_cuts_there(arm: Robot, tmp_path: Path) -> None:
    truth = motion(900)
    time = truth["time"] + np.repeat([0.0, 5.0, 9.0], 300)
    columns = {"t": time, "q0": truth["q"][:, 0], "q1": truth["q"][:, 1], "mode": np.repeat([1.0, 2.0, 1.0], 300)}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["cut_by"] == "mode"
    assert "2 gaps of up to 5 s where mode changes: it cuts the file" in text
    columns["mode"] = truth["q"][:, 0]
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert "cut_by" not in options
    assert "what cuts the file at 2 gaps of up to 5 s: cut_by, or pieces" in text


def rolling_box(tmp_path: Path, gyro_unit: float = 1.0) -> tuple[Robot, dict[str, np.ndarray]]:
    """A floating body with a hip that rolls: its columns of the attitude x y z w, and the gyro in a unit of rad/s."""
    free = (
        '<mujoco model="box"><worldbody><body><freejoint/><geom size="0.1"/><body><joint name="hip"/><geom size="0.1"/>'
    )
    motor = '<actuator><general joint="hip" gainprm="1" biastype="affine"/></actuator>'
    (tmp_path / "box.xml").write_text(f"{free}</body></body></worldbody>{motor}</mujoco>")
    time = 0.005 * np.arange(800)
    roll, rate = 0.5 * np.sin(4 * time), 2.0 * np.cos(4 * time) / gyro_unit
    zero = 0 * time
    turn = dict(zip("xyzw", (np.sin(roll / 2), zero, zero, np.cos(roll / 2)), strict=True))
    columns = {"t": time, "q_hip": np.sin(3 * time)}
    columns |= {f"turn_{axis}": one for axis, one in turn.items()}
    return Robot.load(tmp_path / "box.xml"), columns | dict(
        zip(("rate_x", "rate_y", "rate_z"), (rate, zero, zero), strict=True)
    )


def test_the_order_of_a_quaternion_is_told_by_the_gyro(tmp_path: Path) -> None:
    box, truth = rolling_box(tmp_path)
    columns = {name: truth[name] for name in ("t", "q_hip")}
    columns |= {f"imu_quaternion[{i}]": truth[f"turn_{axis}"] for i, axis in enumerate("xyzw")}
    columns |= {f"gyro_{axis}": truth[f"rate_{axis}"] for axis in "xyz"}
    options, text = propose(write_table(tmp_path / "a.csv", columns), box)
    assert options["columns"]["base_quat_w"] == "imu_quaternion[3]"
    assert options["columns"]["base_quat_z"] == "imu_quaternion[2]"
    assert options["columns"]["base_angvel_x"] == "gyro_x"
    assert "the quaternion of the base is x y z w: so it turns as the gyro says" in text
    assert "the gyro is in rad/s: the quaternion turns so" in text
    assert "base_angvel_x" not in options.get("units", {})
    assert "imu_acc, base_linvel, base_pos of the base: left out, as not measured" in text


def test_columns_without_any_number_are_named_and_left_out(tmp_path: Path) -> None:
    box, truth = rolling_box(tmp_path)
    columns = {name: truth[name] for name in ("t", "q_hip")}
    columns |= {f"imu_quaternion[{i}]": np.full(800, np.nan) for i in range(4)}
    np.savez(tmp_path / "a.npz", **columns)
    text = propose_map(tmp_path / "a.npz", box).text(box)
    assert "no number in any sample: imu_quaternion[0] to imu_quaternion[3]" in text
    assert "base_quat_w" not in text


def test_a_base_may_be_named_by_letters_and_its_gyro_be_in_degrees(tmp_path: Path) -> None:
    box, truth = rolling_box(tmp_path, gyro_unit=DEGREE)
    columns = {name: truth[name] for name in ("t", "q_hip")}
    columns |= {f"imu_q{axis}": truth[f"turn_{axis}"] for axis in "xyzw"}
    columns |= {f"g{axis}": truth[f"rate_{axis}"] for axis in "xyz"} | {"battery": truth["t"] + 24.0}
    options, text = propose(write_table(tmp_path / "a.csv", columns), box)
    assert options["columns"]["base_quat_w"] == "imu_qw" and options["columns"]["base_quat_x"] == "imu_qx"
    assert options["columns"]["base_angvel_z"] == "gz" and options["units"]["base_angvel_z"] == "deg/s"
    assert "the gyro is in deg/s: the quaternion turns so" in text


def test_set_points_that_are_followed_loosely_have_the_nearest_unit(arm: Robot, tmp_path: Path) -> None:
    """A soft joint PD lets the robot swing 1.3 times as far as it is told."""
    truth = motion()
    columns = {"t": truth["time"]}
    columns |= {f"q{i}": truth["q"][:, i] / DEGREE for i in range(2)}
    columns |= {f"q_des{i}": truth["q_set"][:, i] / DEGREE / 1.3 for i in range(2)}
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["units"]["cmd_pos/*"] == "deg"
    assert "cmd_pos is in deg, the nearest unit: what is measured moves 1.3 times as far" in text


def test_columns_that_a_map_does_not_use_are_named(arm: Robot, tmp_path: Path) -> None:
    truth = motion()
    columns = {"t": truth["time"]}
    columns |= {f"q{i}": truth["q"][:, i] for i in range(2)}
    columns |= {f"temperature_{i}": 30 + truth["q"][:, 0] for i in range(7)} | {"battery": truth["time"] + 24.0}
    _, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    (line,) = text.partition("# Columns that the map does not use:\n")[2].split("\n# ")[0].split("\n\n")[0].splitlines()
    assert line == "#   temperature_0 to temperature_6, battery"


def test_the_command_prints_a_map_that_can_be_saved_and_used(
    arm: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = motion()
    (tmp_path / "raw").mkdir()
    columns = {"t": truth["time"]}
    for quantity, name in {"q": "q", "dq": "dq", "q_set": "q_des", "dq_set": "dq_des", "torque": "tau_meas"}.items():
        columns |= {f"{name}{i}": truth[quantity][:, i] / (DEGREE if quantity == "q" else 1) for i in range(2)}
    write_table(tmp_path / "raw" / "a.csv", columns)
    assert main(["import", "--guess", str(tmp_path / "raw"), str(tmp_path / "two.xml")]) == 0
    assert not list(tmp_path.rglob("*.parquet"))
    (tmp_path / "map.yaml").write_text(capsys.readouterr().out)
    command = (
        "import",
        tmp_path / "raw",
        tmp_path / "two.xml",
        "--options",
        tmp_path / "map.yaml",
        "--out",
        tmp_path / "x",
    )
    assert main([str(one) for one in command]) == 0
    (log,) = read_logs(tmp_path / "x")
    assert log["joint_pos/elbow"] == pytest.approx(truth["q"][:, 1])
    assert log["joint_vel/elbow"] == pytest.approx(truth["dq"][:, 1])
    assert log["cmd_kp/shoulder"][0] == pytest.approx(KP[0], rel=0.05)


def test_semicolons_are_noticed_and_other_files_refused(arm: Robot, tmp_path: Path) -> None:
    lines = ["t;q0;q1", *(f"{0.01 * row};{0.001 * row};{-0.5 - 0.001 * row}" for row in range(50))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    options, _ = propose(tmp_path / "a.csv", arm)
    assert options["delimiter"] == ";"
    assert options["columns"]["joint_pos/*"] == "q*"
    (tmp_path / "a.docx").write_text("x")
    with pytest.raises(InputError, match=r"a\.docx: found no file of a known format; expected one of csv, hdf5"):
        propose_map(tmp_path / "a.docx", arm)


def test_recordings_and_datasets_are_proposed_for_too(arm: Robot, tmp_path: Path) -> None:
    """LowState and LowCmd of a Unitree robot with a motor more than the model; episodes whose time begins anew."""
    options = yaml.safe_load(propose_map(write_mcap(tmp_path / "walk"), arm).text(arm))["ros"]
    assert options["columns"]["joint_pos/*"] == "/lowstate/motor_state[*].q"
    assert options["columns"]["cmd_tau/*"] == "/lowcmd/motor_cmd[*].tau"
    assert options["columns"]["cmd_kp/*"] == "/lowcmd/motor_cmd[*].kp"
    assert options["joint_names"] == {"0": "shoulder", "1": "elbow"}
    options = yaml.safe_load(propose_map(write_lerobot(tmp_path / "arm_data"), arm).text(arm))["lerobot"]
    assert options["columns"]["time"] == "timestamp"
    assert options["columns"]["joint_pos/*"] == "observation.state.*.pos"


def test_many_small_arrays_beside_the_log_do_not_hide_it(arm: Robot, tmp_path: Path) -> None:
    """Calibration matrices, pictures and texts of an archive; rows across in the positions."""
    truth = motion(400)
    extra = {f"camera_{i}": np.eye(3) for i in range(9)} | {"picture": np.zeros((5, 60, 80)), "note": np.array("x")}
    np.savez(tmp_path / "a.npz", t=truth["time"], q=truth["q"].T, dq=truth["dq"], **extra)
    options = yaml.safe_load(propose_map(tmp_path / "a.npz", arm).text(arm))["npz"]
    assert options["columns"] == {"time": "t", "joint_pos/*": "q[*]", "joint_vel/*": "dq[*]"}


@pytest.mark.parametrize("late", [True, False], ids=["last stamp first", "one set point"])
def test_the_unit_of_set_points_without_two_rows_beside_others_is_asked_for(
    arm: Robot, tmp_path: Path, late: bool
) -> None:
    truth = motion(300)
    columns = {"time": np.roll(truth["time"], 1) if late else truth["time"]}
    columns |= {f"{name}_{i}": truth[name][:, i] for name in ("q", "dq", "q_set") for i in (0, 1)}
    if not late:
        columns["q_set_1"] = np.where(np.arange(300) < 1, columns["q_set_1"], np.nan)
    options, text = propose(write_table(tmp_path / "a.csv", columns), arm)
    assert options["units"]["cmd_pos/*"] == "?"
    assert "the unit of cmd_pos: no two rows" in text
