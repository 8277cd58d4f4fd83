"""Traps that owners' logs set a proposed map: each is told in the right words, asked about, or read rightly."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from leapgap.cli import main
from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log, LogInfo, read_logs, write_log
from leapgap.logs.map_proposal.evidence import ABSENT, GUESSED, MISSING, SURE
from leapgap.logs.map_proposal.report import propose_map
from leapgap.robot.model import Robot
from tests.logs import foreign_logs
from tests.logs.foreign_logs import ARM, ARM_LIMITS, DEGREE, motion
from tests.logs.test_tables import NO_COMMANDS, write_table

PENDULUM = """<mujoco model="pendulum"><compiler angle="radian"/><worldbody><body>
<joint name="hinge" axis="0 1 0" range="-3.14159 3.14159"/><geom size="0.05" pos="0 0 -0.3"/></body></worldbody>
<actuator><position joint="hinge" kp="5"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    (tmp_path / "arm.xml").write_text(foreign_logs.arm_xml())
    return Robot.load(tmp_path / "arm.xml")


@pytest.fixture
def pendulum(tmp_path: Path) -> Robot:
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    return Robot.load(tmp_path / "pendulum.xml")


def moved(rate_hz: float = 100.0, share: float = 0.5) -> dict[str, np.ndarray]:
    """Columns of an arm in SI, named by its joints."""
    time, wanted, position, velocity = motion(np.random.default_rng(1), ARM_LIMITS, rate_hz, share)
    columns = {"t": time}
    for i, joint in enumerate(ARM):
        columns |= {f"q_{joint}": position[:, i], f"dq_{joint}": velocity[:, i], f"q_des_{joint}": wanted[:, i]}
    return columns


def as_text(columns: dict[str, np.ndarray], delimiter: str, point: str, before: str = "", header: bool = True) -> str:
    """A table as spreadsheets and NumPy write it."""
    rows = [
        delimiter.join(f"{value:.6f}".replace(".", point) for value in row)
        for row in zip(*columns.values(), strict=True)
    ]
    return "\n".join([before + delimiter.join(columns)] * header + rows)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (as_text(moved(), ",", "."), {}),
        (as_text(moved(), ";", ","), {"delimiter": ";", "decimal_point": ","}),
        (as_text(moved(), "\t", ","), {"delimiter": "\t", "decimal_point": ","}),
        (as_text(moved(), ",", ".", "# recorded today, by hand\n"), {"skip_rows": 1}),
        (
            as_text(moved(), ";", ",", "% recorded; today\n%\n"),
            {"skip_rows": 2, "delimiter": ";", "decimal_point": ","},
        ),
        (as_text(moved(), " ", ".", "# "), {"delimiter": " "}),
        (as_text(moved(), ",", ".", "# "), {}),
    ],
)
def test_tables_of_spreadsheets_and_numpy_are_read_as_they_are_written(
    arm: Robot, tmp_path: Path, text: str, options: dict
) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = propose_map(tmp_path / "a.csv", arm)
    assert found.proposal.notes_of(MISSING) == []
    written = {
        key: found.options[key] for key in ("skip_rows", "delimiter", "decimal_point", "header") if key in found.options
    }
    assert written == options


@pytest.mark.parametrize(("whole", "rest"), [("sec", "nsec"), ("header.stamp.sec", "header.stamp.nanosec")])
def test_seconds_and_nanoseconds_in_two_columns_are_one_clock(
    arm: Robot, tmp_path: Path, whole: str, rest: str
) -> None:
    columns = moved()
    stamp = 1_700_000_000_700_000_000 + np.round(1e9 * columns.pop("t")).astype(np.int64)
    np.savez(tmp_path / "a.npz", **{whole: stamp // 10**9, rest: stamp % 10**9}, **columns)
    found = propose_map(tmp_path / "a.npz", arm)
    assert found.options["columns"]["time"] == {whole: 1, rest: 1e-9}
    assert any(
        one.startswith(f"time is {whole} and {rest} in s: steps of 10 ms") for one in found.proposal.notes_of(SURE)
    )
    assert not any(whole in one for one in found.proposal.notes_of("unused"))
    assert main(["import", str(tmp_path / "a.npz"), str(tmp_path / "arm.xml"), "--out", str(tmp_path / "logs")]) == 0
    assert read_logs(tmp_path / "logs")[0].time == pytest.approx(moved()["t"], abs=1e-9)


def test_arrays_in_json_go_by_the_names_beside_them(arm: Robot, tmp_path: Path) -> None:
    """As messages of joint states do, whose order is not the one of the model."""
    columns, order = moved(), ["rolling", "panning", "flexing", "lifting"]
    lines = [
        {
            "stamp": columns["t"][row],
            "state": {"name": order}
            | {
                kind: [columns[f"{head}_{joint}"][row] for joint in order]
                for kind, head in (("position", "q"), ("velocity", "dq"), ("target", "q_des"))
            },
        }
        for row in range(len(columns["t"]))
    ]
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, lines)))
    assert propose_map(tmp_path / "a.jsonl", arm).options["columns"]["joint_pos/*"] == "state.position[*]"
    assert main(["import", str(tmp_path / "a.jsonl"), str(tmp_path / "arm.xml"), "--out", str(tmp_path / "logs")]) == 0
    (log,) = read_logs(tmp_path / "logs")
    for joint in ARM:
        assert log[f"joint_pos/{joint}"] == pytest.approx(columns[f"q_{joint}"])


def test_one_number_for_all_steps_is_the_period(arm: Robot, tmp_path: Path) -> None:
    columns = {name: values for name, values in moved().items() if name != "t"}
    np.savez(tmp_path / "a.npz", sim_dt=0.01, **columns)
    found = propose_map(tmp_path / "a.npz", arm)
    assert found.options["period_s"] == 0.01 and found.proposal.notes_of(MISSING) == []
    assert "the spacing of the samples is sim_dt" in found.proposal.notes_of(GUESSED)


def test_numbers_with_decimal_commas_and_no_names_are_told_from_names(arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(as_text(moved(), ";", ",", header=False))
    found = propose_map(tmp_path / "a.csv", arm)
    assert found.options["header"] is False and found.options["decimal_point"] == ","
    assert "names of the columns: a.csv has no header" in " ".join(found.proposal.notes_of(MISSING))


def test_limits_of_a_pendulum_that_turns_over_prove_no_degrees(pendulum: Robot, tmp_path: Path) -> None:
    time = 0.01 * np.arange(600)
    columns = {"t": time, "q": 7 * np.sin(1.5 * time), "dq": 10.5 * np.cos(1.5 * time), "u": np.cos(time)}
    found = propose_map(write_table(tmp_path / "a.csv", columns), pendulum)
    assert not any("positions" in one or "velocities" in one for one in found.proposal.notes_of(SURE))
    assert any("positions are in rad: deg" in one for one in found.proposal.notes_of(GUESSED))


def test_limits_that_are_too_tight_prove_no_degrees(tmp_path: Path) -> None:
    model = foreign_logs.arm_xml().replace("1.9", "1.0").replace("2.8", "1.2").replace("-2.7", "-1.2")
    (tmp_path / "arm.xml").write_text(model)
    columns = {name: 1.3 * values if "q" in name else values for name, values in moved(share=0.9).items()}
    found = propose_map(write_table(tmp_path / "a.csv", columns), Robot.load(tmp_path / "arm.xml"))
    assert not any("positions are" in one for one in found.proposal.notes_of(SURE))


@pytest.mark.parametrize(("late_s", "sign"), [(0.0, -1.0), (0.15, 1.0)])
def test_a_mirror_image_is_told_from_a_late_robot(arm: Robot, tmp_path: Path, late_s: float, sign: float) -> None:
    """Single sines of 2 Hz: mirrored set points, and set points that are followed 0.15 s late."""
    time = 0.01 * np.arange(500)
    columns = {"t": time}
    for i, joint in enumerate(ARM):
        columns[f"q_{joint}"] = 0.5 * np.sin(2 * np.pi * 2 * (time - late_s - 0.02) + i)
        columns[f"q_des_{joint}"] = sign * 0.5 * np.sin(2 * np.pi * 2 * time + i)
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert any("are mirror images of the measured ones" in one for one in found.proposal.notes_of(GUESSED)) == (
        sign < 0
    )
    assert found.options.get("factors", {}).get("cmd_pos/*", 1.0) == sign


def test_a_joint_that_tells_no_sign_is_turned_with_the_others(arm: Robot, tmp_path: Path) -> None:
    columns = moved()
    for joint in ARM:
        columns[f"q_des_{joint}"] = -columns[f"q_des_{joint}"]
    columns[f"q_des_{ARM[2]}"] = 0.3 + 0 * columns["t"]
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert found.options["factors"]["cmd_pos/*"] == -1.0
    assert any(f"and with them {ARM[2]}, of unknown sign" in one for one in found.proposal.notes_of(GUESSED))


def test_joints_that_move_alike_keep_their_columns(arm: Robot, tmp_path: Path) -> None:
    columns = moved()
    for kind in ("q", "dq", "q_des"):
        columns[f"{kind}_{ARM[1]}"] = columns[f"{kind}_{ARM[0]}"]
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert found.options["columns"]["joint_vel/*"] == "dq_*" and found.options["columns"]["cmd_pos/*"] == "q_des_*"


def test_a_counter_of_ticks_is_asked_about_unless_velocities_tell(arm: Robot, tmp_path: Path) -> None:
    columns = moved(1000.0)
    ticks = {"tick": np.arange(float(len(columns["t"])))}
    with_rates = {**ticks, **{name: values for name, values in columns.items() if name != "t"}}
    found = propose_map(write_table(tmp_path / "a.csv", with_rates), arm)
    assert found.options["units"]["time"] == "ms" and not found.proposal.notes_of(SURE)
    found = propose_map(
        write_table(tmp_path / "b.csv", {k: v for k, v in with_rates.items() if not k.startswith("dq")}), arm
    )
    assert "the time: tick counts up by 1, ms or rows" in found.proposal.notes_of(MISSING)[0]
    with pytest.raises(InputError, match=r"questions that the logs do not answer:\n  the time: tick counts up by 1"):
        found.answered(tmp_path, arm.path)


def test_torques_that_nobody_measured_are_left_out(arm: Robot, tmp_path: Path) -> None:
    columns = moved() | {f"tau_{joint}": np.zeros(len(moved()["t"])) for joint in ARM}
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert "tau/*" not in found.options["columns"]
    assert "measured torques: left out, they are 0 in all samples" in found.proposal.notes_of(ABSENT)


def test_positions_counted_from_a_pose_are_asked_about(tmp_path: Path) -> None:
    """A calf never is at zero; and as shares of a hundred no joint would move by more than two of them."""
    (tmp_path / "quadruped.xml").write_text(foreign_logs.quadruped_xml())
    time, wanted, position, velocity = motion(np.random.default_rng(1), foreign_logs.QUADRUPED_LIMITS, 50.0, 0.5)
    columns = {"t": time}
    for i, joint in enumerate(foreign_logs.QUADRUPED):
        columns |= {f"q_{joint}": position[:, i] - position[0, i], f"dq_{joint}": velocity[:, i]}
        columns[f"q_des_{joint}"] = wanted[:, i] - position[0, i]
    found = propose_map(write_table(tmp_path / "a.csv", columns), Robot.load(tmp_path / "quadruped.xml"))
    assert any("check the order of joints, units and offsets" in one for one in found.proposal.notes_of(MISSING))


def test_a_packed_text_is_proposed_as_the_text_is(arm: Robot, tmp_path: Path) -> None:
    plain = write_table(tmp_path / "a.csv", moved())
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(plain.read_bytes()))
    assert propose_map(tmp_path / "b.csv.gz", arm).options == propose_map(plain, arm).options


def test_a_log_of_ours_is_not_imported_again(arm: Robot, tmp_path: Path) -> None:
    time = moved()["t"]
    of_joints = ("joint_pos", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    columns = {"time": time} | {f"{of}/{joint}": 0 * time for of in of_joints for joint in arm.joints}
    write_log(Log("a", columns, LogInfo(arm.name, 0.01, "a test")), tmp_path / "a.parquet")
    with pytest.raises(InputError, match="a log of leapgap already; expected logs of another format"):
        propose_map(tmp_path, arm)


def test_a_log_of_two_thousand_seconds_is_refused(arm: Robot, tmp_path: Path) -> None:
    columns = {"time": np.arange(2000.0)} | {f"joint_pos/{joint}": 0.1 * np.sin(np.arange(2000.0)) for joint in ARM}
    path = write_table(tmp_path / "a.csv", columns)
    layout = log_format("csv")
    with pytest.raises(InputError, match=r"2000 rows of 1000 ms, 1999 s in all; .*units: .time"):
        layout.read(path, "a", arm, layout.Options(constants=NO_COMMANDS))


def test_actions_of_a_policy_are_no_set_points(arm: Robot, tmp_path: Path) -> None:
    columns = moved()
    for i, joint in enumerate(ARM):
        wanted = columns.pop(f"q_des_{joint}")
        columns[f"actions_{joint}"] = (wanted - 0.5 * (-1) ** i) / 0.25
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert any("the scale of cmd_pos" in one for one in found.proposal.notes_of(MISSING))
    assert found.options["units"]["cmd_pos/*"] == "?"


@pytest.mark.parametrize("uneven", [False, True])
def test_lengths_of_steps_stand_in_for_a_time(arm: Robot, tmp_path: Path, uneven: bool) -> None:
    columns = moved()
    time = columns.pop("t")
    steps = np.full(len(time), 0.01) + (0.001 * np.sin(np.arange(len(time))) if uneven else 0.0)
    path = write_table(tmp_path / "a.csv", {"dt": steps, **columns})
    found = propose_map(path, arm)
    layout = log_format("csv")
    log = layout.read(path, "a", arm, layout.Options(**found.answered(path, arm.path)))
    assert log.time == pytest.approx(np.concatenate([[0], np.cumsum(steps[:-1])]), abs=1e-9)


@pytest.mark.parametrize(
    "names",
    [("t", "q", "dq", "q_des"), ("time", "position", "velocity", "goal_position"), ("stamp", "theta", "omega", "cmd")],
)
def test_a_bench_of_one_joint_needs_no_names(pendulum: Robot, tmp_path: Path, names: tuple[str, ...]) -> None:
    time = 0.01 * np.arange(400)
    values = (time, 0.8 * np.sin(3 * time - 0.1), 2.4 * np.cos(3 * time - 0.1), 0.8 * np.sin(3 * time))
    path = write_table(tmp_path / "a.csv", dict(zip(names, values, strict=True)))
    columns = propose_map(path, pendulum).answered(path, pendulum.path)["columns"]
    assert columns == dict(zip(("time", "joint_pos/*", "joint_vel/*", "cmd_pos/*"), names, strict=True))


def test_numbers_of_columns_may_begin_at_one(arm: Robot, tmp_path: Path) -> None:
    columns = moved()
    numbered = {"t": columns["t"]} | {f"m{i}": columns[f"q_{joint}"] for i, joint in enumerate(ARM[::-1], 1)}
    layout = log_format("csv")
    options = layout.Options(
        columns={"time": "t", "joint_pos/*": "m*"}, joint_order=list(ARM[::-1]), constants=NO_COMMANDS
    )
    log = layout.read(write_table(tmp_path / "a.csv", numbered), "a", arm, options)
    for joint in ARM:
        assert log[f"joint_pos/{joint}"] == pytest.approx(columns[f"q_{joint}"])


def test_texts_cut_a_log_and_drop_rows(arm: Robot, tmp_path: Path) -> None:
    columns = {name: values[:90] for name, values in moved().items() if name == "t" or name.startswith("q_")}
    phase, state = ["warm up"] * 30 + ["run"] * 40 + ["stop"] * 20, ["ok", "ok", "lost"] * 30
    lines = [",".join([*columns, "phase", "state"])]
    lines += [
        ",".join([*(repr(float(one)) for one in row), phase[at], state[at]])
        for at, row in enumerate(zip(*columns.values(), strict=True))
    ]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found = propose_map(tmp_path / "a.csv", arm)
    assert "texts, which can cut the log or drop rows (cut_by, drop_rows): phase, state" in found.text(arm)
    layout = log_format("csv")
    cut = {"cut_by": "phase", "cut_values": ["run"], "drop_rows": {"state": ["lost"]}}
    (log,) = layout.read_all(tmp_path / "a.csv", "a", arm, layout.Options(**found.options, **cut))
    assert len(log) == sum(p == "run" and s == "ok" for p, s in zip(phase, state, strict=True))


def test_a_table_without_a_header_is_asked_about(arm: Robot, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", np.stack(list(moved().values()), axis=1), delimiter=",")
    found = propose_map(tmp_path / "a.csv", arm)
    assert found.options["header"] is False
    assert any("a.csv has no header" in one for one in found.proposal.notes_of(MISSING))


def test_a_run_in_two_files_is_told(arm: Robot, tmp_path: Path) -> None:
    run = tmp_path / "runs" / "one"
    run.mkdir(parents=True)
    columns = moved()
    for name, kind in (("measured", "q"), ("sent", "q_des")):
        write_table(run / f"{name}.csv", {"t": columns["t"]} | {f"{kind}_{j}": columns[f"{kind}_{j}"] for j in ARM})
    found = propose_map(run, arm)
    assert "other columns in sent.csv: if they are of the same run, join them" in found.proposal.notes_of(MISSING)[-1]
    with pytest.raises(
        InputError, match=r"found files in folders, such as measured.csv; .* name .*one; where a run is"
    ):
        propose_map(tmp_path / "runs", arm)


def test_lists_in_cells_are_vectors(arm: Robot, tmp_path: Path) -> None:
    columns = moved()
    position = np.stack([columns[f"q_{joint}"] for joint in ARM], axis=1)
    lines = ["t,q", *(f'{t},"{row.tolist()}"' for t, row in zip(columns["t"].tolist(), position, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert propose_map(tmp_path / "a.csv", arm).options["columns"]["joint_pos/*"] == "q[*]"
    (tmp_path / "b.csv").write_text("\n".join([*lines[:5], '0.04,"[1.0, 2.0]"']))
    with pytest.raises(InputError, match=r"column q, row 4: found 2 items; expected 4, as in row 0"):
        log_format("csv").read_table(tmp_path / "b.csv", log_format("csv").Options(), lambda _: True)


@pytest.mark.parametrize("layout", ["records", "lines", "held"])
def test_json_of_records(arm: Robot, tmp_path: Path, layout: str) -> None:
    columns = moved()
    records = [
        {"t": t, "state": {"q": [float(columns[f"q_{joint}"][row]) for joint in ARM]}}
        for row, t in enumerate(columns["t"].tolist())
    ]
    path = tmp_path / ("a.jsonl" if layout == "lines" else "a.json")
    held = {"robot": "arm", "samples": records} if layout == "held" else records
    path.write_text("\n".join(map(json.dumps, records)) if layout == "lines" else json.dumps(held))
    options = propose_map(path, arm).options
    assert options["columns"] == {"time": "t", "joint_pos/*": "state.q[*]"}
    json_format = log_format("json")
    log = json_format.read(path, "a", arm, json_format.Options(**{**options, "constants": NO_COMMANDS}))
    assert log[f"joint_pos/{ARM[2]}"] == pytest.approx(columns[f"q_{ARM[2]}"])


@pytest.mark.parametrize(
    "text",
    ["", "3", "[]", "[1, 2]", "{", '[{"t": 1}, {"q": 2}]', "[" * 100_000, '{"t": [1, {"a": 1}]}', "[" + "9" * 5000],
)
def test_json_that_is_no_log_is_refused(arm: Robot, tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError):
        propose_map(tmp_path / "a.json", arm).answered(tmp_path, arm.path)


def write_sage(folder: Path, columns: dict[str, np.ndarray], names: tuple[str, ...] = ARM) -> Path:
    """A run in the layout of SAGE; commands 1.2 ms before measurements."""
    folder.mkdir(parents=True)

    def table(name: str, shift_us: float, parts: dict[str, str]) -> None:
        lines = [",".join(["type", "timestamp", *parts])]
        for row, t in enumerate(columns["t"].tolist()):
            vectors = [
                '"' + json.dumps([float(columns[f"{kind}_{joint}"][row]) for joint in ARM]) + '"'
                for kind in parts.values()
            ]
            lines.append(",".join([name.upper(), repr(1e6 * t + shift_us), *vectors]))
        (folder / f"{name}.csv").write_text("\n".join(lines))

    table("control", 0.0, {"positions": "q_des"})
    table("state_motor", 1200.0, {"positions": "q", "velocities": "dq"})
    (folder / "joint_list.txt").write_text("\n".join(names) + "\n")
    events = "type,timestamp,event\nEVENT,0,CONTROL_MODE_ENABLE\nEVENT,100000,MOTION_START\nEVENT,5000000,DISABLE\n"
    (folder / "event.csv").write_text(events)
    return folder


def test_sage_runs_import_in_one_command(arm: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = moved(50.0)
    for run in ("swing", "wave"):
        write_sage(tmp_path / "runs" / run, columns, ("Base", "Upper", "Fore", "Hand"))
    assert main(["import", str(tmp_path / "runs"), str(arm.path), "--out", str(tmp_path / "logs")]) == 0
    printed = capsys.readouterr()
    assert "gains of the joint PD unknown" in printed.out and "guessed: positions are in rad: deg" in printed.err
    log, _ = read_logs(tmp_path / "logs")
    rows = (columns["t"] + 0.0012 >= 0.1) & (columns["t"] + 0.0012 < 5.0)
    assert len(log) == rows.sum()
    for joint in ARM:
        assert log[f"joint_pos/{joint}"] == pytest.approx(columns[f"q_{joint}"][rows])
        assert log[f"cmd_pos/{joint}"] == pytest.approx(columns[f"q_des_{joint}"][rows])
    assert log.info.extra["gains"] == {"known": False} and log[f"cmd_kp/{ARM[0]}"][0] == 20.0
    assert main(["check", str(tmp_path / "logs"), str(arm.path)]) == 0


def test_sage_runs_that_are_broken_are_refused(arm: Robot, tmp_path: Path) -> None:
    sage = log_format("sage")
    run = write_sage(tmp_path / "a", moved(50.0), ("one", "two"))
    with pytest.raises(
        InputError, match=r"state_motor.csv, positions: found 4 items; expected 2, as in joint_list.txt"
    ):
        sage.read_table(run, sage.Options(), lambda _: True)
    (run / "joint_list.txt").unlink()
    with pytest.raises(InputError, match="no list of joints"):
        sage.read_table(run, sage.Options(), lambda _: True)


def test_a_calibration_turns_shares_into_degrees(tmp_path: Path) -> None:
    """LeRobot's −100…100 of a calibrated range, 0…100 of the gripper's; without one the unit is asked for."""
    from tests.logs.lerobot_arm import CALIBRATION, write_arm, write_dataset

    robot, truth = write_arm(tmp_path), write_dataset(tmp_path / "data")
    with pytest.raises(InputError, match="−100…100 of each joint's range, as this kind of robot records by default"):
        propose_map(tmp_path / "data", robot).answered(tmp_path / "data", robot.path)
    found = propose_map(tmp_path / "data", robot)
    assert not any("positions" in one for one in found.proposal.notes_of(SURE))
    assert found.options["units"] == {"joint_pos/*": "?", "cmd_pos/*": "?"}
    (tmp_path / "calibration.json").write_text(json.dumps(CALIBRATION))
    answered = yaml.safe_load(found.text(robot))["lerobot"]
    answered |= {"calibration": str(tmp_path / "calibration.json")}
    answered["units"] = {"joint_pos/*": "deg", "cmd_pos/*": "deg"}
    layout = log_format("lerobot")
    log = layout.read_all(tmp_path / "data", "data", robot, layout.Options(**answered))[0]
    for joint, values in truth.items():
        assert log[f"joint_pos/{joint}"] == pytest.approx(values, abs=1e-5), joint


def test_a_gyro_in_axes_of_the_world_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "q.xml").write_text(foreign_logs.quadruped_xml())
    robot, rng = Robot.load(tmp_path / "q.xml"), np.random.default_rng(3)
    time, wanted, position, _ = motion(rng, foreign_logs.QUADRUPED_LIMITS, 200.0)
    yaw, pitch = 1.2 * time, 0.6 * np.sin(4 * time)
    half = [np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)]
    quaternion = (half[0] * half[2], -half[1] * half[3], half[0] * half[3], half[1] * half[2])
    of_world = (-np.sin(yaw) * 2.4 * np.cos(4 * time), np.cos(yaw) * 2.4 * np.cos(4 * time), 1.2 + 0 * time)
    columns = {"t": time}
    for i, joint in enumerate(robot.joints):
        columns |= {f"q_{joint}": position[:, i], f"q_des_{joint}": wanted[:, i]}
    columns |= {f"base_quat_{i}": one for i, one in enumerate(quaternion)}
    columns |= {f"base_ang_vel_{i}": one for i, one in enumerate(of_world)}
    found = propose_map(write_table(tmp_path / "a.csv", columns), robot)
    assert "base_angvel_x" not in found.options["columns"]
    assert "base_ang_vel_0 …: left out, it turns in axes of the world" in found.text(robot)


def test_torques_of_another_unit_are_asked_about(arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(
        foreign_logs.arm_xml().replace("<position ", '<motor ctrlrange="-3 3" ').replace(' kp="20"', "")
    )
    columns = {name: values for name, values in moved().items() if not name.startswith("q_des")}
    columns |= {f"tau_cmd_{joint}": 2000 * np.sin(3 * columns["t"] + i) for i, joint in enumerate(ARM)}
    found = propose_map(write_table(tmp_path / "a.csv", columns), Robot.load(tmp_path / "m.xml"))
    assert any("the unit of the torques that were sent" in one for one in found.proposal.notes_of(MISSING))


def test_degrees_are_read_as_such_by_their_size(arm: Robot, tmp_path: Path) -> None:
    columns = {name: values if name == "t" else values / DEGREE for name, values in moved().items()}
    found = propose_map(write_table(tmp_path / "a.csv", columns), arm)
    assert found.options["units"]["joint_pos/*"] == "deg" and found.options["units"]["joint_vel/*"] == "deg/s"
    assert any("−100…100 of each joint's range" in one for one in found.proposal.notes_of(GUESSED))
