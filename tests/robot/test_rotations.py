"""Angles of quaternions and turns between them, against MuJoCo's rotations."""

import mujoco
import numpy as np
import pytest

from leapgap.robot.rotations import pitch_of, turn_between, turn_by, upright_cosine, yaw_of


def quaternions(rows: int = 50) -> np.ndarray:
    drawn = np.random.default_rng(3).normal(size=(rows, 4))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def matrix(quaternion: np.ndarray) -> np.ndarray:
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def test_pitch_is_positive_nose_down_and_yaw_to_the_left() -> None:
    for quaternion in quaternions():
        forward = matrix(quaternion)[:, 0]
        assert np.sin(pitch_of(quaternion)) == pytest.approx(-forward[2])
        assert yaw_of(quaternion) == pytest.approx(np.arctan2(forward[1], forward[0]))
        assert upright_cosine(quaternion) == pytest.approx(matrix(quaternion)[2, 2])


def test_many_at_once_are_the_same_to_the_last_bit_as_one_at_a_time() -> None:
    several = quaternions(12)
    for angle in (pitch_of, yaw_of):
        assert np.array_equal(angle(several.reshape(3, 4, 4)).ravel(), [angle(one) for one in several])


def test_a_length_a_little_above_one_gives_the_pitch_of_a_vertical_nose() -> None:
    assert pitch_of(np.array([1.0, 0.0, 1.0, 0.0]) * np.sqrt(0.5) * (1 + 1e-9)) == pytest.approx(np.pi / 2)


def test_a_small_turn_is_about_the_axes_of_the_body_and_is_found_again() -> None:
    first = quaternions()
    by = np.random.default_rng(4).normal(size=(len(first), 3)) * 1e-3
    expected = first.copy()
    for row, turn in zip(expected, by, strict=True):
        mujoco.mju_quatIntegrate(row, turn, 1.0)
    after = turn_by(first, by)
    assert np.abs(after - expected).max() < 2e-8
    assert np.abs(turn_between(first, expected) - by).max() < 2e-8
    assert np.abs(turn_between(first, -expected) - by).max() < 2e-8  # q and −q are one attitude


def test_one_quaternion_turns_as_it_does_among_others() -> None:
    """Bit for bit: replays turn all rows at once, a closed loop one at each tick."""
    first = quaternions()
    by = np.random.default_rng(5).normal(size=(len(first), 3)) * 1e-2
    apart = [turn_by(one[None], angles[None])[0] for one, angles in zip(first, by, strict=True)]
    assert np.array_equal(apart, turn_by(first, by))
