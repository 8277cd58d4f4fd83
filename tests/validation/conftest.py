"""A small world to withhold in."""

import pytest

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.validation.case import CaseSetup


@pytest.fixture(scope="session")
def world() -> CaseSetup:
    return CaseSetup(
        jumps=2, proof_jumps=1, block_height_m=(0.0, 0.04), step_s=0.0005, period_scatter=0.1, where_horizon_s=0.1
    )


@pytest.fixture(scope="session")
def references(tmp_path_factory: pytest.TempPathFactory) -> list[Log]:
    return [reference_to(Target(0.45), tmp_path_factory.mktemp("none"), PlanarRobot())]
