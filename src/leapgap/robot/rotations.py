"""Rotations as quaternions w x y z, base to world: the angles read from them, and turns between them."""

import math

import mujoco
import numpy as np


def pitch_of(quaternion: np.ndarray) -> np.ndarray:
    """Pitch of quaternions (…, 4), rad, positive nose-down, about y of the roll-pitch-yaw angles, shape (…,)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))  # written out, since controllers call it at every tick
    return np.arcsin(np.maximum(-1.0, np.minimum(1.0, 2 * (w * y - z * x))))


def roll_of(quaternion: np.ndarray) -> np.ndarray:
    """Roll of quaternions (…, 4), rad, positive to the right, about x of the roll-pitch-yaw angles, shape (…,)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))


def yaw_of(quaternion: np.ndarray) -> np.ndarray:
    """Heading of quaternions (…, 4) in the world, rad, positive to the left, shape (…,)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def upright_cosine(quaternion: np.ndarray) -> np.ndarray:
    """Cosine of the angle between the base's vertical axis and the world's, of quaternions (…, 4), shape (…,)."""
    x, y = quaternion[..., 1], quaternion[..., 2]
    return 1 - 2 * (x**2 + y**2)


def turn_by(quaternion: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Quaternions (rows, 4) turned about the body's axes by small angles (rows, 3), rad; unit length."""
    if len(quaternion) == 1:  # a controller's tick: numbers are five times as fast as arrays of one
        return turn_one_by(quaternion[0], angles[0])[None]
    w, x, y, z = quaternion.T
    a, b, c = (angles / 2).T
    small = np.stack(
        [w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a],
        axis=1,
    )
    return small / np.linalg.norm(small, axis=1, keepdims=True)


def turn_one_by(quaternion: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """``turn_by`` for one quaternion (4,) and its angles (3,), bit for bit the same, (4,)."""
    w, x, y, z = quaternion.tolist()
    a, b, c = (angle / 2 for angle in angles.tolist())
    w, x, y, z = (
        w - x * a - y * b - z * c,
        x + w * a + y * c - z * b,
        y + w * b + z * a - x * c,
        z + w * c + x * b - y * a,
    )
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return np.array([w / length, x / length, y / length, z / length])


def turn_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rotation vectors (rows, 3), rad, in the axes of ``first``, that take quaternions (rows, 4) to ``second``.

    For small turns: twice the imaginary part of first⁻¹ second, which is 2 sin(θ/2) along the axis.
    """
    w1, x1, y1, z1 = first.T
    w2, x2, y2, z2 = second.T
    imaginary = np.stack(
        [
            w1 * x2 - x1 * w2 - y1 * z2 + z1 * y2,
            w1 * y2 + x1 * z2 - y1 * w2 - z1 * x2,
            w1 * z2 - x1 * y2 + y1 * x2 - z1 * w2,
        ],
        axis=1,
    )
    real = (first * second).sum(axis=1)
    return 2 * imaginary * np.sign(real)[:, None]


def continuous(quaternion: np.ndarray) -> np.ndarray:
    """The same attitudes (rows, 4) with signs that never flip: q and −q are the same turn."""
    products = (quaternion[1:] * quaternion[:-1]).sum(axis=1)
    if not (products < 0).any():
        return quaternion
    return quaternion * np.concatenate([[1.0], np.cumprod(np.where(products < 0, -1.0, 1.0))])[:, None]


def matrix_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of one quaternion w x y z, (3, 3)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion))
    return matrix.reshape(3, 3)
