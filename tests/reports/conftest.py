import numpy as np
import pytest

from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.robot.terrain import Box

ROWS = 601
CROUCH = (0.1, 1.2566371, -2.3561945)
GRAVITY = 9.81


def make_hop(robot, speed_x=1.0, rows=ROWS, without=()):
    """A crouch until 0.2 s, then a ballistic hop that turns about all axes; rows at 1 kHz."""
    time = np.arange(rows) / 1000
    flight = np.clip(time - 0.2, 0, None)
    columns = {
        "time": time,
        "base_pos_x": 0.1 + speed_x * flight,
        "base_pos_y": 0.02 * flight,
        "base_pos_z": 0.1726 + 2.0 * flight - GRAVITY * flight**2 / 2,
    }
    pitch, yaw = -2.0 * flight, 0.3 * flight  # q = yaw about z, then pitch about y
    half = np.stack([np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch / 2), np.sin(pitch / 2)])
    quaternion = [half[0] * half[2], -half[1] * half[3], half[0] * half[3], half[1] * half[2]]
    columns |= dict(zip(BASE_QUATERNION, quaternion, strict=True))
    columns["base_linvel_x"] = np.where(flight > 0, speed_x, 0.0)
    for i, joint in enumerate(robot.joints):
        columns[f"joint_pos/{joint}"] = CROUCH[i % 3] + 0.1 * np.sin(5 * time + i)
        columns[f"joint_vel/{joint}"] = 0.5 * np.cos(5 * time + i)
        columns[f"cmd_tau/{joint}"] = np.full(rows, 1.0 + i)
        columns[f"cmd_pos/{joint}"] = np.full(rows, CROUCH[i % 3])
        columns[f"cmd_vel/{joint}"] = np.zeros(rows)
        columns[f"cmd_kp/{joint}"] = np.where(time < 0.5, 100.0, 50.0)
        columns[f"cmd_kd/{joint}"] = np.full(rows, 2.0)
    for axis, force in zip(("front_x", "front_z", "rear_x", "rear_z"), (5.0, 60.0, 7.0, 80.0), strict=True):
        columns[f"mpc_force/{axis}"] = np.full(rows, force)
    for foot in robot.feet:
        columns[f"contact/{foot}"] = (time < 0.2).astype(float)
    columns = {name: values for name, values in columns.items() if not name.startswith(tuple(without))}
    info = jump_info(
        robot=robot.name,
        sample_period_s=0.001,
        schedule=ContactSchedule(0.1, 0.1, 0.4),
        target=Target(0.4, 0.0),
        source="a hop made for a test",
        terrain=(Box(0.3, 0.0, (0.2, 0.5, 0.05), 0.05, True),),
    )
    return Log("hop", columns, info)


@pytest.fixture(scope="session")
def hop(robot):
    return make_hop(robot)


@pytest.fixture(scope="session")
def ghost(robot):
    """The same hop, slower and shorter, with measured columns only."""
    return make_hop(robot, speed_x=0.8, rows=ROWS - 100, without=("mpc_force", "contact"))


@pytest.fixture
def base_columns():
    return (*BASE_POSITION, *BASE_QUATERNION, "base_linvel_x")
