"""Several jumps in a row: jump, land, settle, next jump, each from its own take-off pose."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.gains import JointGains
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.landing import LandingConfig, LandingMpc, limited, stand, standing_force
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import Command, Controller, StateEstimate

Phase = Literal["jump", "landing", "settling"]


@dataclass(frozen=True)
class SequenceConfig:
    """Times at which a phase ends and the next one begins."""

    landing: LandingConfig = field(default_factory=LandingConfig)
    earliest_touch_s: float = 0.05
    """Time after the planned take-off; feet that touch earlier have not left the ground yet."""
    latest_touch_s: float = 0.3
    """Time after the planned landing; where not both pairs are on the ground by then, the legs settle at once."""
    confirm_s: float = 0.003
    """Both pairs must touch for this long before the landing begins."""
    settle_s: float = 0.6
    """Time from the end of the landing to the next jump, in which the legs move to its first pose and stand."""
    settle_gains: JointGains = field(default_factory=lambda: JointGains(100.0, 3.0))

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        times = (self.earliest_touch_s, self.latest_touch_s, self.confirm_s)
        if not (all(0 <= one < np.inf for one in times) and 0 < self.settle_s < np.inf):
            raise ValueError("earliest_touch_s, latest_touch_s, confirm_s finite and not below 0, settle_s above 0")


class JumpSequence(Controller):
    """Makes the given jumps in their order and lands after each; stands after the last.

    The touch-down of both pairs ends a flight, early or late. ``phase`` holds the present phase, and ``fallbacks`` the
    count of fallback commands of all parts by reason.
    """

    def __init__(self, jumps: Sequence[JumpController], robot: Robot, config: SequenceConfig, body: RigidBody) -> None:
        """``body``: rigid body that the landing controller assumes."""
        if not jumps:
            raise InputError("continuous jumps", "no jump", "one or more", "name their references")
        self.jumps, self.robot, self.config, self.body = list(jumps), robot, config, body
        self.legs = LegKinematics(robot)
        self.border = Border(robot)
        self._own_fallbacks: Counter[str] = Counter()
        self.phase: Phase = "jump"
        self.number = 0
        self.landings_s: list[float] = []
        self.landing: LandingMpc | None = None
        self._fallbacks_before: Counter[str] = Counter()
        self._phase_since_s = 0.0
        self._both_since_s = np.inf
        self._settle_from = jumps[0].reference.joint_pos[0]
        self._feet = [robot.feet_at(pair) for pair in PAIRS]

    @property
    def fallbacks(self) -> Counter[str]:
        """Count of fallback commands by reason, of all jumps and landings so far."""
        of_jumps = sum((jump.fallbacks for jump in self.jumps), Counter[str]())
        return (
            of_jumps
            + self._own_fallbacks
            + self._fallbacks_before
            + (self.landing.fallbacks if self.landing else Counter())
        )

    def command(self, estimate: StateEstimate) -> Command:
        """See ``Controller``: the command of the present phase, a safe one where a tick has no usable time."""
        judged = self.border.judged(estimate)
        if judged is None:
            self._own_fallbacks[TIME_NOT_USABLE] += 1
            return self.border.safe_command()
        return self.border.sent(self._of_phase(judged))

    def _of_phase(self, estimate: StateEstimate) -> Command:
        """The command of the present phase for a judged estimate."""
        self._notice_touch(estimate)
        self._switch(estimate)
        if self.phase == "jump":
            return self.jumps[self.number].command(estimate)
        if self.phase == "landing" and self.landing is not None:
            return self.landing.command(estimate)
        return self._settle(estimate)

    def _notice_touch(self, estimate: StateEstimate) -> None:
        if not all(estimate.foot_contact[feet].any() for feet in self._feet):
            self._both_since_s = np.inf
        elif self._both_since_s == np.inf:
            self._both_since_s = estimate.time_s

    def _switch(self, estimate: StateEstimate) -> None:
        """Enter the next phase when the present one is over."""
        now, config = estimate.time_s, self.config
        lasted = now - self._phase_since_s + ROUNDING_S
        jump = self.jumps[self.number]
        if self.phase == "jump" and jump.start_s is not None:
            # A jump may stand first, to measure its stance and to become still.
            lasted, schedule = now - jump.start_s + ROUNDING_S, jump.reference.schedule
            may_touch = lasted >= schedule.take_off_s + config.earliest_touch_s
            if may_touch and now - self._both_since_s + ROUNDING_S >= config.confirm_s:
                self._land(now)
            elif lasted >= schedule.landing_s + config.latest_touch_s:
                self._enter("settling", estimate)
        elif self.phase == "landing" and lasted >= config.landing.duration_s:
            self._enter("settling", estimate)
        elif self.phase == "settling" and lasted >= config.settle_s and self.number + 1 < len(self.jumps):
            self.number += 1
            self._enter("jump", estimate)

    def _land(self, now_s: float) -> None:
        if self.landing is not None:
            self._fallbacks_before += self.landing.fallbacks
        self.landing = LandingMpc(self.robot, self._next_pose(), self.config.landing, self.body)
        self.landings_s.append(now_s)
        self.phase, self._phase_since_s = "landing", now_s

    def _enter(self, phase: Phase, estimate: StateEstimate) -> None:
        self.phase, self._phase_since_s = phase, estimate.time_s
        measured = estimate.joint_pos
        self._settle_from = measured.copy() if np.isfinite(measured).all() else self._next_pose()

    def _next_pose(self) -> np.ndarray:
        """Joint angles to stand in: first pose of the next jump, or last pose of the last one, (joints,), rad."""
        if self.number + 1 < len(self.jumps):
            return self.jumps[self.number + 1].reference.joint_pos[0]
        return self.jumps[self.number].reference.joint_pos[-1]

    def _settle(self, estimate: StateEstimate) -> Command:
        """Move the joints to the next pose in half of the time, then stand; feet in contact carry the weight."""
        part = np.clip(2 * (estimate.time_s - self._phase_since_s) / self.config.settle_s, 0.0, 1.0)
        smooth = part * part * (3 - 2 * part)
        pose = self._settle_from + smooth * (self._next_pose() - self._settle_from)
        force = standing_force(self.body) * np.isfinite(self._both_since_s)
        frame = StartFrame.of(estimate)
        command = stand(self.robot, self.legs, estimate, frame, force, pose, self.config.settle_gains)
        return limited(command, self.border)
