"""A smooth family of plans: all jumps of one robot, continued from one canonical plan.

A jump often has several locally optimal plans, for example with a deep and with a shallow crouch. From a cold start,
two goals that are a centimetre apart can end in different ones, and the robot then lands centimetres apart. Here every
plan follows from the canonical one in steps that are small enough to stay on its branch.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.boxes import terrain
from leapgap.jumping.planning.problem import Aim, Grid, Limits, Problem, Weights
from leapgap.jumping.planning.solve import Solution, landing_goal, planner_of
from leapgap.jumping.task import Target
from leapgap.robot.terrain import Box

Index = tuple[int, ...]
"""Coordinates of a node of the lattice: x, z and pitch of the goal, and pitch of the stance, in spacings."""

HALVINGS = 2
"""A step that leads to no plan is halved so many times; each half may be halved again."""


@dataclass(frozen=True)
class FamilyConfig:
    """The canonical jump, and the lattice of jumps between it and all others."""

    x_m: float = 0.4
    """Distance of the canonical jump, which lands level on the floor. Its plan comes from a cold start."""
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
        middle = (coordinates(start.problem) + at) / 2
        half = self._continue(boxes, start, target, middle, halvings - 1)
        return self._continue(boxes, half, target, at, halvings - 1) if half.solved else direct


def coordinates(problem: Problem) -> np.ndarray:
    """x, z and pitch of a plan's goal, and pitch of its stance, (4,), m, m, rad, rad."""
    return np.append(landing_goal(problem), problem.stance_pitch_rad)


def toward_origin(index: Index) -> Index:
    """The next node on the way to the origin: one step back along the coordinate that is farthest from it."""
    steps = np.array(index)
    farthest = int(np.argmax(np.abs(steps)))
    steps[farthest] -= np.sign(steps[farthest])
    return tuple(int(n) for n in steps)


@lru_cache(maxsize=16)
def plan_family(robot: PlanarRobot, grid: Grid, limits: Limits, config: FamilyConfig) -> PlanFamily:
    """The family of these settings; it is cached, so that its lattice is planned once."""
    return PlanFamily(robot, grid, limits, config)
