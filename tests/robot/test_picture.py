"""Pictures of a robot: the link that a joint moves is in colour, and what is not the robot is transparent; loops."""

from io import BytesIO
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.robot.model import Robot
from leapgap.robot.picture import COLOURS, LENGTH_S, PER_S, animated, png, robot_loop, robot_picture, shown_model
from tests import plain_arm


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


def test_parts_that_change_make_the_whole_pictures() -> None:
    """A square that moves, one picture without a change, and a square that vanishes."""
    image = pytest.importorskip("PIL.Image")
    pictures = np.zeros((4, 270, 360, 4), np.uint8)
    for k, at in enumerate((10, 60, 60)):
        pictures[k, at : at + 20, at : at + 30] = (200, 80, 40, 255)
    read = image.open(BytesIO(animated(iter(pictures), len(pictures))))
    assert (read.n_frames, read.info["loop"]) == (4, 0)
    for k, picture in enumerate(pictures):
        read.seek(k)
        assert np.array_equal(np.asarray(read.convert("RGBA")), picture)


def test_a_loop_shows_what_was_measured_above_its_replays(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    robot = Robot.load(plain_arm.write_model(tmp_path))
    time = np.arange(2000) * 1e-3
    measured = np.stack([0.6 * np.sin(4 * time), 0.8 * np.sin(7 * time)], axis=1)
    loop = robot_loop(robot, time, [measured, measured + 0.5, measured])
    if loop is None:
        pytest.skip("this machine does not draw without a screen")
    read = image.open(BytesIO(loop.png))
    assert read.n_frames == pytest.approx(LENGTH_S * PER_S, abs=1)
    assert loop.slower == pytest.approx(LENGTH_S / 2, rel=1e-3)
    read.seek(read.n_frames // 2)
    pixels = np.asarray(read.convert("RGBA")).astype(float) / 255
    shown = pixels[pixels[..., 3] == 1][:, :3]
    hue = shown - shown.mean(axis=1, keepdims=True)
    like = [(hue @ (np.array(colour[:3]) - np.mean(colour[:3])) > 0.1).sum() for colour in COLOURS[1:]]
    assert like[0] > 50  # the nominal replay stands beside the robot
    assert like[1] == 0  # the corrected one is hidden behind it
    assert 0.5 < (pixels[..., 3] == 0).mean() < 1


def test_positions_that_are_no_numbers_make_no_loop(tmp_path: Path) -> None:
    robot = Robot.load(plain_arm.write_model(tmp_path))
    time = np.arange(100) * 1e-3
    lost = np.full((100, 2), np.nan)
    assert robot_loop(robot, time, [lost, lost]) is None
