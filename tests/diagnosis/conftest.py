"""A jump to diagnose."""

import pytest

from leapgap.planning.library import reference_to
from leapgap.recording.jump import Jump, Target
from leapgap.robot.planar import PlanarRobot


@pytest.fixture(scope="session")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Jump:
    """A 50 cm jump as published: its feet do not slip, and its motors have voltage to spare while all of them stand."""
    return reference_to(Target(0.5), tmp_path_factory.mktemp("none"), PlanarRobot())
