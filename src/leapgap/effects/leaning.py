"""Turns of the world by a roll and a pitch, for what leans."""

import mujoco
import numpy as np


def lean(roll_rad: float, pitch_rad: float) -> np.ndarray:
    """Quaternion w x y z of a turn by the roll about the world's x axis, then by the pitch about its y axis."""
    roll = np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])
    pitch = np.array([np.cos(pitch_rad / 2), 0.0, np.sin(pitch_rad / 2), 0.0])
    turn = np.empty(4)
    mujoco.mju_mulQuat(turn, pitch, roll)
    return turn


def inverse(turn: np.ndarray) -> np.ndarray:
    """The quaternion that turns back."""
    return turn * np.array([1.0, -1.0, -1.0, -1.0])


def rotated(vectors: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors (rows, 3) turned by a quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, turn)
    return np.asarray(vectors @ matrix.reshape(3, 3).T)
