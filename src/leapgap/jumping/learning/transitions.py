"""The measured steps that models of the base are fitted to."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.learning.windows import Windows
from leapgap.jumping.models.affine_model import Situation


@dataclass(frozen=True)
class Transitions:
    """n single measured steps, each once however many windows share it."""

    situation: Situation
    force: np.ndarray
    """Ground forces on the robot, as in ``RolloutInputs``, (n, 4), N."""
    contact: np.ndarray
    """Whether each step begins before take-off, bool, (n,)."""
    step_s: np.ndarray
    """Length of each step, (n,)."""
    step: np.ndarray
    """Number of the step in its jump, (n,)."""
    jump: np.ndarray
    """Number of the jump among those of the windows, (n,)."""
    increment: np.ndarray
    """Next state minus state, (n, 6)."""

    @property
    def acceleration(self) -> np.ndarray:
        """(vx, vz, pitch rate) gained per second of the step, (n, 3)."""
        return self.increment[:, 3:] / self.step_s[:, None]

    def at(self, which: np.ndarray) -> "Transitions":
        """Some of them, by mask or by index."""
        return Transitions(
            self.situation.at(which),
            self.force[which],
            self.contact[which],
            self.step_s[which],
            self.step[which],
            self.jump[which],
            self.increment[which],
        )


def steps_of(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Every step of the jumps once, as the numbers of a window and of a step in it, int, (n,) each."""
    last = np.zeros(len(windows.jumps), dtype=int)
    np.maximum.at(last, windows.jump, windows.start)
    w, k = np.nonzero((np.arange(windows.grid.steps) == 0) | (windows.start == last[windows.jump])[:, None])
    return w, k


def extract_transitions(windows: Windows) -> Transitions:
    """The steps of some windows: the first of each window, and all of a jump's last window."""
    inputs = windows.inputs
    w, k = steps_of(windows)
    state = windows.state[w, k]
    return Transitions(
        Situation(state, inputs.foot[w, k], inputs.time_s[w, k], windows.state[w, 0]),
        inputs.force[w, k],
        inputs.contact[w, k],
        inputs.step_s[w, k],
        windows.start[w] + k,
        windows.jump[w],
        windows.state[w, k + 1] - state,
    )
