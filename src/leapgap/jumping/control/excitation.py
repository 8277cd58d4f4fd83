"""Piecewise constant random forces on top of a controller's own, to excite the dynamics for learning."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.control.tracking import JumpController
from leapgap.logs.pair_force import FORCES, per_axis
from leapgap.simulation.controller import Command, StateEstimate


@dataclass(frozen=True)
class Excitation:
    """Largest random force on each axis of each pair, N, and how long each draw is held, s."""

    force_n: float = 0.0
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        if not (0 <= self.force_n < np.inf and 0 < self.hold_s < np.inf):
            raise ValueError("force_n finite and not below 0, hold_s finite and above 0")


class ExcitedController(JumpController):
    """Adds random forces to those of another jump controller, for the pairs that push."""

    def __init__(self, inner: JumpController, excitation: Excitation, rng: np.random.Generator) -> None:
        self.inner, self.excitation = inner, excitation
        self.reference, self.robot, self.targets = inner.reference, inner.robot, inner.targets
        self.level_m, self.legs, self.border = inner.level_m, inner.legs, inner.border
        self.fallbacks, self.substituted = inner.fallbacks, inner.substituted
        held = int(np.ceil(inner.reference.schedule.take_off_s / excitation.hold_s))
        self.force = rng.uniform(-excitation.force_n, excitation.force_n, (held, FORCES))
        """Random force of each interval of ``hold_s``: front x z, rear x z, N, (intervals, 4)."""
        self.start_s = None
        self.frame = None

    def command(self, estimate: StateEstimate) -> Command:
        """The other controller's command with the random force of this moment added."""
        command = self.inner.command(estimate)
        self.start_s, self.frame = self.inner.start_s, self.inner.frame
        judged = self.border.newest
        if judged is None:
            return command
        torque, force = self.feed_forward(judged.time_s - (self.start_s or 0.0), judged, self.frame or ORIGIN_FRAME)
        torque, force = self.border.within_limits(command.torque + torque, command.planned_force + force)
        return self.border.sent(replace(command, torque=torque, planned_force=force))

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques and forces of the excitation alone."""
        contact = self.reference.schedule.in_contact(np.array(time_s))
        if not contact.any() or not np.isfinite([*estimate.base_quaternion, *estimate.joint_pos]).all():
            return self.zero_feed_forward()
        force = self.force[max(0, int(time_s / self.excitation.hold_s + 1e-6))] * per_axis(contact)
        return self.legs.torque(estimate.base_quaternion, estimate.joint_pos, frame.in_world(force)), force


ORIGIN_FRAME = StartFrame(0.0, 0.0, 0.0)
