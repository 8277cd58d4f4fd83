"""Held random forces on top of a controller's own, so that what is learned from its jumps can tell causes apart."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.reference import StartFrame
from leapgap.jumping.control.tracking import JumpController
from leapgap.logs.pair_force import FORCES, per_axis
from leapgap.simulation.controller import Command, StateEstimate


@dataclass(frozen=True)
class Excitation:
    """Largest force on each axis of each pair, and how long a drawn one is held."""

    force_n: float = 0.0
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        if self.force_n < 0 or self.hold_s <= 0:
            raise ValueError("force_n not below 0, hold_s above 0")


class Excited(JumpController):
    """Another controller of a jump, with drawn forces added to the pairs that push."""

    def __init__(self, inner: JumpController, excitation: Excitation, rng: np.random.Generator) -> None:
        self.inner, self.excitation = inner, excitation
        self.reference, self.robot, self.targets = inner.reference, inner.robot, inner.targets
        self.level_m, self.legs = inner.level_m, inner.legs
        self.fallbacks, self.substituted = inner.fallbacks, inner.substituted
        held = int(np.ceil(inner.reference.schedule.take_off_s / excitation.hold_s))
        self.force = rng.uniform(-excitation.force_n, excitation.force_n, (held, FORCES))
        """Of each stretch of time, front x z, rear x z, N, (stretches, 4)."""
        self.start_s = None
        self.frame = None

    def command(self, estimate: StateEstimate) -> Command:
        """The other controller's command with this moment's force added."""
        command = self.inner.command(estimate)
        self.start_s, self.frame = self.inner.start_s, self.inner.frame
        torque, force = self.feed_forward(estimate.time_s - (self.start_s or 0.0), estimate, self.frame or NOWHERE)
        return replace(command, torque=command.torque + torque, planned_force=command.planned_force + force)

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques and forces of the excitation alone."""
        contact = self.reference.schedule.in_contact(np.array(time_s))
        if not contact.any() or not np.isfinite([*estimate.base_quaternion, *estimate.joint_pos]).all():
            return self.nothing()
        force = self.force[int(time_s / self.excitation.hold_s + 1e-6)] * per_axis(contact)
        return self.legs.torque(estimate.base_quaternion, estimate.joint_pos, frame.in_world(force)), force


NOWHERE = StartFrame(0.0, 0.0, 0.0)
