"""Fixtures that more than one part needs."""

import os
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from tests.project import run_once

A1_BODY = RigidBody(mass_kg=12.453, pitch_inertia_kgm2=0.347)
CROUCH = (0.0, 1.2566371, -2.3561945)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of pipelines first, then those of other long tests: else one worker ends with them while others wait."""
    of_files = {(item.path, mark.name) for item in items for mark in item.iter_markers()}
    items.sort(key=lambda item: [(item.path, mark) not in of_files for mark in ("pipeline", "long")])


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot.load()


@pytest.fixture(scope="session")
def raw() -> Path:
    """The published jumps in their own layout, where this machine has them."""
    for folder in (os.environ.get("LEAPGAP_RAW"), "data/raw"):
        if folder and log_format("published").find(Path(folder)):
            return Path(folder)
    pytest.skip("no published jumps: set LEAPGAP_RAW or fill data/raw")


@pytest.fixture(scope="session")
def simulated_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project whose whole pipeline ran on simulated hardware, once for all processes of this call; not to change."""
    own = tmp_path_factory.getbasetemp()
    return run_once(own.parent if "PYTEST_XDIST_WORKER" in os.environ else own)


@pytest.fixture(scope="session")
def real_jumps(raw: Path, robot: Robot) -> list[Log]:
    published = log_format("published")
    return [published.read(path, name, robot, published.Options()) for name, path in published.find(raw).items()]


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory, robot: Robot) -> Log:
    """A 50 cm jump planned for the nominal robot."""
    return reference_to(Target(0.5), tmp_path_factory.mktemp("none"), planar_robot(robot))


def standing(
    robot: Robot, rows: int = 400, height_m: float = 0.1726, kp: float = 300.0, kd: float = 3.0, **changed: np.ndarray
) -> Log:
    """A log of the A1 held in its crouch, ``height_m`` of the trunk above the floor."""
    columns = {"time": np.arange(rows) / 1000}
    still = {"base_pos_z": height_m, "base_quat_w": 1.0}
    for name in BASE_POSITION + BASE_QUATERNION + BASE_VELOCITY + BASE_ANGULAR_VELOCITY:
        columns[name] = np.full(rows, still.get(name, 0.0))
    for i, joint in enumerate(robot.joints):
        angle = np.full(rows, CROUCH[i % 3])
        columns |= {f"joint_pos/{joint}": angle, f"joint_vel/{joint}": np.zeros(rows)}
        columns |= {f"cmd_tau/{joint}": np.zeros(rows), f"cmd_pos/{joint}": angle, f"cmd_vel/{joint}": np.zeros(rows)}
        columns |= {f"cmd_kp/{joint}": np.full(rows, kp), f"cmd_kd/{joint}": np.full(rows, kd)}
    info = jump_info("a1", 0.001, ContactSchedule(), Target(0.0), "made for a test")
    return Log("standing", columns | changed, info)
