"""A small world to withhold in."""

import pytest

from leapgap.blind.withholding import World
from leapgap.planning.library import reference_to
from leapgap.recording.jump import Jump, Target
from leapgap.robot.planar import PlanarRobot


@pytest.fixture(scope="session")
def world() -> World:
    return World(
        jumps=2, proof_jumps=1, block_height_m=(0.0, 0.04), step_s=0.0005, period_scatter=0.1, where_horizon_s=0.1
    )


@pytest.fixture(scope="session")
def references(tmp_path_factory: pytest.TempPathFactory) -> list[Jump]:
    return [reference_to(Target(0.45), tmp_path_factory.mktemp("none"), PlanarRobot())]
