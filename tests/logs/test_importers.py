import shutil
from pathlib import Path

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping import published_a1
from leapgap.jumping.published_a1 import PublishedA1
from leapgap.jumping.task import target_of
from leapgap.logs.importers import formats, log_format
from leapgap.logs.importers.csv import Csv
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from tests.conftest import standing


def write_published(folder: Path, robot: Robot, rows: int = 1201) -> None:
    """A jump in the published layout, of a robot held in a crouch with its front feet on a 4 cm block.

    Every value that is placed tells its column: joint i of the file has position 0.0001 i beside the crouch, and a
    velocity of 0.001 i, too small to be another motion than none. All joints swing by 0.06 rad after 0.6 s.
    """
    folder.mkdir(parents=True)
    pos = np.zeros((rows, 46))
    pos[:, 5] = 0.1926
    pos[:, 7] = -0.1095
    pos[:, 37:41] = [0, 0, 0.5, 0]
    pos[:, 41:45] = [10, 20, 30, 40]
    angles = np.zeros(24)
    for at, joint in enumerate(published_a1.JOINT_COLUMNS):
        angles[at] = {"hip": 0.0, "thigh": 1.2566, "calf": -2.3562}[joint.split("_")[1]] + 1e-4 * at
        angles[12 + at] = 1e-3 * at
    swing = 2 * np.pi * np.maximum(0.001 * np.arange(rows) - 0.6, 0.0)[:, None]
    actual = np.tile(angles, (rows, 1))
    actual[:, :12] += 0.03 * (1 - np.cos(swing))
    actual[:, 12:] += 0.03 * 2 * np.pi * np.sin(swing)
    torque = np.tile(np.arange(40.0), (rows, 1))
    desired = np.tile(angles, (rows, 1))
    desired[790, published_a1.JOINT_COLUMNS.index("FR_thigh")] = 0.5552
    forces = np.tile(np.arange(15.0), (rows, 1))
    np.savetxt(folder / "pos.txt", pos)
    np.savetxt(folder / "joint_act.txt", actual)
    np.savetxt(folder / "joint_des.txt", desired)
    np.savetxt(folder / "torque.txt", torque)
    np.savetxt(folder / "data_f.txt", forces)
    np.savetxt(folder / "data_pd.txt", np.tile(np.arange(4.0), (rows, 1)))
    np.savetxt(folder / "data_fmpc_pd.txt", forces + 100, delimiter=",")


@pytest.fixture
def folder(tmp_path: Path, robot: Robot) -> Path:
    write_published(tmp_path / "set" / "7", robot)
    return tmp_path / "set"


def read_one(folder: Path, robot: Robot) -> Log:
    ((name, path),) = PublishedA1().find(folder).items()
    return PublishedA1().read(path, name, robot, PublishedA1.Options())


def test_every_published_column_lands_in_its_place(folder: Path, robot: Robot) -> None:
    jump = read_one(folder, robot)
    assert jump.name == "jump_07"
    assert jump.joints == robot.joints
    # Files go joint by joint through the legs FR FL RR RL: the calf of RL is the last column.
    assert jump["joint_vel/RL_calf"][0] == 0.011
    assert jump["joint_vel/FL_hip"][0] == 0.001
    assert jump["joint_vel/FR_thigh"][0] == 0.004
    assert jump["cmd_tau/RR_thigh"][0] == 26
    assert [jump[f"contact/{leg}"][0] for leg in published_a1.LEGS] == [0, 0, 1, 0]
    assert jump["foot_force/FL"][0] == 20
    assert jump["base_angvel_y"][0] == 5
    assert jump.pair_force("mpc_force")[0].tolist() == [11, 12, 13, 14]
    assert jump.pair_force("train_force")[0].tolist() == [111, 112, 113, 114]
    assert jump.pair_force("pd_force")[0].tolist() == [0, 1, 2, 3]
    assert jump.pitch[0] == pytest.approx(-0.1095)
    assert "base_angvel_x" not in jump  # not logged, hence not there


def test_gains_of_the_landing_sequence_stand_in_its_rows(folder: Path, robot: Robot) -> None:
    jump = read_one(folder, robot)
    assert jump.rows_before_gain_change == 1100
    assert (jump["cmd_kp/FR_calf"][1099], jump["cmd_kp/FR_calf"][1100]) == (300, 80)
    assert (jump["cmd_kd/FL_hip"][1099], jump["cmd_kd/FL_hip"][1100]) == (3, 1)
    assert set(jump["cmd_kp/RR_calf"]) == {300}


def test_target_and_block_are_inferred(folder: Path, robot: Robot) -> None:
    jump = read_one(folder, robot)
    assert target_of(jump).x_m == 0.6
    (box,) = jump.info.terrain
    assert box.estimated
    assert box.top_m == pytest.approx(0.04, abs=0.001)
    assert box.x_m > 0.1


def test_a_block_under_the_rear_feet_is_inferred_too(folder: Path, robot: Robot) -> None:
    state = np.loadtxt(folder / "7" / "pos.txt")
    state[:, 7] *= -1  # nose down
    np.savetxt(folder / "7" / "pos.txt", state)
    (box,) = read_one(folder, robot).info.terrain
    assert box.top_m == pytest.approx(0.04, abs=0.001)
    assert box.x_m < -0.1


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda f: (f / "torque.txt").unlink(), r"torque\.txt: found no such file"),
        (lambda f: truncate(f / "pos.txt"), r"pos\.txt: found no whole table"),
        (lambda f: np.savetxt(f / "data_pd.txt", np.zeros((1000, 4))), "found 1000 rows; expected 1201"),
        (lambda f: np.savetxt(f / "joint_act.txt", np.zeros((1201, 20))), "20 columns; expected 24 columns"),
        (lambda f: np.savetxt(f / "pos.txt", np.full((1201, 46), np.nan)), "no number, first in row 0, column 0"),
    ],
)
def test_a_damaged_jump_is_named(folder: Path, robot: Robot, harm, message: str) -> None:
    harm(folder / "7")
    with pytest.raises(InputError, match=message):
        read_one(folder, robot)


def truncate(path: Path) -> None:
    text = path.read_text()
    path.write_text(text[: len(text) // 2 + 7])


def test_two_folders_of_one_name_are_refused(folder: Path) -> None:
    shutil.copytree(folder / "7", folder / "again" / "7")
    with pytest.raises(InputError, match="two folders named 7"):
        PublishedA1().find(folder)


def test_real_encoders_agree_with_the_logged_feet(raw: Path, robot: Robot, real_jumps: list[Log]) -> None:
    """Units, signs and joint order at once: forward kinematics against the source's own foot positions."""
    folders = PublishedA1().find(raw)
    assert len(real_jumps) == len(folders) >= 16
    for jump in real_jumps:
        logged = np.loadtxt(folders[jump.name] / "data_f.txt")[:, 7:11]
        base = jump.stack(BASE_POSITION)
        feet = feet_in_world(robot, base, jump.stack(BASE_QUATERNION), jump.per_joint("joint_pos")) - base[:, None]
        right = np.concatenate([feet[:, robot.feet.index(leg)][:, [0, 2]] for leg in ("FR", "RR")], axis=1)
        assert np.abs(right - logged).max() < 0.003, jump.name


def test_real_feet_stand_on_the_floor_and_joints_follow_commands(robot: Robot, real_jumps: list[Log]) -> None:
    for jump in real_jumps:
        base, turn = jump.stack(BASE_POSITION)[:1], jump.stack(BASE_QUATERNION)[:1]
        soles = feet_in_world(robot, base, turn, jump.per_joint("joint_pos")[:1])[0, :, 2] - robot.foot_radius
        assert np.abs(soles[2:]).max() < 0.003
        assert np.abs(jump.per_joint("joint_pos") - jump.per_joint("cmd_pos"))[:200].max() < 0.15


def csv_of(jump: Log, path: Path, renamed: dict[str, str], left_out: tuple[str, ...] = ()) -> None:
    names = [name for name in jump.columns if not name.startswith(left_out)] if left_out else list(jump.columns)
    table = np.stack([jump[name] for name in names], axis=1)
    header = ",".join(renamed.get(name, name) for name in names)
    np.savetxt(path, table, delimiter=",", header=header, comments="")


def test_csv_with_a_column_map(robot: Robot, tmp_path: Path) -> None:
    jump = standing(robot, 60)
    renamed = {f"joint_pos/{joint}": f"q_{joint}" for joint in robot.joints} | {"time": "stamp"}
    csv_of(jump, tmp_path / "one.csv", renamed, left_out=("cmd_kp", "cmd_kd"))
    options = Csv.Options(
        columns={"joint_pos/*": "q_*", "time": "stamp"},
        factors={"joint_pos/*": 2.0},
        constants={"cmd_kp/*": 300.0, "cmd_kd/*": 3.0},
    )
    back = Csv().read(tmp_path / "one.csv", "one", robot, options)
    assert back.joints == robot.joints
    assert back["joint_pos/FR_calf"] == pytest.approx(2 * jump["joint_pos/FR_calf"])
    assert set(back["cmd_kp/RL_hip"]) == {300.0}
    assert back.info.sample_period_s == pytest.approx(0.001)


def test_csv_names_the_missing_column_and_the_empty_cell(robot: Robot, tmp_path: Path) -> None:
    jump = standing(robot, 10)
    csv_of(jump, tmp_path / "one.csv", {})
    with pytest.raises(InputError, match="found no column q_FR_hip"):
        Csv().read(tmp_path / "one.csv", "one", robot, Csv.Options(columns={"joint_pos/*": "q_*"}))
    lines = (tmp_path / "one.csv").read_text().splitlines()
    lines[4] = ",".join(["0.003", "", *lines[4].split(",")[2:]])
    (tmp_path / "one.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match="base_pos_x: found 1 values that are no number, first in row 3"):
        Csv().read(tmp_path / "one.csv", "one", robot, Csv.Options())


def test_unknown_format_lists_the_known(robot: Robot) -> None:
    known = ("csv", "hdf5", "json", "lerobot", "mat", "npz", "parquet", "pt", "published", "ros", "sage")
    assert tuple(formats()) == known
    with pytest.raises(InputError, match=f"found bags; expected one of {', '.join(known)}"):
        log_format("bags")


def test_a_format_of_another_package_is_found_under_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """What ``importlib.metadata`` reports of an installed package is all that is needed."""

    class Bags(Csv):
        name = "bags"

    class Point:
        value = "bags:Bags"

        def load(self) -> type:
            return Bags

    monkeypatch.setattr("leapgap.registry.entry_points", lambda group: [Point()] if "log_formats" in group else [])
    formats.cache_clear()
    try:
        assert isinstance(log_format("bags"), Bags)
    finally:
        formats.cache_clear()
