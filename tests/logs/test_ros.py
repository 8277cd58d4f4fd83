"""ROS recordings that the writers of rosbags made: topics of different rates, messages of any type."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.importers.ros import leaves
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.logs.test_tables import NO_COMMANDS

EPOCH = 1_700_000_000_000_000_000
DEFINITIONS = {
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau_est\n",
    "unitree_go/msg/MotorCmd": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n",
    "unitree_go/msg/LowState": "unitree_go/MotorState[3] motor_state\nint16[4] foot_force\nuint32 tick\n",
    "unitree_go/msg/LowCmd": "unitree_go/MotorCmd[3] motor_cmd\n",
}
NAMED = "string name\nfloat64[3] place\n"
STATE_S, COMMAND_S, IMU_S = 0.002, 0.02, 0.005


def store(base: Stores) -> Any:
    found = get_typestore(base)
    for name, text in DEFINITIONS.items():
        found.register(get_types_from_msg(text, name))
    return found


def messages(types: Any) -> list[tuple[str, str, int, Any]]:
    """Topic, type, time in ns and message of an arm that turns steadily; set points change at a tenth of the rate."""
    kinds = types.types
    state, motor = kinds["unitree_go/msg/LowState"], kinds["unitree_go/msg/MotorState"]
    command, single = kinds["unitree_go/msg/LowCmd"], kinds["unitree_go/msg/MotorCmd"]
    vector = kinds["geometry_msgs/msg/Vector3"]
    force = np.zeros(4, dtype=np.int16)
    made: list[tuple[str, str, int, Any]] = []
    for row in range(500):
        t = row * STATE_S
        motors = [motor(1, np.float32(t), np.float32(1), 0.0), motor(1, np.float32(-2 * t), np.float32(-2), 0.5)]
        body = state([*motors, motor(0, 9, 9, 9)], force, row)
        made.append(("/lowstate", "unitree_go/msg/LowState", round(t * 1e9), body))
    for row in range(50):
        t = row * COMMAND_S + 0.0101
        arms = [
            single(1, np.float32(row), 0, 0, 40, 1),
            single(1, np.float32(-row), 0, 0.25, 30, 1),
            single(0, 0, 0, 0, 0, 0),
        ]
        made.append(("/lowcmd", "unitree_go/msg/LowCmd", round(t * 1e9), command(arms)))
    for row in range(200):
        t = row * IMU_S
        made.append(("/acc", "geometry_msgs/msg/Vector3", round(t * 1e9), vector(3 * t, 0.0, 9.81)))
    return sorted(made, key=lambda one: one[2])


def write_ros2(path: Path, plugin: StoragePlugin) -> Path:
    types = store(Stores.ROS2_HUMBLE)
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, at, message in messages(types):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], EPOCH + at, types.serialize_cdr(message, kind))
    return path


def write_mcap(path: Path) -> Path:
    return write_ros2(path, StoragePlugin.MCAP)


def write_sqlite(path: Path) -> Path:
    return write_ros2(path, StoragePlugin.SQLITE3)


def write_ros1(path: Path) -> Path:
    types = store(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, at, message in messages(types):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], EPOCH + at, types.serialize_ros1(message, kind))
    return path


COLUMNS = {
    "joint_pos/*": "/lowstate/motor_state[*].q",
    "joint_vel/*": "/lowstate/motor_state[*].dq",
    "cmd_pos/*": "/lowcmd/motor_cmd[*].q",
    "cmd_tau/*": "/lowcmd/motor_cmd[*].tau",
    "cmd_kp/*": "/lowcmd/motor_cmd[*].kp",
    "imu_acc_x": "/acc/x",
}
CONSTANTS = {"cmd_vel/*": 0.0, "cmd_kd/*": 1.0}


def read(path: Path, arm: Robot, **options: Any) -> Log:
    layout = log_format("ros")
    ((name, found),) = layout.find(path).items()
    chosen = {"columns": COLUMNS, "constants": CONSTANTS, "joint_order": ["elbow", "shoulder"], **options}
    return layout.read(found, name, arm, layout.Options(**chosen))


@pytest.mark.parametrize("write", [write_mcap, write_sqlite, write_ros1])
def test_topics_of_three_rates_become_one_log(arm: Robot, tmp_path: Path, write: Callable[[Path], Path]) -> None:
    """Rows are those of the state topic, from the first command on; set points stay until the next one."""
    path = write(tmp_path / ("walk.bag" if write is write_ros1 else "walk"))
    for source in (path, tmp_path) if write is not write_ros1 else (path,):
        assert log_format("ros").find(source) == {"walk": path}
    log = read(path, arm)
    assert log.info.sample_period_s == pytest.approx(STATE_S)
    since = 0.012 + log.time  # the first state after the first command, at 10.1 ms
    assert len(log) == round((0.995 - 0.012) / STATE_S)  # until the last IMU message
    assert log["joint_pos/elbow"] == pytest.approx(since, abs=1e-6)
    assert log["joint_pos/shoulder"] == pytest.approx(-2 * since, abs=1e-6)
    assert log["imu_acc_x"] == pytest.approx(3 * since, abs=1e-6)  # between messages, on a straight line
    held = np.floor((since - 0.0101) / COMMAND_S + 1e-9)
    assert log["cmd_pos/elbow"].tolist() == held.tolist()
    assert log["cmd_tau/shoulder"][0] == 0.25
    assert log["cmd_kp/shoulder"][0] == 30


def test_another_clock_and_a_file_inside_the_folder(arm: Robot, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "walk")
    log = read(next(path.glob("*.mcap")), arm, clock="/acc")
    assert log.info.sample_period_s == pytest.approx(IMU_S)
    with pytest.raises(InputError, match="found no mapped field of /odom; expected one of "):
        read(path, arm, clock="/odom")


def test_what_is_not_there_is_named(arm: Robot, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "walk")
    with pytest.raises(
        InputError,
        match=r"found no column /lowstate/motor_state\[1\].position; expected the column that is to be joint_",
    ):
        read(path, arm, columns={**COLUMNS, "joint_pos/*": "/lowstate/motor_state[*].position"})
    with pytest.raises(InputError, match="found no field that is mapped; expected messages with these fields"):
        read(path, arm, columns={"joint_pos/*": "/joint_states/position[*]"})
    with pytest.raises(InputError, match=r"/\w+: found messages without a header"):
        read(path, arm, stamps="stamped")


def write_joint_states(path: Path) -> Path:
    """Stamped states whose joints change their order on the way, received 30 ms late and more."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds = types.types
    state, header, time = (
        kinds[name] for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=types)
        for row in range(100):
            at = 10_000_000 * row
            names, values = ["shoulder", "elbow"], [0.01 * row, -0.02 * row]
            if row >= 50:
                names, values = names[::-1], values[::-1]
            nothing = np.array([], dtype=np.float64)
            message = state(header(time(1_700_000_000, at), ""), names, np.array(values), nothing, nothing)
            raw = types.serialize_cdr(message, "sensor_msgs/msg/JointState")
            writer.write(connection, EPOCH + at + 30_000_000 + 1_000_000 * (row % 3), raw)
    return path


def test_joints_are_found_by_the_names_in_each_message_and_times_in_its_header(arm: Robot, tmp_path: Path) -> None:
    options = {"columns": {"joint_pos/*": "/joint_states/position[*]"}, "constants": NO_COMMANDS, "joint_order": []}
    path = write_joint_states(tmp_path / "states")
    log = read(path, arm, **options, stamps="stamped")
    assert log.time == pytest.approx(0.01 * np.arange(100), abs=1e-9)
    assert log["joint_pos/shoulder"] == pytest.approx(0.01 * np.arange(100))
    assert log["joint_pos/elbow"] == pytest.approx(-0.02 * np.arange(100))
    received = read(path, arm, **options)
    assert received.time[1] == pytest.approx(0.011, abs=1e-9)


def test_without_the_package_the_extra_is_named(arm: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    path = write_mcap(tmp_path / "walk")
    with pytest.raises(InputError, match=r"expected what the extra 'ros' installs; pip install 'leapgap\[ros\]'"):
        read(path, arm)


def test_one_text_in_a_message_is_no_list_of_joints() -> None:
    """Only a list of names addresses the values beside it."""
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(NAMED, "parts/msg/Leg"))
    leg = types.types["parts/msg/Leg"]("leg", np.arange(3.0))
    assert [name for name, _ in leaves(leg, "/leg")] == [f"/leg/place[{i}]" for i in range(3)]
