"""A picture of a robot: the link that a joint moves is in colour, and what is not the robot is transparent."""

from io import BytesIO

import numpy as np
import pytest

from leapgap.robot.model import Robot
from leapgap.robot.picture import png, robot_picture


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
