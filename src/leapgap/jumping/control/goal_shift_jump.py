"""Carries out a plan while its goal is shifted: the controller of a jump with goal-shift MPC."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.condensed_qp import ROUNDING_S
from leapgap.jumping.control.goal_shift_mpc import ChangeWatch, GoalShiftConfig, GoalShiftPlanner, LandingPredictor
from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.control.qp import NOT_FINITE, Qp, QpConfig, SolutionRequirements, guarded_solve, solver
from leapgap.jumping.control.shifted_plan import GOAL_AXES, DeviationRecorder, Observation, ShiftedPlan, ShiftGrid
from leapgap.jumping.control.tracking import JumpController, PhaseGains
from leapgap.jumping.models.rigid_body import Z
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class LateStance:
    """How long a stance is measured, and where the jump goes from it."""

    pitches: np.ndarray  # Pitches of the ground under the feet, rising, (p,), rad, nose-down; others are not believed
    goals: np.ndarray  # Goal of a jump from each of them, (p, 3), m, m, rad; linear in between
    until_s: float = 0.049
    """Estimates before this time since the start are used. It is a tick before an update, so that choosing the goal and
    solving the first program for it do not come in one tick."""
    reach_s: float = 0.05  # Time in which the plan from the measured stance is reached

    def goal(self, pitch: float) -> np.ndarray | None:
        """Goal of a jump from a stance, (3,); None where there is no such ground."""
        if not self.pitches[0] <= pitch <= self.pitches[-1]:
            return None
        return np.array([np.interp(pitch, self.pitches, self.goals[:, axis]) for axis in range(GOAL_AXES)])


@dataclass(frozen=True)
class Transition:
    """The way from the plan of the expected stance to that of the measured one, linear in time."""

    change: np.ndarray  # Change of goal and stance, (4,), m, m, rad, rad
    begin_s: float
    lasts_s: float

    def share(self, time_s: float) -> float:
        """Share of the way that is gone at a time since the start of the jump, s."""
        return float(np.clip((time_s - self.begin_s) / self.lasts_s, 0, 1))

    def move(self, shift: np.ndarray, time_s: float) -> np.ndarray:
        """Shift of goal and stance, (4,), with a shift (3,) of the goal on the way."""
        return np.append(shift, 0.0) + self.share(time_s) * self.change

    def rate(self, rate: np.ndarray, time_s: float) -> np.ndarray:
        """Rate of that per s, (4,), with a rate (3,) of the goal's shift."""
        return np.append(rate, 0.0) + (self.share(time_s) < 1) / self.lasts_s * self.change


def ground_pitch(estimate: StateEstimate, legs: LegKinematics) -> float:
    """Pitch of the ground under a robot that stands, rad, nose-down: the slope from the rear to the front feet.

    Feet by forward kinematics of the measured joints and attitude.
    """
    front, rear = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
    return float(-np.arctan2(front[2] - rear[2], np.hypot(*(front - rear)[:2])))


QP = QpConfig(primal_tolerance=1e-9)
"""Shifts are metres, and a joint torque may change by 100 N·m per metre: the solver's tolerance must be finer than for
forces in N."""


class ShiftTracker(JumpController):
    """Joint PD and feed-forward along a plan whose goal moves; each update's shift is reached linearly within it.

    ``shifts`` (updates, 3) are the shifts from each update on.
    """

    def __init__(
        self,
        plan: ShiftedPlan,
        robot: Robot,
        gains: PhaseGains,
        config: GoalShiftConfig,
        goal: np.ndarray,
        stance_pitch: float,
        target: np.ndarray,
        model: LandingPredictor | None,
        exploration: np.ndarray | None = None,
        late: LateStance | None = None,
    ) -> None:
        """``goal`` (3,) of the plan, ``target`` (3,) of the landing. Without a model nothing but ``exploration``
        (updates, 3), added to the shifts, moves the goal. With ``late`` the plan has slopes by the stance, the first
        updates wait until the stance is measured, and goal and target follow from it."""
        super().__init__(plan.reference, robot, gains)
        self.plan, self.config, self.goal, self.stance_pitch = plan, config, goal, stance_pitch
        self.grid = ShiftGrid(plan.reference.schedule, config.period_s, config.steps, config.on_rear_feet)
        self.model = model
        self.planner = None if model is None else GoalShiftPlanner(plan, model, target, config)
        if self.planner is not None:
            self.planner.prepare()
        self.solver = solver(QP)
        self.watch = None if model is None else ChangeWatch(model.calm, config.sudden)
        shape = (self.grid.updates, GOAL_AXES)
        self.exploration = np.zeros(shape) if exploration is None else exploration
        self.shifts = np.zeros(shape)
        self.recorder = DeviationRecorder(plan.reference, Observation(config.period_s, config.average_s))
        self._shift, self._rate = np.zeros(GOAL_AXES), np.zeros(GOAL_AXES)
        """Shift of this tick, and its rate per s; of the stance as well where that was measured late, (4,)."""
        self._updates = 0
        self.late = late  # What is still to be measured; None afterwards
        self._stances: list[tuple[float, float]] = []  # Pitch of the ground, rad, and height of the base, m
        self._transition: Transition | None = None

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N, of the shifted plan; an update first, where one is due."""
        if self.late is not None:
            frame = self._measure_stance(self.late, time_s, estimate, frame)
        update = self.recorder.update_at(time_s)
        before = self.shifts[update - 1] if update else np.zeros(GOAL_AXES)
        since_s = time_s - update * self.config.period_s
        share = min(since_s / self.config.period_s, 1.0)
        shift = before + share * (self.shifts[update] - before)
        self._shift = shift if self._transition is None else self._transition.move(shift, time_s)
        if time_s <= self.reference.schedule.take_off_s:
            row = self.reference.row(time_s)
            state = frame.state(estimate) - self.plan.at("state", row, self._shift)
            foot = frame.foot(estimate, self.legs) - self.plan.at("foot", row, self._shift)
            self.recorder.measure(np.concatenate([state, foot]))
        if update >= self._updates:
            self._updates = update + 1
            self._update(update, before)
        elif self.planner is not None:
            self.planner.prepare_ahead(update)
        rate = (self.shifts[update] - before) / self.config.period_s * (share < 1.0)
        self._rate = rate if self._transition is None else self._transition.rate(rate, time_s)
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        torque, force = self.plan.at("torque", row, self._shift), self.plan.at("force", row, self._shift)
        stands = self.reference.force[row] != 0
        return np.clip(torque, -self.config.torque_nm, self.config.torque_nm) * moving, force * stands * moving

    def set_points(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Set points (joints,), rad and rad/s, of the plan with the shift that ``feed_forward`` used."""
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        velocity = self.plan.at("joint_vel", row, self._shift)
        velocity = velocity + self._rate @ self.plan.slopes["joint_pos"][: len(self._rate), row]
        return self.plan.at("joint_pos", row, self._shift), velocity * moving

    def _measure_stance(
        self, late: LateStance, time_s: float, estimate: StateEstimate, frame: StartFrame
    ) -> StartFrame:
        """Take in a whole estimate; at the end choose goal and target for the mean stance.

        Returns the frame to count from.
        """
        if time_s < late.until_s - ROUNDING_S:
            if np.isfinite([*estimate.base_position, *estimate.base_quaternion, *estimate.joint_pos]).all():
                self._stances.append((ground_pitch(estimate, self.legs), float(estimate.base_position[2])))
            return frame
        self.late = None
        if not self._stances:
            return frame
        pitch, height_m = (sum(values) / len(values) for values in zip(*self._stances, strict=True))
        goal = late.goal(pitch)
        if goal is None:
            return frame
        change = np.append(goal - self.goal, pitch - self.stance_pitch)
        self.goal, self.stance_pitch = goal, pitch
        self._transition = Transition(change, time_s, late.reach_s)
        if self.model is not None and self.planner is not None:
            # The goal was chosen for the target; shifts correct what happens otherwise than expected of that goal.
            self.model = self.model.planned_to(goal)
            self.planner = self.planner.moved(self.model, self.model.expect(goal, self.stance_pitch), change)
        # The ground under the feet may be higher than that ahead: it is no deviation from the plan.
        level_m = height_m - float(self.plan.at("state", 0, change)[Z])
        self.frame = replace(frame, level_m=level_m)
        return self.frame

    def _update(self, update: int, before: np.ndarray) -> None:
        """Choose the shift from this update on: the one before, until something sudden has happened."""
        deviation = self.recorder.keep(update)
        explored = self.exploration[update] - (self.exploration[update - 1] if update else 0.0)
        self.shifts[update:] = before + explored
        if self.watch is None or self.late is not None:
            return
        since = self.watch.since(update, deviation)
        if not np.isfinite(deviation).all():
            self.count_fallback(NOT_FINITE)
        elif since is not None and update < self.grid.free_updates:
            result = guarded_solve(self._problem(update, before, since), self.solver, SolutionRequirements())
            if result.x is not None:
                self.shifts[update:] += result.x[:GOAL_AXES]
            else:
                self.count_fallback(result.fault)

    def _problem(self, update: int, before: np.ndarray, since: np.ndarray) -> Qp:
        assert self.model is not None and self.planner is not None and self.watch is not None
        authority = self.model.authority
        landing = self.model.expect(self.goal, self.stance_pitch) + self.model.change(update, self.watch.age, since)
        landing = landing + np.einsum("tij,tj->i", authority[:update], self.shifts[:update])
        landing += authority[update:].sum(axis=0) @ before
        return self.planner.problem(update, landing, before)
