"""The optimal jump as a nonlinear programme: variables, cost, constraints, bounds.

The formulation of the published references (Nguyen et al., RA-L 2025), reproduced to print precision:
their cost, their limits, and their discretisation

    M(q_k) (v_{k+1} − v_k) / dt + C(q_k, v_k) + D v_k = S τ_k − Jᵀ F_k,    q_{k+1} = q_k + dt v_{k+1}

with F the force of the feet on the ground. N steps lead from knot 0 to knot N; the jump is one step longer
than that: knot k belongs to time (k + 1) dt, the robot standing still for the first step. With it, forces end
and the landing falls where the contact schedule says.

The programme is one per robot, limits and schedule; a target only sets bounds, so one programme serves all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.dynamics import (
    COORDINATES,
    CROUCH,
    JOINT,
    JOINTS,
    PITCH,
    TRUNK,
    X,
    Z,
    inverse_dynamics_residual,
    legs,
)
from leapgap.jumping.planning.problem import (
    Grid,
    Limits,
    Problem,
    Trajectory,
    Weights,
    start_feet,
    start_legs,
    start_rise,
)
from leapgap.logs.pair_force import OF_PAIR
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PAIRS

Bounds = tuple[np.ndarray, np.ndarray]  # Lower and upper bounds, equal shapes

INFINITY = float("inf")
SWING_RISE_M = 0.004  # Least rise of a swinging foot in each step, m; 0.4 m/s for steps of 0.01 s
EDGE_MARGIN_M, ROUNDED_M = 0.02, 0.02
"""Least distance of feet from a box's face, m, and width over which the maximum of two distances is smoothed, m."""
AMPLE = 1e3  # Bound, N·m and rad/s, that is larger than any jump needs


@dataclass(frozen=True)
class Label:
    """Meaning of a constraint row or of a variable: its group, its knot, and a name."""

    group: str
    knot: int
    what: str


@dataclass(frozen=True)
class Group:
    """Unit of a group of constraints, and the violation that would matter, by which groups are compared."""

    unit: str
    matters: float


GROUPS = {
    "dynamics": Group("N or N·m", 5.0),
    "integration": Group("m or rad", 0.01),
    "standing foot": Group("m", 0.01),
    "clearance": Group("m", 0.01),
    "friction cone": Group("N", 5.0),
    "torque-speed limit": Group("rad/s", 1.0),
    "position bounds": Group("m or rad", 0.01),
    "joint speed": Group("rad/s", 1.0),
    "start and landing speed": Group("m/s or rad/s", 0.1),
    "torque bounds": Group("N·m", 3.0),
    "force bounds": Group("N", 5.0),
}
MOTOR_GROUPS = ("torque-speed limit", "torque bounds", "joint speed")


class JumpNlp:
    """The programme of a robot, its limits and a schedule: min f(w), lower ≤ g(w) ≤ upper, bounds on w.

    ``w`` holds, knot by knot, q, v, the torques, and the forces of the pairs that push. Rows of ``g`` and
    entries of ``w`` have labels, so that messages can name a violated one.
    """

    def __init__(
        self, grid: Grid, robot: PlanarRobot, weights: Weights, limits: Limits, boxes: Sequence[Box] = ()
    ) -> None:
        self.grid, self.robot, self.weights, self.limits = grid, robot, weights, limits
        self._variables: list[ca.SX] = []
        self.variable_labels: list[Label] = []
        self._g: list[ca.SX] = []
        self.row_labels: list[Label] = []
        self._lower_g: list[float] = []
        self._upper_g: list[float] = []
        self._anchored: list[tuple[int, int, int]] = []
        self._make_variables()
        self.cost = self._cost()
        self._dynamics()
        self._stance()
        self._swing()
        self._friction()
        self._motors()
        for box in boxes:  # last: other rows keep their places
            self._clear_of(box)
        self.w = ca.vertcat(*self._variables)
        self.g = ca.vertcat(*self._g)

    # Variables and their bounds ---------------------------------------------------------------------------

    def _make_variables(self) -> None:
        self.q, self.v, self.torque, self.force = [], [], [], []
        for k in range(self.grid.steps + 1):
            self.q.append(self._variable(k, "position bounds", (*TRUNK, *JOINTS)))
            held = k == 0 or self._lands_soon(k)
            group = "start and landing speed" if held else "joint speed"
            self.v.append(self._variable(k, group, (*TRUNK, *JOINTS)))
            if k < self.grid.steps:
                self.torque.append(self._variable(k, "torque bounds", JOINTS))
                pairs = [
                    self._variable(k, "force bounds", [PAIR_FORCE_AXES[entry] for entry in OF_PAIR[pair]])
                    if self.grid.can_push(pair, k)
                    else ca.SX.zeros(2)
                    for pair in (0, 1)
                ]
                self.force.append(ca.vertcat(*pairs))

    def _variable(self, knot: int, group: str, names: Sequence[str]) -> ca.SX:
        symbol = ca.SX.sym(f"{group}_{knot}", len(names))
        self._variables.append(symbol)
        self.variable_labels += [Label(group, knot, name) for name in names]
        return symbol

    # Cost and constraints ---------------------------------------------------------------------------------

    def _cost(self) -> ca.SX:
        crouch, weights = ca.DM(CROUCH), self.weights
        cost = weights.landing_pose * ca.sumsqr(self.q[-1][JOINT] - crouch)
        for q, torque in zip(self.q, self.torque, strict=False):
            cost += weights.pose * ca.sumsqr(q[JOINT] - crouch) + weights.torque * ca.sumsqr(torque)
        return cost

    def _constrain(self, rows: Any, lower: float, upper: float, label: Label) -> None:
        rows = ca.vertcat(rows)
        size = rows.numel()
        self._g.append(rows)
        self.row_labels += [label] * size
        self._lower_g += [lower] * size
        self._upper_g += [upper] * size

    def _anchor(self, row: Any, pair: int, axis: int, label: Label, lower: float = 0.0, upper: float = 0.0) -> None:
        """Bound a coordinate relative to the pair's feet at the start, which depend on the problem's stance."""
        self._anchored.append((len(self._lower_g), pair, axis))
        self._constrain(row, lower, upper, label)

    def g_bounds(self, problem: "Problem") -> Bounds:
        """Bounds on the rows of ``g`` for a problem's stance."""
        feet = [(float(leg.anchor.x), float(leg.anchor.z)) for leg in start_legs(self.robot, problem.stance_pitch_rad)]
        shift = np.zeros(len(self._lower_g))
        rows = np.array([row for row, _, _ in self._anchored])
        shift[rows] = [feet[pair][axis] for _, pair, axis in self._anchored]
        return np.array(self._lower_g) + shift, np.array(self._upper_g) + shift

    def _dynamics(self) -> None:
        dt = self.grid.step_s
        q, v, a = (ca.SX.sym(name, COORDINATES) for name in "qva")
        torque, force = ca.SX.sym("torque", 4), ca.SX.sym("force", 4)
        residual = ca.Function(
            "residual",
            [q, v, a, torque, force],
            [ca.vertcat(*inverse_dynamics_residual(self.robot, q, v, a, torque, force))],
        )
        for k in range(self.grid.steps):
            acceleration = (self.v[k + 1] - self.v[k]) / dt
            balance = residual(self.q[k], self.v[k], acceleration, self.torque[k], self.force[k])
            self._constrain(balance, 0, 0, Label("dynamics", k, "balance of forces and moments"))
            step = self.q[k + 1] - self.q[k] - dt * self.v[k + 1]
            self._constrain(step, 0, 0, Label("integration", k, "positions against velocities"))

    def _stance(self) -> None:
        for k in range(self.grid.rear_stance_knots):
            for pair, leg in enumerate(legs(self.robot, self.q[k])):
                if k >= self.grid.stance_knots(pair):
                    continue
                name = PAIRS[pair]
                if k > 0:  # the start is given
                    stands = Label("standing foot", k, f"{name} feet")
                    self._anchor(leg.anchor.x, pair, 0, stands)
                    self._anchor(leg.anchor.z, pair, 1, stands)
                for what, joint, height in (
                    ("knees", leg.knee, self.limits.knee_clearance_m),
                    ("hips", leg.hip, self.limits.hip_clearance_m),
                ):
                    label = Label("clearance", k, f"{name} {what}")
                    self._anchor(joint.z, pair, 1, label, height, INFINITY)

    def _swing(self) -> None:
        """Keep the swinging front feet above the floor."""
        clearance = self.limits.swing_clearance_m
        if clearance is None:
            return
        first = self.grid.front_stance_knots
        for k in range(first, self.grid.rear_stance_knots):
            front, _ = legs(self.robot, self.q[k])
            least = min(clearance, SWING_RISE_M * (k - first))
            self._anchor(front.anchor.z, 0, 1, Label("clearance", k, "front feet"), least, INFINITY)

    def _clear_of(self, box: Box) -> None:
        """Keep feet in the air above a box or in front of its near edge, until they land on it."""
        forward = 1.0 if box.x_m >= 0 else -1.0
        edge = abs(box.x_m) - box.size_m[0] / 2 - self.robot.foot_radius - EDGE_MARGIN_M
        floor = start_feet(self.robot)[0][1]
        for k in range(self.grid.front_stance_knots, self.grid.steps - self.limits.crouch_before_landing_knots):
            for pair, leg in enumerate(legs(self.robot, self.q[k])):
                if k >= self.grid.stance_knots(pair):
                    before, above = edge - forward * leg.foot.x, leg.foot.z - floor - box.top_m
                    larger = (before + above + ca.sqrt((before - above) ** 2 + ROUNDED_M**2)) / 2
                    self._constrain(larger, 0, INFINITY, Label("clearance", k, f"{PAIRS[pair]} feet at the box"))

    def _friction(self) -> None:
        mu = self.limits.friction
        for k in range(self.grid.steps):
            for pair in (0, 1):
                if self.grid.can_push(pair, k):
                    x, z = (self.force[k][entry] for entry in OF_PAIR[pair])
                    label = Label("friction cone", k, f"{PAIRS[pair]} feet")
                    self._constrain(x + mu * z, -INFINITY, 0, label)
                    self._constrain(-x + mu * z, -INFINITY, 0, label)

    def _motors(self) -> None:
        fastest = self.robot.no_load_speed
        for k in range(self.grid.steps):
            for j, joint in enumerate(JOINTS):
                # Of one motor: half the pair's torque.
                load = self.robot.speed_per_torque * self.torque[k][j] / 2 + self.v[k][JOINT][j]
                self._constrain(load, -fastest, fastest, Label("torque-speed limit", k, joint))

    # Bounds and the first guess ---------------------------------------------------------------------------

    def w_bounds(self, problem: "Problem") -> Bounds:
        """Bounds on ``w`` for a problem's stance and target."""
        lower, upper = [], []
        for k in range(self.grid.steps + 1):
            motion = [self._position_bounds(k, problem), self._velocity_bounds(k)]
            for low, high in motion + self._effort_bounds(k):
                lower.append(low)
                upper.append(high)
        return np.concatenate(lower), np.concatenate(upper)

    def _position_bounds(self, knot: int, problem: "Problem") -> Bounds:
        lower, upper = np.full(COORDINATES, -INFINITY), np.full(COORDINATES, INFINITY)
        (thigh_min, thigh_max), (calf_min, calf_max) = self.robot.thigh_range, self.robot.calf_range
        lower[JOINT] = np.tile([thigh_min, calf_min], 2)
        upper[JOINT] = np.tile([thigh_max, calf_max], 2)
        if knot == 0 or self._lands_soon(knot):
            lower[JOINT] = upper[JOINT] = CROUCH
        if knot == 0:
            lower[[X, Z, PITCH]] = upper[[X, Z, PITCH]] = 0, 0, problem.stance_pitch_rad
        if knot == self.grid.steps:
            lower[[X, Z, PITCH]] = upper[[X, Z, PITCH]] = (
                problem.target.x_m + problem.aim.x_m,
                problem.target.z_m + problem.aim.z_m - start_rise(self.robot, problem.stance_pitch_rad),
                problem.aim.pitch_rad,
            )
        return lower, upper

    def _velocity_bounds(self, knot: int) -> Bounds:
        upper = np.full(COORDINATES, INFINITY)
        upper[JOINT] = 0 if self._lands_soon(knot) else self.limits.joint_speed_rad_s
        if knot == 0:
            upper[:] = 0
        return -upper, upper

    def _effort_bounds(self, knot: int) -> list[Bounds]:
        if knot == self.grid.steps:
            return []
        limits = self.limits
        if knot < self.grid.front_stance_knots:
            front = rear = limits.stance_torque_nm
        elif knot < self.grid.rear_stance_knots:
            front, rear = limits.swing_torque_nm, limits.stance_torque_nm
        else:
            front = rear = limits.flight_torque_nm
        torque = np.minimum([front, front, rear, rear], 2 * np.tile(self.robot.torque_limit, 2))
        bounds = [(-torque, torque)]
        for pair, least in enumerate((limits.least_front_force_n, limits.least_rear_force_n)):
            if self.grid.can_push(pair, knot):
                bounds.append((np.array([-INFINITY, -INFINITY]), np.array([INFINITY, -least])))
        return bounds

    def _lands_soon(self, knot: int) -> bool:
        return knot > self.grid.steps - self.limits.crouch_before_landing_knots

    def without_motor_limits(self, w_bounds: Bounds, g_bounds: Bounds) -> tuple[Bounds, Bounds]:
        """The given bounds on ``w`` and on ``g``, with the limits of the motors removed."""
        freed = []
        for (lower, upper), labels in ((w_bounds, self.variable_labels), (g_bounds, self.row_labels)):
            motor = np.array([label.group in MOTOR_GROUPS for label in labels])
            freed.append((np.where(motor, -AMPLE, lower), np.where(motor, AMPLE, upper)))
        return freed[0], freed[1]

    @cached_property
    def first_guess(self) -> np.ndarray:
        """Standing in the crouch with torques of 2 N·m, as published."""
        crouch = dict(zip(JOINTS, CROUCH, strict=True))
        by_group = {"position bounds": crouch, "torque bounds": dict.fromkeys(JOINTS, 2.0)}
        return np.array([by_group.get(at.group, {}).get(at.what, 0.0) for at in self.variable_labels])

    @cached_property
    def _evaluate(self) -> ca.Function:
        blocks = [ca.horzcat(*block).T for block in (self.q, self.v, self.torque, self.force)]
        return ca.Function("evaluate", [self.w], [self.cost, self.g, *blocks])

    def trajectory(self, w: np.ndarray) -> Trajectory:
        """The motion, torques and forces in ``w``."""
        _, _, *blocks = self._evaluate(w)
        return Trajectory(*(np.array(block) for block in blocks))

    def cost_of(self, w: np.ndarray) -> float:
        """The cost f(w) of the variables ``w``."""
        return float(self._evaluate(w)[0])

    def violations(self, w: np.ndarray, problem: "Problem") -> tuple[np.ndarray, list[Label]]:
        """Violation of each constraint row and each bound at ``w``, in its unit, and the labels in the same order."""
        g = np.array(self._evaluate(w)[1]).ravel()
        parts = [(g, *self.g_bounds(problem)), (w, *self.w_bounds(problem))]
        amounts = [np.maximum(0, np.maximum(lower - value, value - upper)) for value, lower, upper in parts]
        return np.concatenate(amounts), [*self.row_labels, *self.variable_labels]
