"""Velocities that a log lacks, from its positions, with a word for its metadata that they were not measured."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY


def add_velocities(log: Log, joints: Sequence[str], window_s: float) -> tuple[Log, dict[str, str]]:
    """The log with velocities fitted through its positions where it has none, and what is derived, by quantity.

    Of the joints each is completed alone; of the base its velocity, and its angular velocity in base axes.
    """
    added: dict[str, np.ndarray] = {}
    derived: dict[str, str] = {}

    def fit(columns: Sequence[str]) -> np.ndarray:
        return velocity_fit(log.time, log.stack(columns), window_s).velocity

    def add(quantity: str, columns: Sequence[str], values: np.ndarray, through: str) -> None:
        added.update(zip(columns, values.T, strict=True))
        derived[quantity] = f"not measured: slope of parabolas through {through} within {window_s:g} s"

    bare = [joint for joint in joints if f"joint_pos/{joint}" in log and f"joint_vel/{joint}" not in log]
    if bare:
        velocity = fit([f"joint_pos/{joint}" for joint in bare])
        add("joint_vel", [f"joint_vel/{joint}" for joint in bare], velocity, "joint_pos")
    if BASE_POSITION[0] in log and not any(column in log for column in BASE_VELOCITY):
        add("base_linvel", BASE_VELOCITY, fit(BASE_POSITION), "base_pos")
    if BASE_QUATERNION[0] in log and not any(column in log for column in BASE_ANGULAR_VELOCITY):
        turn = log.stack(BASE_QUATERNION)
        rate = velocity_fit(log.time, turn, window_s).velocity
        add("base_angvel", BASE_ANGULAR_VELOCITY, angular_velocity(turn, rate), "base_quat")
    return (replace(log, columns={**log.columns, **added}) if added else log), derived


def angular_velocity(quaternion: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Angular velocity in base axes, rad/s, (rows, 3): the vector part of 2 q* q̇, for q w x y z, base to world."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    rate_w, rate_v = rate[:, :1], rate[:, 1:]
    return 2 * (w * rate_v - rate_w * v - np.cross(v, rate_v))
