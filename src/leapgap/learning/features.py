"""What models of the base may look at: named inputs, computed alike for NumPy and torch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.recording.windows import Windows


@dataclass(frozen=True)
class Situation:
    """n moments at which a model is asked; NumPy arrays or torch tensors, any leading shape in place of n."""

    state: Any
    """x z pitch and rates, m, rad, s, world, (n, 6)."""
    foot: Any
    """Foot − base, front x z, rear x z, m, world axes, (n, 4)."""
    time_s: Any
    """Since the start of the jump, (n,)."""
    start: Any
    """State at the beginning of the prediction, (n, 6): networks that saw positions see them relative to it."""

    def at(self, which: Any) -> "Situation":
        """Some of the moments, by mask or slice of the first axis."""
        return Situation(self.state[which], self.foot[which], self.time_s[which], self.start[which])


FEATURES: dict[str, Callable[[Situation], Any]] = {
    "x_from_start": lambda s: s.state[..., 0] - s.start[..., 0],
    "z_from_start": lambda s: s.state[..., 1] - s.start[..., 1],
    "z": lambda s: s.state[..., 1],
    "pitch": lambda s: s.state[..., 2],
    "vx": lambda s: s.state[..., 3],
    "vz": lambda s: s.state[..., 4],
    "pitch_rate": lambda s: s.state[..., 5],
    "front_foot_x": lambda s: s.foot[..., 0],
    "front_foot_z": lambda s: s.foot[..., 1],
    "rear_foot_x": lambda s: s.foot[..., 2],
    "rear_foot_z": lambda s: s.foot[..., 3],
    "phase": lambda s: s.time_s,
}
"""Inputs by name; ``phase`` ties a model to one schedule."""


def columns(names: Sequence[str], situation: Situation) -> list[Any]:
    """The named inputs, each of the leading shape; stack them along a last axis."""
    return [FEATURES[name](situation) for name in names]


def check_names(names: Sequence[str], where: str) -> None:
    """Refuse inputs nobody knows."""
    unknown = [name for name in names if name not in FEATURES]
    if unknown or not names:
        raise InputError(
            where,
            f"inputs {', '.join(unknown) or 'none'}",
            f"some of {', '.join(FEATURES)}",
            "correct them in conf/train",
        )


@dataclass(frozen=True)
class Transitions:
    """n single measured steps, each once however many windows share it."""

    situation: Situation
    force: np.ndarray
    """(n, 4), N."""
    contact: np.ndarray
    """(n,), bool."""
    step_s: np.ndarray
    """(n,)."""
    step: np.ndarray
    """Number of the step in its jump, (n,)."""
    increment: np.ndarray
    """Next state minus state, (n, 6)."""

    @property
    def acceleration(self) -> np.ndarray:
        """(vx, vz, pitch rate) gained per second of the step, (n, 3)."""
        return self.increment[:, 3:] / self.step_s[:, None]

    def at(self, which: np.ndarray) -> "Transitions":
        """Some of them, by mask."""
        return Transitions(
            self.situation.at(which),
            self.force[which],
            self.contact[which],
            self.step_s[which],
            self.step[which],
            self.increment[which],
        )


def transitions(windows: Windows) -> Transitions:
    """The steps of some windows: the first of each window, and all of a jump's last window."""
    inputs = windows.inputs
    last = np.array([windows.start[windows.jump == j].max() for j in windows.jump], dtype=int)
    w, k = np.nonzero((np.arange(windows.grid.steps) == 0) | (windows.start == last)[:, None])
    state = windows.state[w, k]
    return Transitions(
        Situation(state, inputs.foot[w, k], inputs.time_s[w, k], windows.state[w, 0]),
        inputs.force[w, k],
        inputs.contact[w, k],
        inputs.step_s[w, k],
        windows.start[w] + k,
        windows.state[w, k + 1] - state,
    )
