"""The committed maps of public data (conf/import_logs): against files of that layout, and against the data."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra import compose, initialize_config_dir

from leapgap.cli import import_options, main
from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log, read_logs
from leapgap.robot.model import Robot
from leapgap.settings import from_mapping, from_yaml
from stages.common import CONF, read_config
from stages.import_logs import import_logs
from tests.logs.test_tables import write_table

SOURCES = sorted(path for path in (CONF / "import_logs").glob("*.yaml") if path.stem != "default")
GO2 = tuple(f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf"))
JOINTS = {"acrobot": ("Joint1", "Joint2"), "go2": GO2, "ricmonk": ("virtul_joint_hook_1", "Joint1", "Joint3")}


def model(folder: Path, source: str) -> Path:
    """A model with the joints of the robot that a source is of, for their names alone."""
    joints = JOINTS[source.partition("_")[0]]
    bodies = "".join(f'<body><joint name="{one}"/><geom size="0.1"/>' for one in joints) + "</body>" * len(joints)
    motors = "".join(f'<general joint="{one}" gainprm="1" biastype="affine"/>' for one in joints)
    path = folder / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>")
    return path


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_stage_and_command_read_the_same_options(path: Path) -> None:
    with initialize_config_dir(version_base="1.3", config_dir=str(CONF)):
        section = compose("config", [f"import_logs={path.stem}"]).import_logs
    name, values = import_options(path, None)
    kind = log_format(name).Options
    assert section.format == name
    assert read_config(kind, section[name], "import_logs") == from_mapping(kind, values, str(path))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_each_source_says_where_it_is_from_and_the_command_that_imports_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert f"--options conf/import_logs/{path.name} --out logs" in text
    assert set(from_yaml(text)) == {"source", "format", "out", from_yaml(text)["format"]}


def acrobot_columns() -> dict[str, np.ndarray]:
    """Columns of the acrobot's files; every column has a value of its own."""
    names = ("pos_meas", "vel_meas", "pos_filt", "vel_filt", "tau_con", "tau_fric", "tau_meas", "tau_pert")
    columns = {"time": np.cumsum(np.tile([0.002, 0.0019, 0.0025, 0.0021], 25))}
    for i, name in enumerate(names):
        columns |= {f"{name}{joint}": np.full(100, 10.0 * i + joint) for joint in (1, 2)}
    return columns


@pytest.mark.parametrize(
    ("source", "commanded"), [("acrobot", 42), ("acrobot_uncompensated", 42 - 52), ("acrobot_pushed", 42 + 72)]
)
def test_acrobot(tmp_path: Path, source: str, commanded: float) -> None:
    """By the stage, as a user calls it with ``import_logs=<source>``."""
    (tmp_path / "raw").mkdir()
    write_table(tmp_path / "raw" / "one.csv", acrobot_columns())
    overrides = [
        f"import_logs={source}",
        f"import_logs.source={tmp_path / 'raw'}",
        f"import_logs.out={tmp_path / 'out'}",
        f"robot.model={model(tmp_path, source)}",
    ]
    with initialize_config_dir(version_base="1.3", config_dir=str(CONF)):
        import_logs(compose("config", overrides))
    (log,) = read_logs(tmp_path / "out")
    assert log["joint_pos/Joint2"][0] == 2
    assert log["joint_vel/Joint1"][0] == 11
    assert log["cmd_tau/Joint2"][0] == commanded
    assert log["tau/Joint1"][0] == 61
    assert log["cmd_kp/Joint1"][0] == 0
    assert np.ptp(np.diff(log.time)) == pytest.approx(6e-4)


def imported(source: str, files: Path, folder: Path) -> dict[str, Log]:
    """The logs that the documented command makes of a folder, by name."""
    options = ("--options", CONF / "import_logs" / f"{source}.yaml", "--out", folder / "out")
    assert main([str(one) for one in ("import", files, model(folder, source), *options)]) == 0
    return {log.name: log for log in read_logs(folder / "out")}


def test_ricmonk(tmp_path: Path) -> None:
    names = ("meas_time", "state_machine_flag", *(f"arm1_meas_Ang_{x}" for x in ("pos", "vel")))
    names += tuple(f"{joint}_{x}" for joint in ("tail", "phi") for x in ("meas_Ang_pos", "meas_Ang_vel"))
    names += tuple(f"{joint}_{x}_tau" for joint in ("tail", "phi") for x in ("meas", "clipped", "cmd"))
    columns: dict[str, np.ndarray] = {name: np.full(60, float(i)) for i, name in enumerate(names)}
    columns["meas_time"] = 2 + 0.006 * np.arange(60)
    columns["state_machine_flag"] = np.repeat([1.0, 0.0, 1.0], 20)
    columns["raw_imu_pos"] = np.where(
        columns["state_machine_flag"] > 0, 1.0, np.nan
    )  # as theirs, empty while it grasps
    (tmp_path / "raw").mkdir()
    write_table(tmp_path / "raw" / "one.csv", columns)
    logs = imported("ricmonk", tmp_path / "raw", tmp_path)
    assert {name: len(log) for name, log in logs.items()} == {"one_1": 20, "one_2": 20}
    log = logs["one_2"]
    assert log.time[0] == 0
    assert log["joint_pos/Joint3"][0] == names.index("phi_meas_Ang_pos")
    assert log["cmd_tau/Joint1"][0] == names.index("tail_clipped_tau")
    assert log["cmd_tau/virtul_joint_hook_1"][0] == 0


def test_go2_in_air(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    (tmp_path / "raw").mkdir()
    measured = torch.arange(12).float() + torch.zeros(200, 1)
    saved = {"time": 0.005 * torch.arange(200), "dof_pos": measured, "des_dof_pos": 100 + measured}
    torch.save(saved, tmp_path / "raw" / "traj_0.pt")
    (log,) = imported("go2_in_air", tmp_path / "raw", tmp_path).values()
    assert [log[f"joint_pos/{joint}"][0] for joint in GO2] == list(range(12))
    assert log["cmd_pos/RR_calf_joint"][7] == 111
    assert (log["cmd_kp/FL_hip_joint"][0], log["cmd_kd/FL_hip_joint"][0]) == (20, 1.5)
    assert "joint_vel/FL_hip_joint" not in log
    torch.save({**saved, "time": 0.006 * torch.arange(200)}, tmp_path / "raw" / "traj_0.pt")
    robot, layout = Robot.load(tmp_path / "robot.xml"), log_format("pt")
    options: Any = from_mapping(layout.Options, import_options(CONF / "import_logs/go2_in_air.yaml", None)[1], "")
    with pytest.raises(InputError, match=r"found steps of 0\.006 s on average; expected the stated period of 0\.005 s"):
        layout.read(tmp_path / "raw" / "traj_0.pt", "traj_0", robot, options)


@pytest.fixture(scope="session")
def robots() -> Path:
    """Folder of the public data of real robots, as the maps name them; tests that need it are skipped without it."""
    folder = Path(os.environ.get("LEAPGAP_ROBOTS", "data/raw"))
    if not (folder / "acrobot").is_dir():
        pytest.skip("no data of real robots: set LEAPGAP_ROBOTS or fill data/raw")
    return folder


def test_real_acrobot_has_uneven_steps_and_velocities_of_its_positions(robots: Path, tmp_path: Path) -> None:
    logs = imported("acrobot", robots / "acrobot" / "sent", tmp_path)
    assert len(logs) == 4
    for log in logs.values():
        steps = np.diff(log.time)
        assert np.median(steps) == pytest.approx(0.002, abs=2e-4)
        assert log.info.sample_period_s == pytest.approx(steps.mean(), abs=1e-9)
        assert steps.max() > 1.5 * np.median(steps)
        turned = (log["joint_vel/Joint2"][1:] * steps).sum()
        assert turned == pytest.approx(np.ptp(log["joint_pos/Joint2"][[0, -1]]), abs=0.3)


def test_real_go2_is_one_log_at_200_hz_within_the_limits_of_its_joints(robots: Path, tmp_path: Path) -> None:
    (log,) = imported("go2_in_air", robots / "go2_in_air", tmp_path).values()
    assert len(log) == 4698
    assert log.info.sample_period_s == pytest.approx(0.005, rel=1e-3)
    assert -2.73 < log["joint_pos/FL_calf_joint"].min() < log["joint_pos/FL_calf_joint"].max() < -0.83
    assert np.abs(log["joint_pos/RR_hip_joint"] - log["cmd_pos/RR_hip_joint"]).max() < 0.3


def test_real_ricmonk_gives_a_log_a_swing(robots: Path, tmp_path: Path) -> None:
    logs = imported("ricmonk", robots / "ricmonk", tmp_path)
    assert len(logs) == 12
    assert all(2 < log.time[-1] < 4 and np.diff(log.time).max() < 0.05 for log in logs.values())
