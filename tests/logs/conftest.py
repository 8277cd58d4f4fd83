"""An arm of two joints, whose logs several importers read."""

from pathlib import Path

import pytest

from leapgap.robot.model import Robot

TWO_JOINTS = """<mujoco model="two"><worldbody><body><joint name="shoulder" axis="0 1 0" range="-2 2"/>
<geom size="0.1"/><body pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" range="-2.5 0"/><geom size="0.1"/></body>
</body></worldbody><compiler angle="radian"/><actuator>
<general joint="shoulder" gainprm="1" biastype="affine"/><general joint="elbow" gainprm="1" biastype="affine"/>
</actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    (tmp_path / "two.xml").write_text(TWO_JOINTS)
    return Robot.load(tmp_path / "two.xml")
