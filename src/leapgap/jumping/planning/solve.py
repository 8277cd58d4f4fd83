"""Plan jumps with IPOPT: from a problem to a solution that holds its own constraint violations."""

import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.nlp import GROUPS, Bounds, JumpNlp, Label
from leapgap.jumping.planning.problem import Aim, Grid, Limits, Problem, Trajectory, Weights, terrain
from leapgap.jumping.task import Target
from leapgap.robot.terrain import Box

FEASIBLE = 1e-6  # A solution may break no constraint by more than this, each in its SI unit
NEAR_M = 0.03  # A plan helps to solve its neighbour within this distance; from farther away a cold start is faster

COLD: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-8,
    "max_iter": 200,  # solvable jumps take 17 to 66, one at the edge of the possible 158
    "mu_strategy": "adaptive",  # a third to half of the iterations of the monotone strategy
    "bound_relax_factor": 1e-9,  # bounds may give by this much, relative to them
    "linear_solver": "mumps",
    "mumps_permuting_scaling": 0,  # cheaper analysis; the KKT matrix is well scaled already
    "mumps_pivot_order": 2,  # AMF: least fill on these banded matrices
}
WARM: dict[str, Any] = {
    **COLD,
    "warm_start_init_point": "yes",
    "mu_strategy": "monotone",
    "mu_init": 1e-4,
    "max_iter": 45,  # usually 5 to 20; beyond, a cold start is the better use of time
    **dict.fromkeys(
        (
            "warm_start_bound_push",
            "warm_start_bound_frac",
            "warm_start_slack_bound_push",
            "warm_start_slack_bound_frac",
            "warm_start_mult_bound_push",
        ),
        1e-6,
    ),
}


@dataclass(frozen=True)
class Violation:
    """The constraint that a trajectory violates most, relative to the scale of its group (``GROUPS``)."""

    label: Label
    amount: float

    def __str__(self) -> str:
        at = self.label
        return f"{at.group}, {at.what}, knot {at.knot}, by {self.amount:.3g} {GROUPS[at.group].unit}"


@dataclass(frozen=True)
class Iterate:
    """Last iterate of the solver: variables and multipliers, used to warm-start a similar problem."""

    w: np.ndarray
    multipliers_w: np.ndarray
    multipliers_g: np.ndarray

    def with_rows(self, rows: int) -> "Iterate":
        """The iterate for a programme with ``rows`` constraints: new multipliers are zero, surplus ones are removed."""
        kept = self.multipliers_g[:rows]
        return replace(self, multipliers_g=np.pad(kept, (0, rows - len(kept))))


@dataclass(frozen=True)
class Solution:
    """Result of a problem; cost and violations are computed from the variables, not taken from the solver."""

    problem: Problem
    trajectory: Trajectory
    cost: float
    max_violation: float  # Largest violation of any constraint or bound, each in its SI unit
    worst: Violation
    status: str  # Return status of IPOPT
    solved: bool  # The solver converged and no constraint is broken by more than ``FEASIBLE``
    iterations: int
    seconds: float
    iterate: Iterate


@dataclass(frozen=True)
class Planner:
    """Plans jumps of one robot, schedule, cost, limits and boxes; everything that targets share is built once.

    Threads may share it: they plan one after the other.
    """

    grid: Grid
    robot: PlanarRobot
    weights: Weights
    limits: Limits
    boxes: tuple[Box, ...] = ()  # Boxes that feet in the air keep clear of
    _lock: Any = field(default_factory=threading.RLock, compare=False, repr=False)

    @cached_property
    def programme(self) -> JumpNlp:
        """The nonlinear programme, which all targets share."""
        return JumpNlp(self.grid, self.robot, self.weights, self.limits, self.boxes)

    @cached_property
    def _cold(self) -> ca.Function:
        return self._solver(COLD)

    def _solver(self, ipopt: dict[str, Any], **derivatives: ca.Function) -> ca.Function:
        options: dict[str, Any] = {"print_time": False, "ipopt": ipopt, **derivatives}
        nlp = {"x": self.programme.w, "f": self.programme.cost, "g": self.programme.g}
        return ca.nlpsol("solver", "ipopt", nlp, options)

    @cached_property
    def _warm(self) -> ca.Function:
        derivatives = {
            option: self._cold.get_function(name)
            for option, name in (("grad_f", "nlp_grad_f"), ("jac_g", "nlp_jac_g"), ("hess_lag", "nlp_hess_l"))
        }
        return self._solver(WARM, **derivatives)

    def prepare(self) -> None:
        """Build programme, derivatives and solvers now, so that ``solve`` takes only the solver's time."""
        with self._lock:
            _ = self._warm

    def solve(self, problem: Problem, near: Solution | None = None) -> Solution:
        """Plan a jump, from ``near`` if that leads to a solution, else from the published first guess.

        Always returns a ``Solution``; where no plan was found, ``solved`` is false, and ``worst`` is broken most.
        """
        self.prepare()
        start = time.perf_counter()
        if near is not None:
            warm = self.continue_from(problem, near, start)
            if warm.solved:
                return warm
        return self._run(self._cold, problem, self._first_guess, start)

    def continue_from(self, problem: Problem, near: Solution, since: float | None = None) -> Solution:
        """Plan a jump from ``near`` alone: it stays on that plan's branch, or is not solved."""
        self.prepare()
        start = near.iterate.with_rows(len(self.programme.row_labels))
        return self._run(self._warm, problem, start, time.perf_counter() if since is None else since)

    def obstacle(self, problem: Problem) -> Violation:
        """The constraint that prevents a jump: the one violated most by a plan without motor limits."""
        self.prepare()
        bounds = self.programme.without_motor_limits(self.programme.w_bounds(problem), self.programme.g_bounds(problem))
        w = self._minimise(self._cold, self._first_guess, *bounds).w
        return self._worst(w, problem)

    @property
    def _first_guess(self) -> Iterate:
        guess = self.programme.first_guess
        return Iterate(guess, np.zeros_like(guess), np.zeros(len(self.programme.row_labels)))

    def _minimise(self, solver: ca.Function, start: Iterate, w_bounds: Bounds, g_bounds: Bounds) -> Iterate:
        first = {"x0": start.w, "lam_x0": start.multipliers_w, "lam_g0": start.multipliers_g}
        found = solver(**first, lbx=w_bounds[0], ubx=w_bounds[1], lbg=g_bounds[0], ubg=g_bounds[1])
        return Iterate(*(np.array(found[name]).ravel() for name in ("x", "lam_x", "lam_g")))

    def _worst(self, w: np.ndarray, problem: Problem) -> Violation:
        amounts, labels = self.programme.violations(w, problem)
        worst = int(np.argmax(amounts / [GROUPS[label.group].matters for label in labels]))
        return Violation(labels[worst], float(amounts[worst]))

    def _run(self, solver: ca.Function, problem: Problem, start: Iterate, since: float) -> Solution:
        programme = self.programme
        with self._lock:
            stopped = self._minimise(solver, start, programme.w_bounds(problem), programme.g_bounds(problem))
            seconds = time.perf_counter() - since
            stats = solver.stats()
        max_violation = float(programme.violations(stopped.w, problem)[0].max())
        return Solution(
            problem=problem,
            trajectory=programme.trajectory(stopped.w),
            cost=programme.cost_of(stopped.w),
            max_violation=max_violation,
            worst=self._worst(stopped.w, problem),
            status=str(stats["return_status"]),
            solved=bool(stats["success"]) and max_violation <= FEASIBLE,
            iterations=int(stats["iter_count"]),
            seconds=seconds,
            iterate=stopped,
        )


planner = lru_cache(maxsize=16)(Planner)  # Kept, because building it takes longer than planning a jump


def solve(problem: Problem, near: Solution | None = None) -> Solution:
    """Plan one jump; ``near`` is the solution of a close target with otherwise the same settings.

    From a distant start, a programme with boxes often converges to a poor plan. A jump is therefore planned without
    boxes first, and again with them from that plan if its feet hit one.
    """
    free = planner_of(problem).solve(problem, near)
    boxes = () if problem.limits.swing_clearance_m is None else terrain(problem.robot, problem.target)
    if not (boxes and free.solved):
        return free
    around = planner_of(problem, boxes)
    if around.programme.violations(free.iterate.w, problem)[0].max() <= FEASIBLE:
        return free
    return around.solve(problem, free)


def planner_of(problem: Problem, boxes: tuple[Box, ...] = ()) -> Planner:
    """The planner of a problem's settings."""
    return planner(problem.grid, problem.robot, problem.weights, problem.limits, boxes)


def solve_all(problems: Sequence[Problem]) -> Iterator[Solution]:
    """Plan jumps in their order, each from the nearest one before it where that is near enough.

    The first jump without a plan is an ``InputError`` that names the constraint that stands in its way.
    """
    solutions: list[Solution] = []
    for problem in problems:
        solution = solve(problem, nearest(problem, solutions))
        if not solution.solved:
            target, obstacle = problem.target, planner_of(problem).obstacle(problem)
            raise InputError(
                f"jump target x {target.x_m:g} m, z {target.z_m:g} m",
                f"no feasible jump ({solution.status} after {solution.iterations} iterations); "
                f"with motors as strong as it takes, broken most: {obstacle}",
                "a target within the robot's limits",
                "choose a nearer target; -0.3 to 0.8 m and boxes up to 0.2 m at 0.6 m are known to work",
            )
        solutions.append(solution)
        yield solution


def nearest(problem: Problem, solutions: Sequence[Solution]) -> Solution | None:
    """The solution whose target is closest, if within ``NEAR_M`` and of the same settings."""

    def distance(solution: Solution) -> float:
        return float(np.abs(landing_goal(solution.problem) - landing_goal(problem)).max())

    near = [
        s
        for s in solutions
        if distance(s) <= NEAR_M
        and s.problem.stance_pitch_rad == problem.stance_pitch_rad
        and (s.problem.grid, s.problem.robot, s.problem.weights, s.problem.limits)
        == (problem.grid, problem.robot, problem.weights, problem.limits)
    ]
    return min(near, key=distance, default=None)


def landing_goal(problem: Problem) -> np.ndarray:
    """Pose in which a plan ends: x, z, m, and pitch, rad, (3,)."""
    target, aim = problem.target, problem.aim
    return np.array([target.x_m + aim.x_m, target.z_m + aim.z_m, aim.pitch_rad])


Index = tuple[int, ...]  # Coordinates of a node of the lattice: x, z and pitch of the goal, pitch of the stance

HALVINGS = 2  # A step that leads to no plan is halved so many times; each half may be halved again


@dataclass(frozen=True)
class FamilyConfig:
    """The canonical jump, and the lattice of jumps between it and all others."""

    x_m: float = 0.4  # Distance of the canonical jump, which lands level on the floor, planned from a cold start
    spacing: tuple[float, float, float, float] = (0.1, 0.06, 0.1, 0.06)
    """Distance of neighbouring nodes: x, z, pitch of the goal, and pitch of the stance; m, m, rad, rad."""


@dataclass
class PlanFamily:
    """Plans of one robot. A plan depends on its own goal only, not on what was planned before it.

    The nodes of a lattice of jumps are planned when they are first needed, each from its neighbour nearer to the
    canonical jump, and kept. A plan starts from the node nearest to its goal.
    """

    robot: PlanarRobot
    grid: Grid
    limits: Limits
    config: FamilyConfig
    _nodes: dict[tuple[tuple[Box, ...], Index], Solution] = field(default_factory=dict)

    def plan(self, target: Target, goal: np.ndarray, stance_pitch: float) -> Solution:
        """The plan to a goal (x, z, pitch; m, m, rad) from a stance of this pitch, rad; it may be unsolved.

        Where the target is on a box, the feet keep clear of it.
        """
        boxes = () if self.limits.swing_clearance_m is None else terrain(self.robot, target)
        at = np.append(goal, stance_pitch)
        node = self._node(boxes, tuple(int(n) for n in np.round((at - self._origin) / self._spacing)))
        return self._continue(boxes, node, target, at)

    @property
    def _origin(self) -> np.ndarray:
        return np.array([self.config.x_m, 0.0, 0.0, 0.0])

    @property
    def _spacing(self) -> np.ndarray:
        return np.array(self.config.spacing)

    def _problem(self, target: Target, at: np.ndarray) -> Problem:
        x, z, pitch, stance = (float(value) for value in at)
        aim = Aim(x - target.x_m, z - target.z_m, pitch)
        return Problem(target, self.grid, self.robot, Weights(), self.limits, stance_pitch_rad=stance, aim=aim)

    def _node(self, boxes: tuple[Box, ...], index: Index) -> Solution:
        """The plan at a node; where there is none, that of the nearest node on the way from the canonical jump."""
        if (boxes, index) not in self._nodes:
            self._nodes[boxes, index] = self._plan_node(boxes, index)
        return self._nodes[boxes, index]

    def _plan_node(self, boxes: tuple[Box, ...], index: Index) -> Solution:
        target, at = Target(self.config.x_m), self._origin + self._spacing * index
        if not boxes and not any(index):
            problem = self._problem(target, at)
            return planner_of(problem).solve(problem)
        # Boxes are added at the node itself: on the way to it there are none.
        before = self._node((), index) if boxes else self._node((), toward_origin(index))
        if not before.solved:
            return before
        solution = self._continue(boxes, before, target, at)
        return solution if solution.solved else before

    def _continue(
        self, boxes: tuple[Box, ...], start: Solution, target: Target, at: np.ndarray, halvings: int = HALVINGS
    ) -> Solution:
        """The plan at ``at`` (4,) from that of ``start``; where one step is too long, in two, and so on."""
        problem = self._problem(target, at)
        planner = planner_of(problem, boxes)
        direct = planner.continue_from(problem, start)
        if direct.solved or not halvings or not start.solved:
            return direct
        middle = (np.append(landing_goal(start.problem), start.problem.stance_pitch_rad) + at) / 2
        half = self._continue(boxes, start, target, middle, halvings - 1)
        return self._continue(boxes, half, target, at, halvings - 1) if half.solved else direct


def toward_origin(index: Index) -> Index:
    """The next node on the way to the origin: one step back along the coordinate that is farthest from it."""
    steps = np.array(index)
    farthest = int(np.argmax(np.abs(steps)))
    steps[farthest] -= np.sign(steps[farthest])
    return tuple(int(n) for n in steps)


plan_family = lru_cache(maxsize=16)(PlanFamily)  # Kept, so that its lattice is planned once
