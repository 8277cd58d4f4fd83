"""Joint PD gains by phase of a jump, and the pose the legs land in."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.reference import Reference
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS


@dataclass(frozen=True)
class JointGains:
    """Gains of the joint PD controller."""

    kp_nm_per_rad: float = 300.0
    kd_nms_per_rad: float = 3.0

    def __post_init__(self) -> None:
        if not all(0 <= gain < np.inf for gain in (self.kp_nm_per_rad, self.kd_nms_per_rad)):
            raise ValueError("gains finite and not below 0")


@dataclass(frozen=True)
class LandingPose:
    """Pose and gains of the legs from some time before the planned landing on; published: 0.1 s, 0.5 rad, 80/1."""

    before_landing_s: float = 0.0
    front_forward_rad: float = 0.0
    """Forward rotation of the front thighs."""
    front: JointGains = field(default_factory=JointGains)
    rear: JointGains = field(default_factory=JointGains)


@dataclass(frozen=True)
class PhaseGains:
    """Gains of a pair in stance, in swing (the other pair pushes), and in flight; as published 300/3 throughout."""

    stance: JointGains = field(default_factory=JointGains)
    swing: JointGains = field(default_factory=JointGains)
    flight: JointGains = field(default_factory=JointGains)
    landing: LandingPose = field(default_factory=LandingPose)


@dataclass(frozen=True)
class JointTargets:
    """Set points and gains of the joint PD at each row of a reference: (rows, joints) each, rad, rad/s, SI units."""

    position: np.ndarray
    velocity: np.ndarray
    kp: np.ndarray
    kd: np.ndarray

    @staticmethod
    def of(reference: Reference, gains: PhaseGains, robot: Robot) -> "JointTargets":
        """The reference's joints, with the gains of each phase and the pose for landing."""
        times = np.arange(len(reference.joint_pos)) * reference.period_s
        position, velocity = reference.joint_pos.copy(), reference.joint_vel.copy()
        kp, kd = np.empty_like(position), np.empty_like(position)
        contact = reference.schedule.in_contact(times)
        landing = times >= reference.schedule.landing_s - gains.landing.before_landing_s - 1e-6
        for pair, (name, of_landing) in enumerate(zip(PAIRS, (gains.landing.front, gains.landing.rear), strict=True)):
            joints = robot.joints_at(name)
            phases = [landing, contact[:, pair], contact.any(axis=1)]
            for values, part in ((kp, "kp_nm_per_rad"), (kd, "kd_nms_per_rad")):
                of_phase = [getattr(g, part) for g in (of_landing, gains.stance, gains.swing)]
                values[:, joints] = np.select(phases, of_phase, getattr(gains.flight, part))[:, None]
        forward = np.intersect1d(robot.joints_at("front"), robot.joints_at("thigh"))
        position[np.ix_(landing, forward)] -= gains.landing.front_forward_rad  # a positive thigh turns to the rear
        if gains.landing.before_landing_s > 0:
            velocity[landing] = 0.0
        return JointTargets(position, velocity, kp, kd)
