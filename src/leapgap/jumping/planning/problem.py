"""A jump to plan: target, contact schedule in steps, robot, weights and limits; and the trajectory of a plan."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.dynamics import CROUCH, Leg, legs
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.terrain import Box

LONGEST_JUMP_M = 5.0
HIGHEST_JUMP_M = 2.0


@dataclass(frozen=True)
class Weights:
    """Weights of the cost Σ_{k<N} (pose ‖q_j − crouch‖² + torque ‖τ‖²) + landing_pose ‖q_j(N) − crouch‖²."""

    pose: float = 1.0  # 1/rad²
    torque: float = 0.05  # 1/(N·m)², on the sum of a pair
    landing_pose: float = 100.0  # 1/rad²

    def __post_init__(self) -> None:
        if not (
            np.isfinite([self.pose, self.torque, self.landing_pose]).all()
            and self.torque > 0
            and self.pose >= 0
            and self.landing_pose >= 0
        ):
            raise ValueError(f"{self}: weights must be finite and not negative, that of torque positive")


@dataclass(frozen=True)
class Limits:
    """Limits of robot and ground, as published; forces and torques are sums over a pair of legs."""

    friction: float = 0.4
    least_front_force_n: float = 30.0
    least_rear_force_n: float = 50.0
    stance_torque_nm: float = float("inf")  # Infinite: what the robot's motors give, 67 N·m for the published robot
    swing_torque_nm: float = 20.0  # Torque limit of the front pair while the rear pair still pushes
    flight_torque_nm: float = 30.0
    joint_speed_rad_s: float = 21.0
    knee_clearance_m: float = 0.05  # Least height of a standing leg's knee above its foot
    hip_clearance_m: float = 0.07  # Least height of a standing leg's hip above its foot
    swing_clearance_m: float | None = None
    """Least height of the front feet over where they stood while only the rear ones push, reached by
    ``nlp.SWING_RISE_M`` a knot; feet in the air keep clear of boxes, too. None, as published: planned feet may then
    pass through the floor and through boxes, where those of a real robot would drag or trip."""
    crouch_before_landing_knots: int = 11  # Number of last knots at which the joints rest in the crouch, to touch down


@dataclass(frozen=True)
class Grid:
    """The contact schedule in steps of the optimiser."""

    schedule: ContactSchedule
    step_s: float = 0.01

    def __post_init__(self) -> None:
        if not self.step_s > 0:
            raise InputError("planner's step", f"{self.step_s:g} s", "a positive length", "use 0.01 s")
        for name in ("double_contact_s", "rear_contact_s", "flight_s"):
            length = getattr(self.schedule, name)
            whole = round(length / self.step_s) if np.isfinite(length) else 0
            if whole < 1 or abs(whole * self.step_s - length) > 1e-9:
                shorter = max(1, int(length / self.step_s) if whole else 1) * self.step_s
                expected = f"a whole number of {self.step_s:g} s steps, one or more"
                do = f"the nearest lengths are {shorter:g} s and {shorter + self.step_s:g} s"
                raise InputError(f"contact schedule, {name}", f"{length:g} s", expected, do)

    def _phase_steps(self, seconds: float) -> int:
        return round(seconds / self.step_s)

    @property
    def front_stance_knots(self) -> int:
        """Knots at which the front feet stand."""
        return self._phase_steps(self.schedule.double_contact_s)

    @property
    def rear_stance_knots(self) -> int:
        """Knots at which the rear feet stand."""
        return self._phase_steps(self.schedule.take_off_s)

    @property
    def steps(self) -> int:
        """N; there are N + 1 knots."""
        return self._phase_steps(self.schedule.landing_s) - 1

    @property
    def knot_times(self) -> np.ndarray:
        """Time of each knot, s, (N + 1,)."""
        return self.step_s * np.arange(1, self.steps + 2)

    def stance_knots(self, pair: int) -> int:
        """Knots at which the feet of pair 0 (front) or 1 (rear) stand: from 0 up to this one, exclusive."""
        return (self.front_stance_knots, self.rear_stance_knots)[pair]

    def can_push(self, pair: int, knot: int) -> bool:
        """Whether the pair pushes from this knot to the next: only where it also stands at the next."""
        return knot + 1 < self.stance_knots(pair)


@dataclass(frozen=True)
class Aim:
    """Offset of the goal from the target: a robot that lands short of its plans needs plans that go farther."""

    x_m: float = 0.0
    z_m: float = 0.0
    pitch_rad: float = 0.0  # Pitch of the trunk at the landing, nose-down; the published plans land level


@dataclass(frozen=True)
class Problem:
    """One jump to plan, with everything that its plan depends on."""

    target: Target
    grid: Grid = field(default_factory=lambda: Grid(ContactSchedule()))
    robot: PlanarRobot = field(default_factory=PlanarRobot)
    weights: Weights = field(default_factory=Weights)
    limits: Limits = field(default_factory=Limits)
    stance_pitch_rad: float = 0.0  # Pitch of the trunk in the crouch at the start; negative: front feet higher
    aim: Aim = field(default_factory=Aim)

    def __post_init__(self) -> None:
        x, z = self.target.x_m, self.target.z_m
        if not (np.isfinite([x, z]).all() and abs(x) <= LONGEST_JUMP_M and 0 <= z <= HIGHEST_JUMP_M):
            expected = f"x within ±{LONGEST_JUMP_M:g} m, z from 0 (the floor) to {HIGHEST_JUMP_M:g} m"
            do = "give targets in metres; the A1 is known to reach -0.3 to 0.8 m and boxes up to 0.2 m"
            raise InputError("jump target", f"x {x:g} m, z {z:g} m", expected, do)


@dataclass(frozen=True)
class Trajectory:
    """Motion and effort of a plan in the planner's coordinates (q as in ``jumping.planning.layout``), SI units."""

    q: np.ndarray  # (N + 1, 7)
    v: np.ndarray  # (N + 1, 7)
    torque: np.ndarray  # (N, 4), of the joint pairs
    force: np.ndarray  # (N, 4), of the feet of a pair on the ground: front x z, rear x z


def start_legs(robot: PlanarRobot, pitch_rad: float = 0.0) -> tuple[Leg, Leg]:
    """Front and rear leg in the crouch at a pitch, the trunk's centre at the origin."""
    return legs(robot, np.array([0, 0, pitch_rad, *CROUCH]))


def start_feet(robot: PlanarRobot, pitch_rad: float = 0.0) -> tuple[tuple[float, float], tuple[float, float]]:
    """Front and rear foot (x, z) against the trunk's centre in the crouch at a pitch, m."""
    front, rear = start_legs(robot, pitch_rad)
    return (float(front.foot.x), float(front.foot.z)), (float(rear.foot.x), float(rear.foot.z))


def start_rise(robot: PlanarRobot, pitch_rad: float) -> float:
    """Height of the trunk above its rear feet at a pitch − that of a level trunk, m."""
    return start_feet(robot)[1][1] - start_feet(robot, pitch_rad)[1][1]


BOX_MARGIN = 0.05  # m, least distance of a box from the feet that start in front of it: knees bend beyond them
BOX_EDGES = (1.2, 1.0)  # m, along x and y: room to land and stand


def terrain(robot: PlanarRobot, target: Target) -> tuple[Box, ...]:
    """The box a jump lands on, if it lands higher than it started.

    Its near edge lies midway between the feet that start in front of it and those that land on it; where
    these overlap (boxes nearer than about 0.46 m), just beyond the feet at the start.
    """
    if target.z_m == 0:
        return ()
    (front, _), (rear, _) = start_feet(robot)
    forward = 1.0 if target.x_m >= 0 else -1.0
    leading, trailing = (front, rear) if forward > 0 else (rear, front)
    last_at_start = forward * leading + robot.foot_radius
    first_at_landing = forward * (target.x_m + trailing) - robot.foot_radius
    near = max(last_at_start + BOX_MARGIN, (last_at_start + first_at_landing) / 2)
    size = (BOX_EDGES[0], BOX_EDGES[1], target.z_m)
    return (Box(x_m=forward * (near + BOX_EDGES[0] / 2), y_m=0.0, size_m=size, top_m=target.z_m),)
