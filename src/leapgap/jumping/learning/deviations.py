"""Jumps as deviations from their plans on the steps of a time grid: what models of the deviation are fitted to."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.learning.window_extraction import feet, planned_forces, rows_at, states
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.affine_model import AffineModel
from leapgap.jumping.models.deviation_model import CURVATURE, PlannedSteps
from leapgap.jumping.models.rigid_body import advance
from leapgap.jumping.task import schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis
from leapgap.robot.model import Robot

BALLISTIC_S = 0.2
"""Before the planned landing: feet may touch down there, so nothing is learned and the deviation flies on freely."""
SMOOTHED_ROWS = 3
"""Before and after each sample, of which the mean is taken against the noise of the sensors."""


@dataclass(frozen=True)
class DeviatingJump:
    """One jump of n steps."""

    name: str
    steps: PlannedSteps
    error: np.ndarray
    """Measured state − planned state at the ends of the steps, the first at the start, (n + 1, 6), m, rad, s."""
    force: np.ndarray
    """Mean over each step of the force that the MPC decided − that of the plan, (n, 4), N."""
    weight: float = 1.0
    """How much it counts in a fit."""
    kicked: int | None = None
    """Step in which something sudden moved it, of which nothing is learned; None: none."""
    simulated: bool = False
    """Whether it is of the identified robot, and no jump of the robot itself."""

    @property
    def learned(self) -> np.ndarray:
        """Whether each step is one to learn from, (n,): feet may touch down in the last of them."""
        ends = self.steps.time_s < self.steps.end_s[-1] - BALLISTIC_S - 1e-6
        return ends & (np.arange(len(self.steps)) != self.kicked)

    @property
    def step_s(self) -> np.ndarray:
        """Length of each step, (n,)."""
        return self.steps.end_s - self.steps.time_s

    @property
    def acceleration(self) -> np.ndarray:
        """Gain of the deviation's velocities per second of each step, (n, 3)."""
        return np.diff(self.error[:, 3:], axis=0) / self.step_s[:, None]


def planned_steps(plan: Log, grid: TimeGrid, robot: Robot) -> PlannedSteps:
    """The steps of a whole plan."""
    schedule = schedule_of(plan)
    times = grid.sample_times(schedule)
    begin, stance_rad = times[:-1], float(plan.pitch[0])
    foot = feet(plan, robot, rows_at(plan, begin))
    return PlannedSteps(begin, times[1:], foot, schedule.in_contact(begin), target_of(plan), stance_rad)


def deviating_jump(
    jump: Log,
    plan: Log,
    grid: TimeGrid,
    robot: Robot,
    weight: float = 1.0,
    kicked_s: float | None = None,
    simulated: bool = False,
) -> DeviatingJump:
    """A jump that begins with the first row of its log, along its plan; kicked at ``kicked_s`` since its start."""
    times = grid.sample_times(schedule_of(plan))
    kicked = None if kicked_s is None else int(np.searchsorted(times, kicked_s)) - 1
    error = deviation(jump, plan, times)
    stands = per_axis(schedule_of(plan).in_contact(plan.time))
    force = mean_over_steps(jump, planned_forces(jump), times) - mean_over_steps(
        plan, planned_forces(plan) * stands, times
    )
    return DeviatingJump(jump.name, planned_steps(plan, grid, robot), error, force, weight, kicked, simulated)


def deviation(jump: Log, plan: Log, times_s: np.ndarray) -> np.ndarray:
    """Measured − planned state at some times, x from the first row of each log, mean over ``SMOOTHED_ROWS``, (n, 6)."""
    rows = min(len(jump), len(plan))
    off = states(jump)[:rows] - states(plan)[:rows]
    off[:, 0] -= off[0, 0]
    total = np.concatenate([np.zeros((1, off.shape[1])), np.cumsum(off, axis=0)])
    at = rows_at(jump, np.minimum(times_s, jump.time[rows - 1]))
    begin, end = np.maximum(at - SMOOTHED_ROWS, 0), np.minimum(at + SMOOTHED_ROWS + 1, rows)
    return (total[end] - total[begin]) / (end - begin)[:, None]


def mean_over_steps(jump: Log, values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Means of values (rows, m) over the rows of each step between times (n + 1,), (n, m); zero beyond the log."""
    rows = rows_at(jump, np.minimum(times_s, jump.time[-1]))
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])[rows]
    return np.diff(total, axis=0) / np.maximum(np.diff(rows), 1)[:, None]


def rolled_out(jump: DeviatingJump, affine: AffineModel, first: int = 0) -> np.ndarray:
    """Deviations at the ends of the steps from step ``first`` on, by a model along the plan, (n − first + 1, 6)."""
    error = [jump.error[first]]
    for k in range(first, len(jump.steps)):
        now = affine.at(slice(k, k + 1)).seen_from(error[-1][None])
        error.append(advance(error[-1], now.acceleration(jump.force[k : k + 1])[0], jump.step_s[k], CURVATURE))
    return np.array(error)
