"""Errors of measurement and communication: a tilted IMU, lost commands."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Commands, parameter
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.validation.off_table.base import OffTableEffect

LOSSES_SEED = 20_240_229
BURST_S = 0.012
"""Length of a burst in which all commands are lost."""


@dataclass(frozen=True)
class TiltedImu(OffTableEffect):
    """An inertial unit mounted askew in pitch: orientation is reported nose-down by a constant."""

    name = "tilted_imu"
    needs_base = True

    tilt_rad: float = parameter(0.0, "rad", -0.3, 0.3)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Turn the reported orientation about the base's y axis."""
        return self._turned(motion, self.tilt_rad)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Turn the logged orientation back by the tilt: the true first state."""
        return self._turned(start, -self.tilt_rad)

    def _turned(self, motion: Motion, angle: float) -> Motion:
        turn = np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
        qpos: np.ndarray = motion.qpos.copy()
        for row in qpos:
            level = row[3:7].copy()
            mujoco.mju_mulQuat(row[3:7], level, turn)
        return replace(motion, qpos=qpos)


@dataclass(frozen=True)
class PacketLoss(OffTableEffect):
    """Bursts of lost commands: the joints keep the last command that arrived."""

    name = "packet_loss"

    share: float = parameter(0.0, "1", 0.0, 0.8)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Repeat the last command through each burst; the bursts are the same on every jump of equal length."""
        rows, burst = len(commands.torque), max(1, round(BURST_S / period_s))
        bursts = np.random.default_rng(LOSSES_SEED).random(-(-rows // burst)) < self.share
        lost = np.repeat(bursts, burst)[:rows]
        lost[:1] = False
        last_received = np.maximum.accumulate(np.where(lost, 0, np.arange(rows)))
        return commands.each(lambda sent: sent[last_received])
