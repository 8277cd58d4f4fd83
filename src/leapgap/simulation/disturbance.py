"""External actions on a robot's base that its controller does not expect: a sudden change of velocity, or a push."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE


@dataclass(frozen=True)
class Disturbance:
    """One action on the base of a robot that faces along the world's x axis."""

    begin_s: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Sudden change of forward velocity and of upward velocity, m/s, and of pitch rate, rad/s, at ``begin_s``."""
    force_n: tuple[float, float] = (0.0, 0.0)
    """Constant forward and upward force on the base's centre of mass from ``begin_s`` on, N."""
    duration_s: float = 0.0
    """How long the force lasts."""

    def __str__(self) -> str:
        """Its parts that are not zero, with units, and when: ``+0.2 m/s at 0.3 s``, ``-45 N from 0.3 to 0.4 s``."""
        names = ("m/s", "m/s upward", "rad/s")
        kicks = [f"{value:+g} {name}" for value, name in zip(self.velocity, names, strict=True) if value]
        pushes = [f"{value:+g} {name}" for value, name in zip(self.force_n, ("N", "N upward"), strict=True) if value]
        said = [f"{', '.join(kicks)} at {self.begin_s:g} s"] if kicks else []
        said += [f"{', '.join(pushes)} from {self.begin_s:g} to {self.begin_s + self.duration_s:g} s"] if pushes else []
        return ", ".join(said)


def disturb(
    model: mujoco.MjModel, data: mujoco.MjData, base: int, actions: Sequence[Disturbance], time_s: float
) -> None:
    """Apply to a free base what acts from ``time_s`` until the next step of the simulation."""
    half = model.opt.timestep / 2
    force = np.zeros(3)
    for action in actions:
        if abs(time_s - action.begin_s) < half:
            forward, up, pitch_rate = action.velocity
            data.qvel[[0, 2]] += forward, up
            data.qvel[ANGULAR_VELOCITY_SLICE][1] += pitch_rate
        if -half <= time_s - action.begin_s < action.duration_s - half:
            force[[0, 2]] += action.force_n
    data.xfrc_applied[base, :3] = force
