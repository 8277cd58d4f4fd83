"""A jump to diagnose."""

import pytest

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import Target
from leapgap.logs.log import Log


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """A 50 cm jump as published: its feet do not slip, and its motors have voltage to spare while all of them stand."""
    return reference_to(Target(0.5), tmp_path_factory.mktemp("none"), PlanarRobot())
