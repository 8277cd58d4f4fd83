"""Synthetic jumps whose law is known: a rigid body with gains, stepped exactly on the windows' grid."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from leapgap.jumping.learning import window_extraction
from leapgap.jumping.learning.windows import TimeGrid, Windows
from leapgap.jumping.models.rigid_body import advance
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_pair
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, COMMANDS, PAIR_FORCE_AXES
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from tests.conftest import A1_BODY

PERIOD_S = 0.005
CROUCH = np.tile([0.0, 1.0, -2.0], 4)
TRUE_GAINS = (0.5, 0.9, 0.3)


def pose(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base position (n, 3) and quaternion (n, 4) of planar states (n, 6)."""
    position = np.stack([state[:, 0], np.zeros(len(state)), state[:, 1]], axis=-1)
    return position, Rotation.from_euler("y", state[:, 2:3]).as_quat(scalar_first=True)


def law(robot: Robot, state: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(v̇x, v̇z, ω̇) of one state (6,) under forces (4,)."""
    position, quaternion = pose(state[None])
    foot = (per_pair(robot, feet_in_world(robot, position, quaternion, CROUCH[None]) - position[:, None]) / 2)[0]
    rows = A1_BODY.force_rows(foot) * np.array(TRUE_GAINS)[:, None]
    return rows @ force + [0.0, -9.81, 0.0]


def synthetic_jump(
    name: str,
    robot: Robot,
    schedule: ContactSchedule | None = None,
    start_x: float = 0.3,
    grid: TimeGrid = TimeGrid(),  # noqa: B008 - frozen
) -> Log:
    """A jump of random forces, different for every name, that obeys ``law`` on the steps of a grid."""
    schedule = schedule or ContactSchedule()
    random = np.random.default_rng(sum(map(ord, name)))
    times, contact = grid.sample_times(schedule), np.arange(grid.jump_steps(schedule)) < grid.contact_steps(schedule)
    steps = np.where(contact, grid.contact_step_s, grid.flight_step_s)
    force, states = [], [np.array([start_x, 0.3, 0.02 * random.normal(), 0.0, 0.0, 0.0])]
    for pushing, dt in zip(contact, steps, strict=True):
        balance = 600 * states[-1][2] + 120 * states[-1][5]  # keeps the pitch where it is an angle
        push = np.array([10.0, 80.0 + balance, 20.0, 80.0 - balance]) + random.normal(0, 15, 4)
        force.append(push if pushing else np.zeros(4))
        states.append(advance(states[-1], law(robot, states[-1], force[-1]), np.asarray(dt)))
    clock = np.arange(round(times[-1] / PERIOD_S) + 1) * PERIOD_S
    state = np.stack([np.interp(clock, times, column) for column in np.array(states).T], axis=-1)
    held = np.array(force)[np.minimum(np.searchsorted(times, clock + 1e-9, side="right") - 1, len(steps) - 1)]
    position, quaternion = pose(state)
    columns = {"time": clock}
    columns |= dict(zip(BASE_POSITION, position.T, strict=True)) | dict(zip(BASE_QUATERNION, quaternion.T, strict=True))
    columns |= {"base_linvel_x": state[:, 3], "base_linvel_z": state[:, 4], "base_angvel_y": state[:, 5]}
    for joint, angle in zip(robot.joints, CROUCH, strict=True):
        columns[f"joint_pos/{joint}"] = np.full(len(clock), angle)
        columns |= {f"{command}/{joint}": np.zeros(len(clock)) for command in COMMANDS}
    for i, axis in enumerate(PAIR_FORCE_AXES):
        columns[f"mpc_force/{axis}"], columns[f"pd_force/{axis}"] = 0.75 * held[:, i], 0.25 * held[:, i]
    return Log(name, columns, jump_info("a1", PERIOD_S, schedule, Target(0.5), "synthetic"))


@pytest.fixture(scope="session")
def jumps(robot: Robot) -> list[Log]:
    return [synthetic_jump(f"jump_{i:02d}", robot, start_x=0.1 * i) for i in range(6)]


@pytest.fixture(scope="session")
def windows(robot: Robot, jumps: list[Log]) -> Windows:
    return window_extraction.cut(jumps, TimeGrid(), robot)


@pytest.fixture(scope="session")
def real_windows(robot: Robot, real_jumps: list[Log]) -> Windows:
    """Of the published jumps, where a copy is at hand."""
    return window_extraction.cut(real_jumps, TimeGrid(), robot)
