"""Joints that are not logged and that the model ties to others: fingers of grippers. Motions are MuJoCo's own."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from leapgap.errors import InputError
from leapgap.logs.importers.csv import Csv, CsvOptions
from leapgap.logs.map_proposal.report import propose_map
from leapgap.robot.model import Robot
from leapgap.robot.stated_joints import servo_gains, ties
from tests.logs.test_tables import write_table

GRIPPER = """<mujoco model="gripper"><compiler angle="radian"/>
<option timestep="0.0005" integrator="implicitfast"/><worldbody>
<body><joint name="wrist" axis="0 0 1" range="-2 2"/><geom size="0.05" mass="1"/>
  <body pos="0.1 0.02 0"><joint name="left" type="slide" axis="0 1 0" range="0 0.05" ref="0.01"/>
    <geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body>
  <body pos="0.1 -0.02 0"><joint name="right" type="slide" axis="0 -1 0" range="0 0.05"/>
    <geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body>
</body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef="0.002 0.5 0 0 0" solref="0.002 1"/></equality>
<actuator><position joint="wrist" kp="80" kv="4"/><position joint="left" kp="600" kv="20"/></actuator></mujoco>"""


@pytest.fixture
def gripper(tmp_path: Path) -> Robot:
    (tmp_path / "gripper.xml").write_text(GRIPPER)
    return Robot.load(tmp_path / "gripper.xml")


def motion(rows: int = 1200) -> dict[str, np.ndarray]:
    """Angles and set points of a wrist and a gripper, every 2 ms, by the servos of the file."""
    model = mujoco.MjModel.from_xml_string(GRIPPER)
    data, found = mujoco.MjData(model), []
    for row in range(rows):
        time = 0.002 * row
        data.ctrl[:] = 0.7 * np.sin(5 * time), 0.02 + 0.01 * np.cos(4 * time)
        found.append([time, *data.qpos, *data.qvel, *data.ctrl])
        mujoco.mj_step(model, data, 4)
    names = ["t", *(f"q_{j}" for j in ("wrist", "left", "right")), *(f"dq_{j}" for j in ("wrist", "left", "right"))]
    return dict(zip([*names, "goal_wrist", "goal_left"], np.array(found).T, strict=True))


def test_a_tied_joint_is_where_mujoco_has_it(gripper: Robot) -> None:
    by_joint = dict(ties(gripper.model))
    truth = {name: values[200:] for name, values in motion().items()}  # the constraint is met after some steps
    for joint in ("left", "right"):
        tie = by_joint[joint]
        assert tie.position(truth[f"q_{tie.of}"]) == pytest.approx(truth[f"q_{joint}"], abs=3e-4)
        velocity = truth[f"dq_{joint}"]
        assert tie.velocity(truth[f"dq_{tie.of}"]) == pytest.approx(velocity, abs=0.1 * np.ptp(velocity))  # it is soft


def test_a_finger_that_is_not_in_the_file_follows_the_other(gripper: Robot, tmp_path: Path) -> None:
    truth = motion()
    columns = {name: values for name, values in truth.items() if not name.endswith("right")}
    path = write_table(tmp_path / "a.csv", columns)
    text = propose_map(path, gripper).text(gripper)
    assert "right is not in the file: it follows left, to which the model ties it" in text
    assert "those of the servos in the model file" in text
    proposed = yaml.safe_load(text)["csv"]
    assert proposed["gains"] == "unknown"
    log = Csv().read(path, "a", gripper, CsvOptions(**proposed))
    assert log["joint_pos/right"][200:] == pytest.approx(truth["q_right"][200:], abs=3e-4)
    assert log["joint_vel/right"][200:] == pytest.approx(truth["dq_right"][200:], abs=3e-3)
    assert log.info.extra["follows"] == {"right": "left"}
    assert log.info.extra["gains"] == {"known": False}
    assert [log[f"cmd_kp/{joint}"][0] for joint in ("wrist", "left")] == [80.0, 600.0]
    assert [log[f"cmd_kd/{joint}"][0] for joint in ("wrist", "left")] == [4.0, 20.0]
    assert "cmd_pos/left" in log and not any(name.startswith("cmd_") for name in log.columns if "right" in name)


@pytest.mark.parametrize("theirs", [("W", "G"), ("1", "2")])
def test_columns_as_many_as_motors_are_those_of_the_motors(
    gripper: Robot, tmp_path: Path, theirs: tuple[str, str]
) -> None:
    truth, degrees = motion(), 180 / np.pi
    columns = {"t": truth["t"]}
    for key, joint in zip(theirs, ("wrist", "left"), strict=True):
        of_key = {f"{key}_pos": f"q_{joint}", f"{key}_spd_dps": f"dq_{joint}", f"{key}_target": f"goal_{joint}"}
        unit = degrees if joint == "wrist" else 1.0  # a finger slides, in m
        columns |= {name: unit * truth[source] for name, source in of_key.items()}
    text = propose_map(write_table(tmp_path / "a.csv", columns), gripper).text(gripper)
    proposed = yaml.safe_load(text)["csv"]
    assert proposed["joint_names"] == dict(zip(theirs, ("wrist", "left"), strict=True))
    assert f"makers may have another: {theirs[0]} = wrist, {theirs[1]} = left\n" in text
    log = Csv().read(tmp_path / "a.csv", "a", gripper, CsvOptions(**proposed))
    assert log["joint_pos/wrist"] == pytest.approx(truth["q_wrist"])
    assert log.info.extra["follows"] == {"right": "left"}


def test_units_of_all_joints_leave_out_the_one_that_follows(gripper: Robot, tmp_path: Path) -> None:
    columns = {name: values for name, values in motion().items() if name in ("t", "q_wrist", "q_left")}
    columns["q_left"] = 1000 * columns["q_left"]
    path = write_table(tmp_path / "a.csv", columns)
    none = {f"{name}/*": 0.0 for name in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
    positions = {"time": "t", "joint_pos/*": "q_*"}
    options = CsvOptions(columns=positions, constants=none, factors={"joint_pos/*": [1.0, 0.001, 1.0]})
    log = Csv().read(path, "a", gripper, options)
    assert log["joint_pos/right"] == pytest.approx(0.002 + 0.5 * (log["joint_pos/left"] - 0.01))
    shorter = CsvOptions(columns=positions, constants=none, factors={"joint_pos/*": [1.0, 0.001]})
    again = Csv().read(path, "a", gripper, shorter)
    assert np.array_equal(again["joint_pos/left"], log["joint_pos/left"])
    wrong = CsvOptions(columns=positions, constants={**none, "cmd_kp/*": [1.0]})
    with pytest.raises(InputError, match=r"a list of 1; expected one number, or with \* a list of 2, for wrist, left"):
        Csv().read(path, "a", gripper, wrong)


def test_a_finger_that_is_named_and_lacking_is_refused(gripper: Robot, tmp_path: Path) -> None:
    columns = {name: values for name, values in motion().items() if name in ("t", "q_wrist", "q_left")}
    path = write_table(tmp_path / "a.csv", columns)
    named = {"time": "t", "joint_pos/*": "q_*", "joint_pos/right": "q_right"}
    with pytest.raises(InputError, match="no column q_right"):
        Csv().read(path, "a", gripper, CsvOptions(columns=named))


def test_a_finger_with_a_motor_or_a_curved_tie_follows_nothing(tmp_path: Path) -> None:
    for number, (old, new) in enumerate(
        [
            ('kv="20"/>', 'kv="20"/><position joint="right" kp="600"/>'),
            ("0.002 0.5 0 0 0", "0.002 0.5 3 0 0"),
            ('<joint joint1="right"', '<joint active="false" joint1="right"'),
        ]
    ):
        path = tmp_path / f"{number}.xml"
        path.write_text(GRIPPER.replace(old, new))
        columns = {name: values for name, values in motion().items() if name in ("t", "q_wrist", "q_left")}
        table = write_table(tmp_path / "a.csv", columns)
        with pytest.raises(InputError, match="no column q_right"):
            Csv().read(table, "a", Robot.load(path), CsvOptions(columns={"time": "t", "joint_pos/*": "q_*"}))


def test_gains_are_those_of_servos_and_of_nothing_else(gripper: Robot, tmp_path: Path) -> None:
    assert servo_gains(gripper) == {"wrist": (80.0, 4.0), "left": (600.0, 20.0)}
    other = '<motor joint="wrist"/>', '<position joint="wrist" kp="80" gear="2"/>', '<velocity joint="wrist" kv="2"/>'
    for number, motor in enumerate(other):
        path = tmp_path / f"{number}.xml"
        path.write_text(GRIPPER.replace('<position joint="wrist" kp="80" kv="4"/>', motor))
        assert servo_gains(Robot.load(path)) is None
