"""A LeRobot dataset of an arm whose positions are shares of each joint's calibrated range, by LeRobot's own formula."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leapgap.robot.model import Robot

CALIBRATION = {
    "lift": {"id": 1, "drive_mode": 0, "homing_offset": 12, "range_min": 900, "range_max": 3200},
    "roll": {"id": 2, "drive_mode": 1, "homing_offset": -40, "range_min": 100, "range_max": 4000},
    "gripper": {"id": 3, "drive_mode": 0, "homing_offset": 0, "range_min": 2000, "range_max": 3400},
}
CLOSED_RAD = -0.17
FPS, ROWS = 30, 300


def write_arm(folder: Path) -> Robot:
    """Two joints and a gripper, with position servos."""
    ranges = {"lift": "-1.8 1.8", "roll": "-3 3", "gripper": f"{CLOSED_RAD} 1.9"}
    bodies = "".join(
        f'<body pos="0 0 0.1"><joint name="{joint}" range="{ends}"/><geom size="0.02" mass="0.1"/>'
        for joint, ends in ranges.items()
    )
    servos = "".join(f'<position joint="{joint}" kp="18"/>' for joint in ranges)
    head = '<mujoco model="arm"><compiler angle="radian"/><worldbody>'
    path = folder / "lerobot_arm.xml"
    path.write_text(f"{head}{bodies}{'</body>' * 3}</worldbody><actuator>{servos}</actuator></mujoco>")
    return Robot.load(path)


def write_dataset(folder: Path) -> dict[str, np.ndarray]:
    """One episode of version 3; the true positions, rad, from the middle of each range, of the gripper from closed."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    time = np.arange(ROWS) / FPS
    names, truth, shares = [f"{joint}.pos" for joint in CALIBRATION], {}, []
    for i, (joint, one) in enumerate(CALIBRATION.items()):
        least, most = one["range_min"], one["range_max"]
        tick = 0.5 * (least + most) + 0.4 * (most - least) * np.sin(2 * time + i)
        share = (tick - least) / (most - least)
        if joint == "gripper":
            shares.append(100 * share)
            truth[joint] = CLOSED_RAD + (tick - least) * 2 * np.pi / 4095
        else:
            shares.append((200 * share - 100) * (-1 if one["drive_mode"] else 1))
            truth[joint] = (tick - 0.5 * (least + most)) * 2 * np.pi / 4095
    feature = {"dtype": "float32", "shape": [len(names)], "names": names}
    info = {
        **{"codebase_version": "v3.0", "robot_type": "so101_follower", "fps": FPS},
        "features": {"action": feature, "observation.state": feature},
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    values = np.stack(shares, axis=1)
    table = {
        "action": pa.array(np.roll(values, -1, axis=0).tolist()),
        "observation.state": pa.array(values.tolist()),
        "timestamp": pa.array(time.astype(np.float32)),
        "episode_index": pa.array(np.zeros(ROWS, dtype=int)),
    }
    pq.write_table(pa.table(table), folder / "data" / "chunk-000" / "file-000.parquet")
    return truth
