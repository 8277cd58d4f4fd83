"""The loop of a report, read back by Pillow."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from leapgap.robot.loop import COLOURS, LENGTH_S, PER_S, animated, robot_loop
from leapgap.robot.model import Robot
from tests import plain_arm


def test_parts_that_change_make_the_whole_pictures() -> None:
    """A square that moves, one picture without a change, and a square that vanishes."""
    pictures = np.zeros((4, 270, 360, 4), np.uint8)
    for k, at in enumerate((10, 60, 60)):
        pictures[k, at : at + 20, at : at + 30] = (200, 80, 40, 255)
    read = Image.open(io.BytesIO(animated(iter(pictures), len(pictures))))
    assert (read.n_frames, read.info["loop"]) == (4, 0)
    for k, picture in enumerate(pictures):
        read.seek(k)
        assert np.array_equal(np.asarray(read.convert("RGBA")), picture)


def test_a_loop_shows_what_was_measured_above_its_replays(tmp_path: Path) -> None:
    robot = Robot.load(plain_arm.write_model(tmp_path))
    time = np.arange(2000) * 1e-3
    measured = np.stack([0.6 * np.sin(4 * time), 0.8 * np.sin(7 * time)], axis=1)
    loop = robot_loop(robot, time, [measured, measured + 0.5, measured])
    if loop is None:
        pytest.skip("this machine does not draw without a screen")
    read = Image.open(io.BytesIO(loop.png))
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
