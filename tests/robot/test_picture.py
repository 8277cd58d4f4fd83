"""A picture of a robot: the link that a joint moves is in colour, and what is not the robot is transparent."""

from io import BytesIO
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.robot.model import Robot
from leapgap.robot.picture import png, robot_picture, shown_model


def test_a_png_holds_its_pixels() -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 4), np.uint8)
    assert np.array_equal(np.asarray(image.open(BytesIO(png(pixels)))), pixels)


def test_the_link_of_a_joint_is_in_colour(robot: Robot) -> None:
    image = pytest.importorskip("PIL.Image")
    pictures = [robot_picture(robot, joints) for joints in ((), ("RR_calf",))]
    if pictures[0] is None or pictures[1] is None:
        pytest.skip("nothing here draws without a screen")
    plain, coloured = (np.asarray(image.open(BytesIO(one)), int) for one in pictures)
    orange = [(one[..., 0] > one[..., 2] + 60) & (one[..., 3] > 0) for one in (plain, coloured)]
    assert orange[0].sum() == 0
    shown = (coloured[..., 3] > 0).mean()
    assert 50 < orange[1].sum() < 0.2 * coloured[..., 3].astype(bool).sum()
    assert 0.02 < shown < 0.7


def test_a_link_of_hidden_shapes_alone_is_drawn_by_these(tmp_path: Path) -> None:
    """Meshes that are missing leave contact shapes, of group 3; where a link shows one, its hidden ones stay hidden."""
    (tmp_path / "arm.xml").write_text("""<mujoco><worldbody>
      <body name="upper"><joint name="shoulder"/><geom size="0.1" group="3"/>
        <body name="lower"><joint name="elbow"/><geom size="0.1"/><geom size="0.2" group="3"/></body>
      </body></worldbody><actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>""")
    assert shown_model(Robot.load(tmp_path / "arm.xml")).geom_group.tolist() == [0, 0, 3]


def test_a_model_without_shapes_is_drawn_from_joint_to_joint(tmp_path: Path) -> None:
    """The upper link reaches to the elbow, 0.5 m on; the lower one over its centre of mass, to twice 0.2 m."""
    inertia = 'mass="1" diaginertia="0.1 0.1 0.1"'
    (tmp_path / "arm.xml").write_text(f"""<mujoco><worldbody>
      <body name="upper"><inertial pos="0 0 0.25" {inertia}/><joint name="shoulder" axis="0 1 0"/>
        <body name="lower" pos="0 0 0.5"><inertial pos="0.2 0 0" {inertia}/><joint name="elbow" axis="0 1 0"/></body>
      </body></worldbody><actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>""")
    robot = Robot.load(tmp_path / "arm.xml")
    shown = shown_model(robot)
    assert shown.geom_bodyid.tolist() == [shown.body("upper").id, shown.body("lower").id]
    assert (shown.geom_type == int(mujoco.mjtGeom.mjGEOM_CAPSULE)).all()
    np.testing.assert_allclose(shown.geom_size[:, 1], [0.25, 0.2])  # half lengths
    np.testing.assert_allclose(shown.geom_pos, [[0, 0, 0.25], [0.2, 0, 0]], atol=1e-12)
    assert robot.model.ngeom == 0
