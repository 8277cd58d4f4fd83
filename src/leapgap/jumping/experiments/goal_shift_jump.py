"""A goal-directed jump whose goal is shifted while the robot pushes."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from leapgap.jumping.control.goal_shift_jump import LateStance, ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import CalmMotion, GoalShiftConfig
from leapgap.jumping.control.shifted_plan import DEVIATIONS, GOAL_AXES, ShiftedPlan, differences
from leapgap.jumping.control.tracking import JumpController, Reference
from leapgap.jumping.experiments.goal_directed_jump import (
    GoalChoice,
    GoalDirectedJump,
    JumpPlanner,
    LandingModel,
    target_pose,
)
from leapgap.jumping.experiments.method import JumpTask, Method, goal_choice
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.planning.solve import Solution, landing_goal
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate


@dataclass(frozen=True)
class ArrayRecord:
    """Base of a dataclass whose fields are arrays of numbers alone."""

    def to_json(self) -> dict[str, Any]:
        """The arrays as lists; what is not finite becomes null."""
        values = {one.name: getattr(self, one.name).astype(object) for one in fields(self)}
        for of in values.values():
            of[~np.isfinite(of.astype(float))] = None
        return {name: of.tolist() for name, of in values.items()}

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Self:
        """The inverse of ``to_json``: numbers in JSON keep all their digits, and null becomes NaN."""
        return cls(**{name: np.array(values, dtype=float) for name, values in raw.items()})


SCALE = np.array([0.01, 0.01, 0.04, 0.1, 0.1, 0.4, *[0.01] * 4])
"""Typical deviation of x, z and pitch, of their rates, and of the feet relative to the base; m, m, rad, per s, m."""
MATTERS = np.array([0.01, 0.03, 0.1])  # Landing errors that count alike; m, m, rad
FIRST, LATER = 0, 1
"""Models by the age of a kick. At the first update after it, transients are in the state that are gone at the next."""


@dataclass(frozen=True)
class FeedbackConfig:
    """How the models of a robot are learned: deviations in units of ``SCALE``, landings in those of ``MATTERS``."""

    calm_noise: float = 0.03  # Standard deviation of what is unexpected of a deviation between updates, before any jump
    calm_change: float = 0.3  # The same of how the deviation of one update differs in the next by each of the ten
    calm_prior: float = 4.0  # So many jumps count what is known before any jump
    weight: float = 3.0  # Deviation of what a deviation does to the landing, before simulated jumps, at a noise of one
    whole_m: float = 0.05
    """A kick that moves the landing farther along x is scaled down to that, so that large ones do not count most."""


@dataclass(frozen=True)
class HeldShifts:
    """What k shifts did to the landings of jumps to g goals that were held from some update to the end."""

    x_m: np.ndarray  # Distances of the goals, rising, (g,), m
    update: np.ndarray  # The update from which each shift was held, (k,)
    axis: np.ndarray  # The axis of the goal along which each shift was, (k,)
    effect: np.ndarray  # Change of the landing per shift, (g, k, 3); not finite where a jump fell
    error: float  # Standard deviation of an effect


@dataclass(frozen=True)
class Authority(ArrayRecord):
    """What a shift does to the landing of jumps to g goals, and in how many ways that may be off."""

    mean: np.ndarray  # G of each goal and update, (g, T, 3 of the landing, 3 of the shift)
    error: np.ndarray  # By how much G may be off in q independent ways, (q, T, 3, 3); each way is one of whole jumps
    x_m: np.ndarray = field(default_factory=lambda: np.array([0.55]))  # Distances of the goals, rising, (g,), m

    def at(self, x_m: np.ndarray) -> np.ndarray:
        """G of goals at n distances, (n, T, 3, 3), linearly between those of the g goals."""
        shares = np.stack([np.interp(x_m, self.x_m, one) for one in np.eye(len(self.x_m))], axis=1)
        return np.einsum("ng,gtij->ntij", shares, self.mean)

    def measured(self, held: HeldShifts) -> "Authority":
        """The same with what was measured of held shifts in the place of what was known of them.

        Between its goals the effect is taken for a straight line, which may be off by half of its difference. An axis
        that was not measured may be off at an update by as much as the measured ones were.
        """
        if not len(held.x_m):
            return self
        mean, error = held_effects(self.at(held.x_m)), held_effects(self.error)
        ways = []
        for update in np.unique(held.update):
            of_update = held.update == update
            simulated = mean[:, update][:, :, held.axis[of_update]].swapaxes(1, 2)
            wrong = np.nan_to_num(np.abs(held.effect[:, of_update] - simulated)).max(axis=(0, 1))
            for i, axis in itertools.product(range(3), set(range(3)) - set(held.axis[of_update])):
                way = np.zeros(error.shape[1:])
                way[update, i, axis] = wrong[i]
                ways.append(way)
        for update, axis, effect in zip(held.update, held.axis, held.effect.swapaxes(0, 1), strict=True):
            if not np.isfinite(effect).all():
                continue
            mean[:, update, :, axis] = effect
            error[:, update, :, axis] = 0.0
            for i, off in enumerate(np.hypot(held.error, np.ptp(effect, axis=0) / 2)):
                way = np.zeros(error.shape[1:])
                way[update, i, axis] = off
                ways.append(way)
        return Authority(
            of_held(mean), of_held(np.concatenate([error, np.array(ways).reshape(-1, *error.shape[1:])])), held.x_m
        )


@dataclass(frozen=True)
class ShiftedJumps(ArrayRecord):
    """n jumps with T updates each."""

    goal: np.ndarray  # Planned goals, (n, 3), m, m, rad
    stance_pitch: np.ndarray  # (n,), rad
    landing: np.ndarray  # (n, 3), as the goal
    shift: np.ndarray  # Shift of the goal from each update on, (n, T, 3), m, m, rad
    deviation: np.ndarray  # Deviation from the shifted plan at each update, (n, T, 10); not finite where none came

    def __len__(self) -> int:
        return len(self.goal)

    @staticmethod
    def join(parts: Sequence["ShiftedJumps"]) -> "ShiftedJumps":
        """All jumps of some parts, in their order."""
        names = [one.name for one in fields(ShiftedJumps)]
        return ShiftedJumps(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class KickedJumps(ArrayRecord):
    """n simulated jumps, each compared with the same jump without its kick, at T updates."""

    since: np.ndarray  # Deviation from the shifted plan less that without the kick, (n, T, 10); else not finite
    landing: np.ndarray  # Change of the landing by the kick, (n, 3), m, m, rad


def held_effects(authority: np.ndarray) -> np.ndarray:
    """Effects of shifts that are held from each of T updates to the end, by those of single updates (n, T, 3, 3).

    Shape (n, T + 1, 3, 3); a shift after the last update does nothing.
    """
    held = np.flip(np.cumsum(np.flip(authority, -3), axis=-3), -3)
    return np.concatenate([held, np.zeros_like(held[..., :1, :, :])], axis=-3)


def of_held(held: np.ndarray) -> np.ndarray:
    """The inverse of ``held_effects``."""
    return -np.diff(held, axis=-3)


@dataclass(frozen=True)
class LandingFeedback:
    """The learned model of one robot; see the module."""

    landing: LandingModel
    shifts: Authority
    calm: CalmMotion
    by_change: np.ndarray
    """W of each update, (T, 2, 20, 3), m, m, rad by m, rad and per s: of the first update after a kick, and of later
    ones, by what the kick has added to the deviation now and at the update before."""
    planned_x_m: float = 0.55  # Distance of the planned goal, which decides what shifts do

    def planned_to(self, goal: np.ndarray) -> "LandingFeedback":
        """The model for a jump whose plan goes to a goal (3,)."""
        return replace(self, planned_x_m=float(goal[0]))

    @cached_property
    def authority(self) -> np.ndarray:
        """G of each update, (T, 3, 3)."""
        return self.shifts.at(np.array([self.planned_x_m]))[0]

    @property
    def authority_error(self) -> np.ndarray:
        """By how much G may be off in q independent ways, (q, T, 3, 3)."""
        return self.shifts.error

    def expect(self, goal: np.ndarray, stance: float) -> np.ndarray:
        """Landing, (3,), of a jump to one constant goal in which nothing unexpected happens."""
        return self.landing.landing(goal, stance)

    def change(self, update: int, age: int, since: np.ndarray) -> np.ndarray:
        """Change of the landing, (3,), by what a sudden change has added to the deviation now and before, (20,).

        It was ``age`` updates ago.
        """
        found: np.ndarray = since @ self.by_change[update, FIRST if age == 1 else LATER]
        return found


def learn_calm(deviation: np.ndarray, config: FeedbackConfig) -> CalmMotion:
    """How deviations (n, T, 10) of n jumps in which nothing happens go on from each update to the next.

    A linear law, which is drawn towards none of them changing. Its errors are those of jumps left out.
    """
    updates = deviation.shape[1]
    carry = np.zeros((updates, 1 + DEVIATIONS, DEVIATIONS))
    carry[:, 1:] = np.eye(DEVIATIONS)
    precision = np.zeros((updates, DEVIATIONS, DEVIATIONS))
    prior = np.diag([1e-6, *[(config.calm_noise / config.calm_change) ** 2] * DEVIATIONS])
    for update in range(1, updates):
        before, now = deviation[:, update - 1] / SCALE, deviation[:, update] / SCALE
        usable = np.isfinite(before).all(axis=1) & np.isfinite(now).all(axis=1)
        inputs = np.column_stack([np.ones(usable.sum()), before[usable]])
        stays = carry[update].copy()
        inner = np.linalg.inv(inputs.T @ inputs + prior)
        law = stays + inner @ inputs.T @ (now[usable] - inputs @ stays)
        leverage = np.einsum("ni,ij,nj->n", inputs, inner, inputs)
        left = (now[usable] - inputs @ law) / np.maximum(1 - leverage, 0.05)[:, None]
        known = left.T @ left + config.calm_prior * config.calm_noise**2 * np.eye(DEVIATIONS)
        precision[update] = np.linalg.inv(known / (usable.sum() + config.calm_prior)) / np.outer(SCALE, SCALE)
        carry[update] = law * SCALE / np.concatenate([[1.0], SCALE])[:, None]
    return CalmMotion(carry, precision)


def learn_change(kicked: KickedJumps, config: FeedbackConfig) -> np.ndarray:
    """What deviations by a kick do to the landing, ``LandingFeedback.by_change``, by simulated jumps.

    A push that still goes on differs from a kick by what it adds from update to update, so that the update before
    counts as well. Where too few jumps were kicked just before an update, the first model there is the later one.
    """
    updates = kicked.since.shape[1]
    found = np.zeros((updates, 2, 2 * DEVIATIONS, 3))
    size = np.maximum(1.0, np.abs(kicked.landing[:, :1]) / config.whole_m)
    outputs = kicked.landing / size / MATTERS
    shows = np.isfinite(kicked.since).all(axis=2)
    showed = np.pad(shows, ((0, 0), (1, 0)))[:, :-1]
    since = np.nan_to_num(kicked.since) / SCALE / size[:, None]
    of_updates = np.concatenate([since, np.pad(since, ((0, 0), (1, 0), (0, 0)))[:, :-1] * showed[:, :, None]], axis=2)
    for update in range(updates):
        inputs = of_updates[:, update]
        first, later = shows[:, update] & ~showed[:, update], shows[:, update] & showed[:, update]
        of_later = ridge(inputs[later], outputs[later], config.weight)
        enough = first.sum() > 2 * DEVIATIONS
        of_first = ridge(inputs[first], outputs[first], config.weight) if enough else of_later
        for age, weights in ((FIRST, of_first), (LATER, of_later)):
            found[update, age] = weights * MATTERS / np.tile(SCALE, 2)[:, None]
    return found


def ridge(inputs: np.ndarray, outputs: np.ndarray, deviation: float) -> np.ndarray:
    """Weights (inputs, outputs) of a linear regression with noise one, drawn towards zero."""
    inner = inputs.T @ inputs + np.eye(inputs.shape[1]) / deviation**2
    weights: np.ndarray = np.linalg.solve(inner, inputs.T @ outputs)
    return weights


NO_NEIGHBOURS = "no plans of neighbouring goals"
NO_OTHER_STANCE = "no plan from another stance, so that none can be measured in the jump"
STANCE_STEPS = (-0.05, 0.05)
"""Distance of the stance that the slope by the stance's pitch is taken from, rad: nose-up, as on a block ahead, and
nose-down where the first has no plan."""
LARGEST_TILT_RAD = 0.2  # A stance that is measured in the jump and farther from the expected one is not believed
STANCES = 21  # Number of stances within that distance whose goals are chosen before the jump: one every 0.02 rad
NEIGHBOUR_STEPS = (0.05, 0.04, 0.08)  # Distance of the neighbouring goals for slopes: x, z, pitch; m, m, rad


class GoalShiftJump(GoalDirectedJump):
    """Plans to a goal and to its neighbours from the measured stance, then jumps with goal-shift MPC.

    ``shift_tracker`` holds what was shifted and measured; it is None where there were no neighbouring plans.
    """

    def __init__(self, choice: GoalChoice, first: Reference, method: "GoalShiftMethod") -> None:
        super().__init__(choice, first, method.robot, method.gains)
        self.settings = method
        self.shift_tracker: ShiftTracker | None = None

    def track(self, solution: Solution | None) -> JumpController:
        """Goal-shift MPC along the plan; joint PD where there are no neighbouring plans."""
        plan = None if solution is None else shifted_plan(self.choice.planner, solution, self.reference, self.robot)
        if plan is None or self.goal is None or solution is None:
            if solution is not None:
                self.count_fallback(NO_NEIGHBOURS)
            return super().track(solution)
        settings, feedback = self.settings, self.settings.feedback
        late = None
        if not self.choice.stance_is_seen:
            slopes = stance_slopes(self.choice.planner, solution, self.reference, self.robot)
            if slopes is None:
                self.count_fallback(NO_OTHER_STANCE)
            else:
                pitches = self.stance_pitch + np.linspace(-LARGEST_TILT_RAD, LARGEST_TILT_RAD, STANCES)
                goals = np.array([self.choice.aim(self.choice.target, pitch) for pitch in pitches])
                plan, late = plan.with_stance(slopes), LateStance(pitches, goals)
        # The goal was chosen with all that was known before the jump. Where no goal is expected to land on the target,
        # shifts must not try it either: their effect is known less there.
        goal = self.goal
        desired = target_pose(self.choice.target) if feedback is None else feedback.expect(goal, self.stance_pitch)
        self.shift_tracker = ShiftTracker(
            plan,
            self.robot,
            self.gains,
            settings.config,
            self.goal,
            self.stance_pitch,
            desired,
            None if feedback is None else feedback.planned_to(self.goal),
            settings.exploration,
            late=late,
        )
        self.shift_tracker.fallbacks, self.shift_tracker.substituted = self.fallbacks, self.substituted
        return self.shift_tracker

    def command(self, estimate: StateEstimate) -> Command:
        """See ``GoalDirectedJump``; goal and stance are those that were measured late, where they were."""
        command = super().command(estimate)
        if self.shift_tracker is not None:
            self.goal, self.stance_pitch = self.shift_tracker.goal, self.shift_tracker.stance_pitch
        return command


def shifted_plan(planner: JumpPlanner, solution: Solution, reference: Reference, robot: Robot) -> ShiftedPlan | None:
    """The plan and its slopes; where a neighbour on one side has no plan, that on the other side is taken."""
    problem = solution.problem
    target, goal = problem.target, landing_goal(problem)
    neighbours, steps = [], []
    for axis, size in enumerate(NEIGHBOUR_STEPS):
        for step in (size, -size):
            moved = goal + step * np.eye(GOAL_AXES)[axis]
            neighbour = planner.plan(target, moved, problem.stance_pitch_rad, problem.robot)
            if neighbour is not None:
                neighbours.append(Reference.of(to_jump(neighbour), robot))
                steps.append(step)
                break
    return ShiftedPlan.of(reference, neighbours, steps) if len(steps) == GOAL_AXES else None


def stance_slopes(
    planner: JumpPlanner, solution: Solution, reference: Reference, robot: Robot
) -> dict[str, np.ndarray] | None:
    """Slopes of the plan by the pitch of the stance, (rows, n) for each quantity, per rad; None without a neighbour."""
    problem = solution.problem
    goal = landing_goal(problem)
    for step in STANCE_STEPS:
        tilted = planner.plan(problem.target, goal, problem.stance_pitch_rad + step, problem.robot)
        if tilted is not None:
            return differences(reference, Reference.of(to_jump(tilted), robot), step)
    return None


@dataclass(frozen=True)
class GoalShiftMethod(Method):
    """Goal-shift MPC along plans from the measured stance to the goal that the model says will land on the target."""

    planner: JumpPlanner | None = None
    feedback: LandingFeedback | None = None  # None: the goal is not shifted, but for exploration
    config: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))  # Added to each goal, to explore; m, m, rad
    exploration: np.ndarray | None = None  # Added to the shifts, (updates, 3), m, m, rad

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured, and shifted on the way."""
        landing = None if self.feedback is None else self.feedback.landing
        return GoalShiftJump(goal_choice(task, self.planner, landing, self.goal_offset), reference, self)
