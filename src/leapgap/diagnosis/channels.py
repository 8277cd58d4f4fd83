"""Channels that are compared between a log and a replay, with unit, scale and index in the state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.schema import (
    BASE_ANGULAR_VELOCITY,
    BASE_POSITION,
    BASE_QUATERNION,
    BASE_VELOCITY,
    QUANTITIES,
    quantity_of,
)
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, VELOCITY_SLICE, Motion
from leapgap.robot.rotations import pitch_of, turn_between, turn_by

BASE_TURNS = ("base_roll", "base_pitch", "base_yaw")
PITCH = "base_pitch"
JUMP = {
    "base_pos_x": 0.05,
    "base_pos_z": 0.05,
    "base_pitch": 0.1,
    "base_linvel_x": 0.2,
    "base_linvel_z": 0.3,
    "base_angvel_y": 0.6,
}
"""Channels of the headline gap of jumps and their sizes: m, m, rad, m/s, m/s, rad/s."""
SPREAD_SHARE = 0.1
"""The size of a channel for which none is given: this share of its standard deviation within the logs."""
LEAST_SHARE = 0.1  # A channel's size is at least this share of the largest size among the channels of its quantity
SENSORS = ("imu_acc", "foot_force")  # Quantities that are compared and are no part of the state
FAST_S = 0.01
"""What a sensor beside the state does faster than this is not told from noise: impacts, vibration, its own filter."""
LEAST_SPREAD = 1e-6  # Smallest spread, so that a channel in which nothing moves can be divided by its size


@dataclass(frozen=True)
class Channel:
    """One compared component of the robot's state."""

    name: str  # Name of the column; ``base_roll``, ``base_pitch`` and ``base_yaw`` for the orientation of the base
    quantity: str
    """``base_pos``, ``base_turn``, ``base_linvel``, ``base_angvel``, ``joint_pos``, ``joint_vel``; beside the state
    ``imu_acc`` and ``foot_force``."""
    unit: str
    entry: int
    """Index in the tangent of the state: position 3, rotation in base axes 3, joints; then their velocities; then what
    sensors beside the state measure."""
    scale: float = 1.0  # Size of the channel: its errors are divided by it in the headline gap

    @property
    def is_state(self) -> bool:
        """Whether it is a component of the robot's state, and not a further sensor."""
        return self.quantity not in SENSORS


def state_channels(robot: Robot) -> tuple[Channel, ...]:
    """Every channel of the robot's state: base, joint positions, joint velocities."""
    nv, found = robot.model.nv, []
    if robot.has_free_base:
        for quantity, unit, entry, names in (
            ("base_pos", QUANTITIES["base_pos"].unit, 0, BASE_POSITION),
            ("base_turn", "rad", 3, BASE_TURNS),
            ("base_linvel", QUANTITIES["base_linvel"].unit, nv, BASE_VELOCITY),
            ("base_angvel", QUANTITIES["base_angvel"].unit, nv + 3, BASE_ANGULAR_VELOCITY),
        ):
            found += [Channel(name, quantity, unit, entry + axis) for axis, name in enumerate(names)]
    for quantity, first in (("joint_pos", 0), ("joint_vel", nv)):
        found += [
            Channel(f"{quantity}/{joint}", quantity, QUANTITIES[quantity].unit, first + int(dof))
            for joint, dof in zip(robot.joints, robot.joint_dofs, strict=True)
        ]
    return tuple(found)


def logged_channels(logs: Sequence[Log], robot: Robot, sensors: Sequence[str] = ()) -> tuple[Channel, ...]:
    """Channels of the state that every log has, then those of some columns of sensors, which every log has."""
    found = [c for c in state_channels(robot) if all(is_logged(log, c.name) for log in logs)]
    for k, column in enumerate(sensors):
        quantity = next(name for name in SENSORS if column.startswith(name))
        found.append(Channel(column, quantity, QUANTITIES[quantity].unit, 2 * robot.model.nv + k))
    return tuple(found)


def is_logged(log: Log, channel: str) -> bool:
    """Whether a log has the column of a channel as a measurement."""
    known = quantity_of(channel)
    if known is not None and known.name in log.derived:
        return False
    return (BASE_QUATERNION[0] if channel in BASE_TURNS else channel) in log


def tangent_difference(simulated: Motion, measured: Motion, robot: Robot) -> np.ndarray:
    """Simulated − measured in the tangent of the state, (rows, 2 nv); orientations as turns in base axes, rad.

    Where both have further sensors, their differences follow, (rows, 2 nv + sensors).
    """
    nv = robot.model.nv
    found = np.zeros((len(simulated), 2 * nv))
    if robot.has_free_base:
        found[:, VELOCITY_SLICE] = simulated.base_position - measured.base_position
        found[:, ANGULAR_VELOCITY_SLICE] = turn_between(measured.base_quaternion, simulated.base_quaternion)
    found[:, robot.joint_dofs] = simulated.qpos[:, robot.joint_qpos] - measured.qpos[:, robot.joint_qpos]
    found[:, nv:] = simulated.qvel - measured.qvel
    if simulated.sensors is None or measured.sensors is None:
        return found
    return np.concatenate([found, simulated.sensors - measured.sensors], axis=1)


def displaced(motion: Motion, by: np.ndarray, robot: Robot) -> Motion:
    """The motion displaced by small steps (rows, 2 nv) in the tangent of its states, the inverse of the difference."""
    nv, found = robot.model.nv, motion.copy()
    if robot.has_free_base:
        found.base_position[:] += by[:, VELOCITY_SLICE]
        found.base_quaternion[:] = turn_by(motion.base_quaternion, by[:, ANGULAR_VELOCITY_SLICE])
    found.qpos[:, robot.joint_qpos] += by[:, robot.joint_dofs]
    found.qvel[:] += by[:, nv:]
    return found


def channel_errors(simulated: Motion, measured: Motion, channels: Sequence[Channel], robot: Robot) -> np.ndarray:
    """Simulated − measured in some channels, (rows, channels); pitch is the difference of the two pitch angles."""
    errors = tangent_difference(simulated, measured, robot)[:, [channel.entry for channel in channels]]
    for k, channel in enumerate(channels):
        if channel.name == PITCH:
            errors[:, k] = pitch_of(simulated.base_quaternion) - pitch_of(measured.base_quaternion)
    return errors


def logged_values(log: Log, channel: str) -> np.ndarray:
    """Logged values of one channel, by its name, (rows,)."""
    return log.angles[channel] if channel in BASE_TURNS else log[channel]


def sensor_noise(
    measured: Motion, period_s: float, channels: Sequence[Channel], robot: Robot, lengths: np.ndarray | None = None
) -> np.ndarray:
    """Standard deviation of each channel's sensor noise, (channels,); ``lengths`` of uneven steps."""
    found = noise_of(channel_errors(measured[1:], measured[:-1], channels, robot), period_s, lengths)
    return with_fast_parts(found, measured, period_s, channels)


def with_fast_parts(found: np.ndarray, measured: Motion, period_s: float, channels: Sequence[Channel]) -> np.ndarray:
    """Noise (channels,), with that of sensors beside the state replaced by what they do within ``FAST_S``.

    It is the root mean square departure from the mean over that time, or over three rows.
    """
    of_sensors = [k for k, channel in enumerate(channels) if not channel.is_state]
    if not of_sensors or measured.sensors is None:
        return found
    reach = max(1, round(FAST_S / period_s / 2))
    kernel, ones = np.ones(2 * reach + 1), np.ones(len(measured))
    number = np.convolve(ones, kernel, "same")
    mean = np.stack([np.convolve(column, kernel, "same") / number for column in measured.sensors.T], axis=1)
    fast = np.sqrt(((measured.sensors - mean) ** 2).mean(axis=0))
    noise = found.copy()
    noise[of_sensors] = fast[[k - of_sensors[0] for k in of_sensors]]
    return noise


def jump_channels(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """The channels of the headline gap of jumps, at their sizes."""
    return tuple(replace(channel, scale=JUMP[channel.name]) for channel in channels if channel.name in JUMP)


def sized_channels(
    motions: Sequence[Motion], channels: Sequence[Channel], robot: Robot, sizes: Mapping[str, float]
) -> tuple[Channel, ...]:
    """All channels at their sizes: those given by name or quantity, else a tenth of their spread within the logs."""
    departures = [channel_errors(motion, motion[np.zeros(len(motion), int)], channels, robot) for motion in motions]
    spread = np.concatenate([departure - departure.mean(axis=0) for departure in departures]).std(axis=0)
    found = []
    for k, channel in enumerate(channels):
        alike = [spread[i] for i, other in enumerate(channels) if other.quantity == channel.quantity]
        own = SPREAD_SHARE * max(float(spread[k]), LEAST_SHARE * float(max(alike)), LEAST_SPREAD)
        found.append(replace(channel, scale=sizes.get(channel.name, sizes.get(channel.quantity, own))))
    return tuple(found)
