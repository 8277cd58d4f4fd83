"""What is compared between a log and its replay: named channels, their scale and their noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.recording.jump import Jump
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Motion


@dataclass(frozen=True)
class Channel:
    """One compared quantity and its unit."""

    name: str
    unit: str
    scale: float
    """The difference that counts as one in the headline gap."""


HEADLINE = {
    "base_pos_x": 0.05,
    "base_pos_z": 0.05,
    "base_pitch": 0.1,
    "base_linvel_x": 0.2,
    "base_linvel_z": 0.3,
    "base_angvel_y": 0.6,
}
"""Channels of the headline gap and the difference that counts as one: m, m, rad, m/s, m/s, rad/s."""

BASE_UNITS = dict(zip(HEADLINE, ("m", "m", "rad", "m/s", "m/s", "rad/s"), strict=True))


def pitch_of(quaternion: np.ndarray) -> np.ndarray:
    """Pitch, rad, positive nose-down, of quaternions w x y z (…, 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))


def measured(jump: Jump, channel: str) -> np.ndarray:
    """A channel as logged, (rows,)."""
    return jump.pitch if channel == "base_pitch" else jump[channel]


def simulated(motion: Motion, channel: str, robot: Robot) -> np.ndarray:
    """The same channel of a replay, (rows,)."""
    quantity, _, joint = channel.partition("/")
    if joint:
        at = robot.joints.index(joint)
        if quantity == "joint_pos":
            return motion.qpos[:, robot.joint_qpos[at]]
        return motion.qvel[:, robot.joint_dofs[at]]
    if channel == "base_pitch":
        return pitch_of(motion.qpos[:, 3:7])
    axis = "xyz".index(channel[-1])
    if channel.startswith("base_pos"):
        return motion.qpos[:, axis]
    return motion.qvel[:, axis + (3 if channel.startswith("base_angvel") else 0)]


JOINT_SCALES = {"joint_pos": (0.1, "rad"), "joint_vel": (1.0, "rad/s")}
"""Headline scales of a robot whose base is fixed: all that moves are its joints."""


def available(jumps: Sequence[Jump], robot: Robot) -> tuple[Channel, ...]:
    """Channels that every log has: the base's headline channels, then joint positions and velocities."""
    wanted = [Channel(name, unit, HEADLINE[name]) for name, unit in BASE_UNITS.items()] if robot.has_free_base else []
    for quantity, (scale, unit) in JOINT_SCALES.items():
        wanted += [Channel(f"{quantity}/{joint}", unit, scale) for joint in robot.joints]
    return tuple(c for c in wanted if all(is_logged(jump, c.name) for jump in jumps))


def is_logged(jump: Jump, channel: str) -> bool:
    """Whether a log has what a channel needs."""
    return ("base_quat_w" if channel == "base_pitch" else channel) in jump


def noise(jump: Jump, channel: str) -> float:
    """Standard deviation of a channel's sensor noise, from its high-frequency part alone.

    Second differences of a smooth motion at 1 kHz are tiny against those of white noise, which have variance 6 σ²;
    the median absolute value keeps impacts out.
    """
    second = np.diff(measured(jump, channel), n=2)
    return float(np.median(np.abs(second)) / 0.6745 / np.sqrt(6))
