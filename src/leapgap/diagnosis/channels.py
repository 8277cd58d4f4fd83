"""Channels that are compared between a log and a replay, with unit, scale and index in the state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, QUANTITIES
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import pitch_of

BASE_TURNS = ("base_roll", "base_pitch", "base_yaw")
HEADLINE = {
    "base_pos_x": 0.05,
    "base_pos_z": 0.05,
    "base_pitch": 0.1,
    "base_linvel_x": 0.2,
    "base_linvel_z": 0.3,
    "base_angvel_y": 0.6,
}
"""Channels of the headline gap and their scales: m, m, rad, m/s, m/s, rad/s."""
JOINT_SCALES = {"joint_pos": 0.1, "joint_vel": 1.0}
"""Scales of joint channels, rad and rad/s; on a robot with a fixed base they form the headline gap."""


@dataclass(frozen=True)
class Channel:
    """One compared component of the robot's state."""

    name: str
    """Name of the column; ``base_roll``, ``base_pitch`` and ``base_yaw`` for the orientation of the base."""
    quantity: str
    """``base_pos``, ``base_turn``, ``base_linvel``, ``base_angvel``, ``joint_pos`` or ``joint_vel``."""
    unit: str
    entry: int
    """Index in the tangent of the state: position 3, rotation in base axes 3, joints; then their velocities."""
    scale: float | None = None
    """Unit of the channel in the headline gap; None where it is not part of it."""

    @property
    def column(self) -> str:
        """The column that a log needs to have this channel."""
        return BASE_QUATERNION[0] if self.quantity == "base_turn" else self.name

    def values(self, motion: Motion, robot: Robot) -> np.ndarray:
        """Values of the channel in a motion, (rows,); of the orientation only pitch has values."""
        if self.name == "base_pitch":
            return pitch_of(motion.base_quaternion)
        nv = robot.model.nv
        if self.entry >= nv:
            return motion.qvel[:, self.entry - nv]
        if self.quantity == "joint_pos":
            return motion.qpos[:, robot.joint_qpos[np.flatnonzero(robot.joint_dofs == self.entry)[0]]]
        assert self.quantity == "base_pos", f"{self.name} has no single value"
        return motion.base_position[:, self.entry]


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
            found += [
                Channel(name, quantity, unit, entry + axis, HEADLINE.get(name)) for axis, name in enumerate(names)
            ]
    for quantity, first in (("joint_pos", 0), ("joint_vel", nv)):
        unit, scale = QUANTITIES[quantity].unit, JOINT_SCALES[quantity]
        found += [
            Channel(f"{quantity}/{joint}", quantity, unit, first + int(dof), scale)
            for joint, dof in zip(robot.joints, robot.joint_dofs, strict=True)
        ]
    return tuple(found)


def logged_channels(logs: Sequence[Log], robot: Robot) -> tuple[Channel, ...]:
    """Channels of the state that every log has."""
    return tuple(c for c in state_channels(robot) if all(is_logged(log, c.name) for log in logs))


def scaled_channels(logs: Sequence[Log], robot: Robot) -> tuple[Channel, ...]:
    """Logged channels with a scale: headline channels of the base, then joint positions and velocities."""
    return tuple(c for c in logged_channels(logs, robot) if c.scale is not None)


def is_logged(log: Log, channel: str) -> bool:
    """Whether a log has the column of a channel."""
    return (BASE_QUATERNION[0] if channel in BASE_TURNS else channel) in log


def channel_values(motion: Motion, channels: Sequence[Channel], robot: Robot) -> np.ndarray:
    """Values of channels in a motion, (rows, channels)."""
    return np.stack([channel.values(motion, robot) for channel in channels], axis=1)


def logged_values(log: Log, channel: str) -> np.ndarray:
    """Logged values of one channel, by its name, (rows,)."""
    return log.pitch if channel == "base_pitch" else log[channel]


def measured_values(log: Log, channels: Sequence[Channel]) -> np.ndarray:
    """Logged values of channels, (rows, channels)."""
    return np.stack([logged_values(log, channel.name) for channel in channels], axis=1)


def sensor_noise(log: Log, channels: Sequence[Channel]) -> np.ndarray:
    """Standard deviation of each channel's sensor noise, (channels,)."""
    return noise_of(np.diff(measured_values(log, channels), axis=0), log.info.sample_period_s)
