"""A force from outside that acted at some time on a joint or on the base of a robot, and what decides that one did."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class OutsideForceSettings:
    """Section ``diagnose.settings.outside`` of the configuration."""

    remove: bool = True
    """Whether samples with an external force are left out of everything that is fitted and judged."""
    least_size: float = 4.0
    """Smallest mean force of a moment, in standard deviations of what the model leaves over the same time."""
    least_share: float = 0.4
    """Smallest peak of a moment, as a share of the root mean square torque that the motions need at the joint."""
    near: float = 1.0
    """Largest distance between two states of the robot at which they count as the same moment of a motion.

    It is the length of the difference of positions, velocities and torques, each divided by its spread over all logs.
    """
    least_size_alone: float = 8.0
    """As ``least_size``, beside all other states that no other log was near to, for a moment in such a state."""
    longest_s: float = 1.0
    """A longer moment is an error of the model, not an external force."""
    least_part_s: float = 0.5
    """Shorter parts of a log between two forces are left out."""


EXTERNAL_PUSH = "external_push"
"""Name of forces from outside as a cause. No parameter of the robot stands for them, so that it is no effect."""


@dataclass(frozen=True)
class OutsideForce:
    """One force or moment from outside, as a log shows it."""

    log: str
    at: str  # Name of the joint, or of the body of the free base
    axis: str  # Of a base ``x``, ``y`` or ``z``: of the world for a force, of the base for a moment. Empty for a joint.
    time_s: float  # Its centre, by the time of the log
    begin_s: float
    end_s: float
    peak: float  # Signed, N for forces and joints that slide, N·m for moments and joints that turn
    impulse: float  # Signed, N·s or N·m·s
    impulse_ci95: tuple[float, float]
    unit: str  # Of the peak: ``N`` or ``N·m``
    size: float  # Mean force where it stands out most, in standard deviations of what the model leaves elsewhere

    @property
    def says(self) -> str:
        """``at 1.71 s in swing_2, elbow, +0.6 N·m for 0.2 s``.

        A base may get an upward force from its feet as well, on ground that is otherwise than in the model.
        """
        along = f" {'along' if self.unit == 'N' else 'about'} {self.axis}" if self.axis else ""
        peak, lasts_s = float(f"{self.peak:.2g}"), f"{self.end_s - self.begin_s:.2g}"
        ground = " (or the ground did)" if (self.axis, self.unit) == ("z", "N") else ""
        return f"at {self.time_s:.2f} s in {self.log}, {self.at}, {peak:+g} {self.unit}{along} for {lasts_s} s{ground}"

    @property
    def in_words(self) -> str:
        """What it says, with its impulse and the interval of that."""
        low, high = self.impulse_ci95
        return f"{self.says}, impulse {self.impulse:+.2g} {self.unit}·s ({low:.2g} to {high:.2g})"

    @property
    def explained(self) -> str:
        """What it is where the robot as corrected needs no such force."""
        when = f"{self.begin_s:.2f} to {self.end_s:.2f} s of {self.log}"
        return f"{when}, left out as a push, although the identified causes explain it"

    def to_json(self) -> dict[str, Any]:
        """Its entry of ``report.json``."""
        return {**asdict(self), "impulse_ci95": list(self.impulse_ci95), "says": self.says}
