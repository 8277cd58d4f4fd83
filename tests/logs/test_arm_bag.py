"""A bag of an industrial arm as its ROS 2 driver and a position controller write it: imported and checked as it is."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from leapgap.cli import main
from leapgap.logs.log import read_logs

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
KP, KD = 2000.0, 400.0
PERIOD_S, ROWS, EPOCH = 0.008, 800, 1_700_000_000_000_000_000


def model_xml() -> str:
    """Six joints of ±2π, position servos as Menagerie's UR5e has them, gravity compensated by heavy gearing."""
    links = "".join(
        f'<body pos="0 0 0.2"><joint name="{joint}_joint" axis="{axis}" range="-6.2831 6.2831" armature="0.1"/>'
        '<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.15" mass="1" contype="0" conaffinity="0"/>'
        for joint, axis in zip(JOINTS, AXES, strict=True)
    )
    servos = "".join(
        f'<general joint="{joint}_joint" gainprm="{KP}" biastype="affine" biasprm="0 -{KP} -{KD}"/>' for joint in JOINTS
    )
    head = '<mujoco model="arm6"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>'
    return f"{head}<worldbody>{links}{'</body>' * 6}</worldbody><actuator>{servos}</actuator></mujoco>"


def swing() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Set points, positions and velocities, (rows, 6), by plain MuJoCo."""
    model = mujoco.MjModel.from_xml_string(model_xml())
    data, time = mujoco.MjData(model), PERIOD_S * np.arange(ROWS)
    rate, phase = np.linspace(0.2, 0.7, 6), np.linspace(0, 4, 6)
    wanted = 0.6 * np.sin(2 * np.pi * rate * time[:, None] + phase) - 0.6 * np.sin(phase)
    position, velocity = np.empty((ROWS, 6)), np.empty((ROWS, 6))
    for row in range(ROWS):
        data.ctrl[:] = wanted[row]
        position[row], velocity[row] = data.qpos, data.qvel
        mujoco.mj_step(model, data, 4)
    return wanted, position, velocity


def write_bag(
    path: Path, wanted: np.ndarray, position: np.ndarray, velocity: np.ndarray, order_sent: tuple[int, ...]
) -> None:
    """States with the joints by the alphabet, commands in an order of the controller, a description sent once."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds = types.types
    state, header, stamp, text, numbers, layout = (
        kinds[name]
        for name in (
            *("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"),
            *("std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray", "std_msgs/msg/MultiArrayLayout"),
        )
    )
    order = sorted(range(6), key=lambda i: JOINTS[i])
    names = [f"{JOINTS[i]}_joint" for i in order]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def topic(name: str, kind: str) -> object:
            return writer.add_connection(name, kind, typestore=types)

        def send(connection: object, kind: str, message: object, at: int) -> None:
            writer.write(connection, EPOCH + at, types.serialize_cdr(message, kind))  # type: ignore[arg-type]

        speed = topic("/speed_scaling", "std_msgs/msg/Float64")
        states = topic("/joint_states", "sensor_msgs/msg/JointState")
        commands = topic("/forward_position_controller/commands", "std_msgs/msg/Float64MultiArray")
        send(speed, "std_msgs/msg/Float64", text(100.0), 0)
        for row in range(ROWS):
            at = round(1e9 * PERIOD_S * row) + 1_000_000_000
            values = (position[row, order], velocity[row, order], np.zeros(6))
            message = state(header(stamp(1_700_000_001, at % 1_000_000_000), "base"), names, *values)
            send(states, "sensor_msgs/msg/JointState", message, at)
            sent = numbers(layout([], 0), wanted[row, list(order_sent)])
            send(commands, "std_msgs/msg/Float64MultiArray", sent, at - 400_000)


@pytest.mark.parametrize("order_sent", [(0, 1, 2, 3, 4, 5), (2, 1, 0, 3, 4, 5)])
def test_a_bag_of_an_arm_is_imported_and_checked_in_two_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], order_sent: tuple[int, ...]
) -> None:
    wanted, position, velocity = swing()
    (tmp_path / "arm.xml").write_text(model_xml())
    write_bag(tmp_path / "bag", wanted, position, velocity, order_sent)
    model = str(tmp_path / "arm.xml")
    assert main(["import", str(tmp_path / "bag"), model, "--out", str(tmp_path / "logs")]) == 0
    assert "gains of the joint PD unknown" in capsys.readouterr().out
    (log,) = read_logs(tmp_path / "logs")
    for i, joint in enumerate(JOINTS):
        assert log[f"joint_pos/{joint}_joint"] == pytest.approx(position[:, i], abs=1e-9)
        assert log[f"joint_vel/{joint}_joint"] == pytest.approx(velocity[:, i], abs=1e-9)
        assert log[f"cmd_pos/{joint}_joint"] == pytest.approx(wanted[:, i], abs=1e-9)
        assert (log[f"cmd_kp/{joint}_joint"][0], log[f"cmd_kd/{joint}_joint"][0]) == (KP, KD)
    assert main(["check", str(tmp_path / "logs"), model]) == 0
    assert "FAILED" not in capsys.readouterr().out
