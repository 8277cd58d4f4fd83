"""Velocities from logged positions: a local polynomial by least squares, on the log's own and maybe uneven instants."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY

DEGREES = (2, 3)
CHUNK_VALUES = 1 << 21  # weights of so many values are in memory at once, so that a long log needs no more of it


@dataclass(frozen=True)
class VelocityFit:
    """Velocities, and how the noise of the positions gets into them."""

    velocity: np.ndarray  # of each channel in each row, unit of the positions per s, (rows, channels)
    noise_gain: np.ndarray  # of a velocity where positions have independent noise of deviation 1, 1/s, (rows,)


def velocity_fit(time: np.ndarray, position: np.ndarray, window_s: float, degree: int = 2) -> VelocityFit:
    """Slope, at each instant, of the polynomial that fits the positions within half a window of it best.

    ``time`` (rows,) increases strictly, in steps of any length. ``position`` is (rows, channels) or (rows,), and the
    velocity has its shape. Where the window holds too few rows, or at the ends of the log, the nearest rows are taken
    beside it. A polynomial of degree 2 or 3 follows motions of that degree exactly.
    """
    rows, least = len(time), degree + 2
    if rows < least:
        raise InputError("velocity_fit", f"{rows} rows", f"{least} or more", "log more of the motion")
    # First row, and the row after the last, of the window about each row; ``least`` rows or more are in it
    half = 0.5 * window_s * (1 + 1e-9)
    first, last = np.searchsorted(time, time - half, "left"), np.searchsorted(time, time + half, "right")
    short = last - first < least
    nearest = np.clip(np.arange(len(time)) - (least - 1) // 2, 0, len(time) - least)
    first = np.where(short, np.minimum(first, nearest), first)
    first, last = (first, np.where(short, np.maximum(last, nearest + least), last))
    width = int((last - first).max())
    flat = position.reshape(rows, -1)
    velocity, gain = np.empty(flat.shape), np.empty(rows)
    chunk = max(1, CHUNK_VALUES // (width * (degree + 1)))
    for begin in range(0, rows, chunk):
        at = np.arange(begin, min(begin + chunk, rows))
        taken = first[at, None] + np.arange(width)
        inside = taken < last[at, None]
        taken = np.where(inside, taken, 0)
        # Weights (rows, k) that turn the positions of a window into the slope at its centre
        offset = np.where(inside, time[taken] - time[at, None], 0.0)
        scale = np.abs(offset).max(axis=1, keepdims=True)  # times of the order of 1: AᵀA stays well conditioned
        powers = (offset / scale)[:, :, None] ** np.arange(degree + 1) * inside[:, :, None]
        moments = np.einsum("rki,rkj->rij", powers, powers)
        slope = np.zeros((degree + 1, 1))
        slope[1] = 1.0
        of_slope = np.linalg.solve(moments, np.broadcast_to(slope, (len(offset), degree + 1, 1)))[:, :, 0]
        weights = np.einsum("ri,rki->rk", of_slope, powers) / scale
        velocity[at] = np.einsum("rk,rkc->rc", weights, flat[taken])
        gain[at] = np.sqrt((weights**2).sum(axis=1))
    return VelocityFit(velocity.reshape(position.shape), gain)


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
