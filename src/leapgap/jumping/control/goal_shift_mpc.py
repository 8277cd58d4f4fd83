"""MPC whose input is the goal of the jump: shifts of the plan's goal that make the robot land on its target.

Once something sudden has happened in the jump, the landing is predicted at each update from what has come of it, and a
QP chooses the shifts δ of the remaining steps:

    min ‖p + Σ_k G_k (δ_k − δ_before) − target‖²_M + Σ_k ‖δ_k − δ_{k−1}‖²_R + Σ_q ‖Σ_k E_qk (δ_k − δ_before)‖²_M

subject to limits of pitch and height at the landing, of the ground forces, the friction and the torques of the
shifted plan, and of the shifts. Each E_q is one way in which G may be off in all of a jump, for one axis of the shift:
by a share of itself, a little earlier or later, or as the model says. So uncertain shifts stay small. A short shift
that is taken back before the take-off depends on when it comes to the millisecond, and one that is held does not: the
error of the former is large, and that of the latter cancels from step to step.
The first shift is applied until the next update.
"""

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.qp import Qp
from leapgap.jumping.control.shifted_plan import DEVIATIONS, GOAL_AXES, ShiftedPlan, ShiftGrid
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from leapgap.robot.topology import PAIRS

RECENT = 5
"""Number of updates before an update of which all but the last are compared with it: a push that began just before the
last one has shown a little in that already."""


@dataclass(frozen=True)
class ChangeRule:
    """When something is taken for a sudden change."""

    least_surprise: float = 12.0
    """Smallest surprise of the update at which it shows. In practice jumps the largest is 2, in later jumps without
    a kick 10."""
    times_recent: float = 5.0
    """It is larger than the largest of the recent updates by this factor: a crouch far from the planned one surprises
    as much, but from the start on."""


@dataclass(frozen=True)
class CalmMotion:
    """How the deviation from the plan goes on from each of T updates to the next while nothing happens."""

    carry: np.ndarray  # Deviation at an update from [1, that at the update before], (T, 11, 10)
    precision: np.ndarray  # Inverse covariance of what is left, (T, 10, 10)

    def carried(self, update: int, before: np.ndarray) -> np.ndarray:
        """The deviation (10,) that is expected at an update after that of the update before (10,)."""
        found: np.ndarray = self.carry[update, 0] + before @ self.carry[update, 1:]
        return found

    def surprise(self, update: int, left: np.ndarray) -> float:
        """Mean square of what is unexpected of a deviation, ``left`` (10,), in squared standard deviations: 1 while
        nothing happens."""
        return float(left @ self.precision[update] @ left) / DEVIATIONS


class ChangeWatch:
    """Watches the deviations of a jump for its first sudden change, and tells what has come since.

    ``age`` counts the updates since the change, from 1 on; 0: nothing has happened.
    """

    def __init__(self, calm: CalmMotion, rule: ChangeRule) -> None:
        self.calm, self.rule = calm, rule
        self.age = 0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._calm: np.ndarray | None = None  # The deviation (10,) at the last update; since a change, without that
        self._since = np.zeros(DEVIATIONS)  # What a change had added to it then
        self._update = -1

    def since(self, update: int, deviation: np.ndarray) -> np.ndarray | None:
        """What a sudden change has added to the deviation at an update, and at the last one that was told, (20,).

        ``deviation`` (10,) is that at the update. Updates come in turn; those that are missing or not finite are gone
        over. None while nothing has happened, and where the deviation is not finite.
        """
        gap, self._update = update - self._update, update
        finite = bool(np.isfinite(deviation).all())
        if self._calm is None:
            self._calm = deviation if finite else None
            return None
        calm = self._calm
        for passed in range(update - gap + 1, update + 1):
            calm = self.calm.carried(passed, calm)
        if self.age:
            self.age += gap
        elif finite and gap == 1 and self._is_sudden(self.calm.surprise(update, deviation - calm)):
            self.age = 1
        elif finite:
            calm = deviation
        self._calm = calm
        if not (self.age and finite):
            return None
        before, self._since = self._since, deviation - calm
        return np.concatenate([self._since, before])

    def _is_sudden(self, surprise: float) -> bool:
        """Whether an update surprises more than the recent ones but the last; it is remembered."""
        known = len(self._recent) == RECENT
        usual = max(1.0, *list(self._recent)[:-1]) if known else np.inf
        self._recent.append(surprise)
        return surprise > self.rule.least_surprise and surprise > self.rule.times_recent * usual


PITCH, HEIGHT, EFFORT = 0, 1, 2  # Slacks of the QP: of the landing's pitch, of its height, and of forces and torques
SLACKS = 3
HEIGHT_AXIS, PITCH_AXIS = 1, 2  # Places of height and pitch in a landing


class LandingPredictor(Protocol):
    """What the MPC asks of a model of the landing."""

    @property
    def authority(self) -> np.ndarray:
        """Change of the landing by a shift during each update, (updates, 3 of the landing, 3 of the shift)."""

    @property
    def authority_error(self) -> np.ndarray:
        """By how much it may be off in q independent ways, each one of the whole jump, (q, updates, 3, 3); the same for
        all goals."""

    def planned_to(self, goal: np.ndarray) -> "LandingPredictor":
        """The model for a jump whose plan goes to a goal (3,)."""

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        """Landing, (3,), of a jump to one constant goal (3,) in which nothing unexpected happens."""

    @property
    def calm(self) -> CalmMotion:
        """How the robot goes on off its plan while nothing happens."""

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        """Change of the landing, (3,), m, m, rad, by what a sudden change has added to the deviation now and at the
        update before, (20,), ``age`` updates after it."""


@dataclass(frozen=True)
class GoalShiftConfig:
    """Settings of the MPC; x and z of the landing in m, its pitch in rad."""

    period_s: float = 0.025  # Time from one update of the shift to the next, s
    steps: int = 6  # Steps of the horizon, the last of which ends at the landing
    matters: tuple[float, float, float] = (0.01, 0.03, 0.1)  # Landing errors that cost alike
    scale: tuple[float, float, float] = (0.05, 0.04, 0.08)  # Changes of the shift from step to step that cost one each
    on_rear_feet: bool = False
    """Whether the shift still changes when only the rear feet push. Then it moves the landing a third as far and turns
    the trunk, and a weak robot whose motors are at their limit falls by it."""
    authority_doubt: float = 0.3  # Standard deviation of G beyond what the model states, as a share of G
    timing_doubt_s: float = 0.005  # Standard deviation of the time at which a shift has its effect
    largest: tuple[float, float, float] = (0.15, 0.1, 0.2)  # Largest shift
    largest_change: tuple[float, float, float] = (0.025, 0.02, 0.04)  # Largest change of the shift at one update
    largest_pitch_rad: float = 0.15  # Largest predicted pitch at the landing; at 15° (0.26 rad) a landing is a fall
    below_target_m: float = 0.06
    """Largest predicted distance of the landing below the target's height. Without any room, the height was bought with
    centimetres of x after a kick: on flat ground a low landing is an early one."""
    limits: ForceLimits = field(default_factory=lambda: ForceLimits(friction=0.7, largest_n=350.0, smallest_n=10.0))
    """Limits of the ground forces of the shifted plan, of a pair."""
    torque_nm: float = 33.5  # Limit of the joint torques of the shifted plan
    soft_landing: tuple[float, float] = (0.08, 0.03)
    """Violations of the limits of pitch, rad, and of height, m, that cost ``slack_weight`` each."""
    soft_effort: tuple[float, float] = (10.0, 2.0)
    """Violations of a force limit, N, and of a torque limit, N·m, that cost ``slack_weight``. Plans are often at a
    limit already, and a linear shift of them then breaks it a little."""
    slack_weight: float = 100.0
    sudden: ChangeRule = field(default_factory=ChangeRule)
    """What counts as sudden. Before that no shift moves the goal, which was chosen with all that was known."""
    average_s: float = 0.01  # Time over which the measured deviation from the plan is averaged


BEFORE_NEXT_S = 0.002  # The last sample of a step is this long before its end


@dataclass(frozen=True)
class Efforts:
    """The m limits of the steps of one horizon, each at a sample of a step.

    slope · shift of its step − soft · slack ≤ room, which depends on how far goal and stance were moved before.
    ``axes`` are those of the plan. Forces are limited where the plan itself pushes.
    """

    step: np.ndarray  # Step of the horizon, int, (m,)
    slope: np.ndarray  # Change of the effort by goal and stance, (m, axes)
    soft: np.ndarray  # (m,)
    distance: np.ndarray  # Distance of the plan itself to the limit, (m,)

    def room(self, change: np.ndarray) -> np.ndarray:
        """Distance to the limit where goal and stance were changed (axes,), (m,)."""
        return self.distance - self.slope @ change


def efforts_of(plan: ShiftedPlan, grid: ShiftGrid, edges: np.ndarray, config: GoalShiftConfig) -> Efforts:
    """The limits of a horizon whose steps begin and end at the updates ``edges`` (steps + 1,)."""
    reference = plan.reference
    # Left and right legs have equal torques: one of each is enough.
    joints = np.unique(reference.torque, axis=1, return_index=True)[1]
    first, last = grid.period_s * edges[:-1], grid.period_s * edges[1:]
    times = np.stack([first, (first + last) / 2, last - BEFORE_NEXT_S], axis=1)
    parts: list[tuple[np.ndarray, ...]] = []
    for step, rows in enumerate(reference.rows(times)):
        force, force_slope = reference.force[rows], plan.slopes["force"][:, rows]
        torque, torque_slope = reference.torque[rows], plan.slopes["torque"][:, rows]
        stands = reference.schedule.in_contact(rows * reference.period_s)
        for pair in range(len(PAIRS)):
            on = stands[:, pair] & (force[:, FORCE_Z][:, pair] > config.limits.smallest_n)
            x, z = (force[on][:, axis][:, pair] for axis in (FORCE_X, FORCE_Z))
            dx, dz = (force_slope[:, on][:, :, axis][:, :, pair].T for axis in (FORCE_X, FORCE_Z))
            friction, smallest_n, largest_n = config.limits.friction, config.limits.smallest_n, config.limits.largest_n
            for excess, slope in (
                (x - friction * z, dx - friction * dz),
                (-x - friction * z, -dx - friction * dz),
                (z - largest_n, dz),
                (smallest_n - z, -dz),
            ):
                parts.append((np.full(len(z), step), slope, np.full(len(z), config.soft_effort[0]), -excess))
        for sign in (1.0, -1.0):
            distance = (config.torque_nm - sign * torque[:, joints]).ravel()
            slope = sign * torque_slope[:, :, joints].reshape(plan.axes, -1).T
            count = len(distance)
            parts.append((np.full(count, step), slope, np.full(count, config.soft_effort[1]), distance))
    return Efforts(*(np.concatenate(part) for part in zip(*parts, strict=True)))


@dataclass(frozen=True)
class UpdateBasis:
    """What the QP of one update has in common for all goals and stances that the plan is moved to."""

    edges: np.ndarray  # First update of each step, and the end of the last one, (steps + 1,)
    hessian: np.ndarray  # Costs of changes of the shift, of what the model states as errors, and of slacks, (n, n)
    landing: np.ndarray  # Slacks in the limits of the landing, (3, n); what the shifts do is not in it
    efforts: Efforts
    effort_rows: np.ndarray  # Limits of forces and torques on shifts and slacks, (m, n)

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.edges) - 1


@dataclass(frozen=True)
class PreparedUpdate:
    """What one update's QP has in common for all measurements."""

    authority: np.ndarray  # Change of the landing by the shift of each step, (3, 3 steps)
    hessian: np.ndarray
    rows: np.ndarray  # Constraints on shifts and slacks, (m, n): pitch up and down, height, then efforts
    effort: np.ndarray  # Distance of the plan without shift to its limits, (m − 3,)
    effort_by_shift: np.ndarray  # Change of the efforts by one shift of all steps, (m − 3, 3)


class GoalShiftPlanner:
    """Builds the QPs of one jump; everything that needs no measurement is computed once, when it is first needed."""

    def __init__(
        self,
        plan: ShiftedPlan,
        model: LandingPredictor,
        target: np.ndarray,
        config: GoalShiftConfig,
        change: np.ndarray | None = None,
        bases: Sequence[UpdateBasis] | None = None,
    ) -> None:
        """``target`` (3,): where to land, m, m, rad. ``change`` (axes,): how far goal and stance are from the plan's.
        ``bases``: those of another planner of this plan."""
        self.plan, self.model, self.target, self.config = plan, model, target, config
        self.change = np.zeros(plan.axes) if change is None else change
        self.grid = ShiftGrid(plan.reference.schedule, config.period_s, config.steps, config.on_rear_feet)
        self.errors = 1 / np.array(config.matters) ** 2
        timing = config.timing_doubt_s / config.period_s * np.gradient(model.authority, axis=0)
        self._doubts = np.stack([config.authority_doubt * model.authority, timing])
        """Ways in which the authority may be off beyond what the model states, (2, updates, 3, 3)."""
        self.bases = [self._basis(update) for update in range(self.grid.updates)] if bases is None else bases
        self._prepared: dict[int, PreparedUpdate] = {}

    def moved(self, model: LandingPredictor, target: np.ndarray, change: np.ndarray) -> "GoalShiftPlanner":
        """The planner where goal and stance are changed (axes,) from those of the plan; little is computed again."""
        return GoalShiftPlanner(self.plan, model, target, self.config, change, self.bases)

    def prepare(self) -> None:
        """Compute all that needs no measurement, while there is time."""
        for update in range(self.grid.updates):
            self.prepared(update)

    def prepare_ahead(self, update: int) -> None:
        """Compute it for the first update after this one for which it is still missing: a little in each tick."""
        missing = (later for later in range(update + 1, self.grid.updates) if later not in self._prepared)
        for later in itertools.islice(missing, 1):
            self.prepared(later)

    def prepared(self, update: int) -> PreparedUpdate:
        """What the QP of an update needs; computed when it is first asked for."""
        if update not in self._prepared:
            self._prepared[update] = self._prepare(update)
        return self._prepared[update]

    def problem(self, update: int, predicted: np.ndarray, before: np.ndarray) -> Qp:
        """The QP of an update from the landing (3,) predicted without a further change of the shift ``before`` (3,)."""
        config, ready = self.config, self.prepared(update)
        steps = (len(ready.hessian) - SLACKS) // GOAL_AXES
        miss = predicted - self.target
        gradient = np.zeros(len(ready.hessian))
        gradient[:-SLACKS] = ready.authority.T @ (self.errors * miss)
        largest, change = np.array(config.largest), np.array(config.largest_change)
        upper = np.concatenate([np.tile(largest - before, steps), np.full(SLACKS, np.inf)])
        lower = np.concatenate([np.tile(-largest - before, steps), np.zeros(SLACKS)])
        upper[:GOAL_AXES] = np.minimum(upper[:GOAL_AXES], change)
        lower[:GOAL_AXES] = np.maximum(lower[:GOAL_AXES], -change)
        landing = [
            config.largest_pitch_rad - predicted[PITCH_AXIS],
            config.largest_pitch_rad + predicted[PITCH_AXIS],
            config.below_target_m + miss[HEIGHT_AXIS],
        ]
        # Where the plan as shifted so far is at a limit or beyond it, a further shift must not add to that.
        room = np.maximum(ready.effort - ready.effort_by_shift @ before, 0.0)
        row_upper = np.concatenate([landing, room])
        return Qp(ready.hessian, gradient, lower, upper, ready.rows, row_upper)

    def _basis(self, update: int) -> UpdateBasis:
        config, edges = self.config, self.grid.horizon(update)
        steps = len(edges) - 1
        shifts = GOAL_AXES * steps
        difference = np.kron(np.eye(steps) - np.eye(steps, k=-1), np.eye(GOAL_AXES))
        change = np.tile(1 / np.array(config.scale) ** 2, steps)
        hessian = np.zeros((shifts + SLACKS,) * 2)
        hessian[:shifts, :shifts] = difference.T @ (change[:, None] * difference)
        hessian[:shifts, :shifts] += self._variance(self.model.authority_error, edges)
        hessian[shifts:, shifts:] = np.diag([config.slack_weight] * SLACKS)
        landing = np.zeros((3, len(hessian)))
        landing[:2, PITCH - SLACKS], landing[2, HEIGHT - SLACKS] = (-soft for soft in config.soft_landing)
        efforts = efforts_of(self.plan, self.grid, edges, config)
        rows = np.zeros((len(efforts.step), len(hessian)))
        for axis in range(GOAL_AXES):
            rows[np.arange(len(rows)), GOAL_AXES * efforts.step + axis] = efforts.slope[:, axis]
        rows[:, EFFORT - SLACKS] = -efforts.soft
        return UpdateBasis(edges, hessian, landing, efforts, rows)

    def _variance(self, ways: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """Cost of shifts by the ways (q, updates, 3, 3) in which the authority may be off, (3 steps, 3 steps)."""
        errors = np.stack([ways[:, first:last].sum(axis=1) for first, last in itertools.pairwise(edges)], axis=1)
        steps = len(edges) - 1
        variance = np.zeros((steps, GOAL_AXES, steps, GOAL_AXES))
        for axis in range(GOAL_AXES):
            weighted = np.sqrt(self.errors)[:, None, None] * errors[..., axis].transpose(2, 0, 1)
            of_axis = weighted.reshape(-1, steps)
            variance[:, axis, :, axis] = of_axis.T @ of_axis
        return variance.reshape(GOAL_AXES * steps, GOAL_AXES * steps)

    def _prepare(self, update: int) -> PreparedUpdate:
        basis = self.bases[update]
        shifts = GOAL_AXES * basis.steps
        free = float(update < self.grid.free_updates)  # a shift without an effect stays as it is
        steps = itertools.pairwise(basis.edges)
        authority = free * np.concatenate([self.model.authority[a:b].sum(axis=0) for a, b in steps], axis=1)
        hessian = basis.hessian.copy()
        hessian[:shifts, :shifts] += authority.T @ (self.errors[:, None] * authority)
        hessian[:shifts, :shifts] += self._variance(self._doubts, basis.edges)
        landing = basis.landing.copy()
        landing[:, :shifts] = authority[PITCH_AXIS], -authority[PITCH_AXIS], -authority[HEIGHT_AXIS]
        rows, efforts = np.concatenate([landing, basis.effort_rows]), basis.efforts
        return PreparedUpdate(authority, hessian, rows, efforts.room(self.change), efforts.slope[:, :GOAL_AXES])
