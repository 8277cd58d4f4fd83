"""Settings of the search for forces from outside, and the thresholds that decide what is one."""

from dataclasses import dataclass


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
