"""Carries out a plan while its goal is shifted: the controller of a jump with goal-shift MPC."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.jumping.control.deviation_recorder import DeviationRecorder, Observation
from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig, GoalShiftPlanner, LandingPredictor, believe
from leapgap.jumping.control.guarded_solve import NOT_FINITE, SolutionRequirements, guarded_solve
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.qp import Qp, QpConfig, solver
from leapgap.jumping.control.reference import StartFrame
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.shifted_plan import GOAL_AXES, QUANTITIES, ShiftedPlan
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.models.rigid_body import Z
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

QP = QpConfig(primal_tolerance=1e-9)
"""Shifts are metres, and a joint torque may change by 100 N·m per metre: the solver's tolerance must be finer than for
forces in N."""


@dataclass(frozen=True)
class LateStance:
    """The stance that a robot could not measure before its jump, and what becomes of the jump then."""

    pitch: float
    """Of the ground under the feet, rad, nose-down."""
    plan: ShiftedPlan
    """The plan from that stance."""
    goal: np.ndarray
    """Its goal, (3,)."""
    target: np.ndarray
    """Where the jump shall land, (3,)."""
    model: LandingPredictor | None
    """What predicts the landing of a jump to that goal."""


@dataclass(frozen=True)
class StanceMeasurement:
    """How a robot that could not measure its stance before the jump does so at its beginning, while all feet stand."""

    decide: Callable[[Sequence[StateEstimate]], LateStance | None]
    """None: the estimates are of no ground that a robot jumps from."""
    until_s: float = 0.05
    """Estimates up to this time since the start are used."""
    reach_s: float = 0.05
    """Time in which the plan from the measured stance is reached."""


@dataclass(frozen=True)
class Transition:
    """The way from one plan to the next one, linear in time."""

    missing: dict[str, np.ndarray]
    """The next plan − the one before, (rows, n) for each quantity."""
    begin_s: float
    lasts_s: float

    @staticmethod
    def between(before: ShiftedPlan, after: ShiftedPlan, begin_s: float, lasts_s: float) -> "Transition":
        """The way from ``before`` to ``after``."""
        missing = {name: getattr(after.reference, name) - getattr(before.reference, name) for name in QUANTITIES}
        return Transition(missing, begin_s, lasts_s)

    def share(self, time_s: float) -> float:
        """Share of the way that is left at a time since the start of the jump, s."""
        return float(np.clip(1 - (time_s - self.begin_s) / self.lasts_s, 0, 1))

    def rate(self, time_s: float) -> float:
        """Change of that share per s."""
        return -1 / self.lasts_s if self.share(time_s) > 0 else 0.0


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
        clock: Callable[[], float] = time.perf_counter,
        measurement: StanceMeasurement | None = None,
    ) -> None:
        """``goal`` (3,) of the plan, ``target`` (3,) of the landing. Without a model nothing but ``exploration``
        (updates, 3), added to the shifts, moves the goal. With ``measurement`` the first updates wait for it, and
        all else follows from the stance that it finds."""
        super().__init__(plan.reference, robot, gains)
        self.plan, self.config, self.goal, self.stance_pitch = plan, config, goal, stance_pitch
        self.grid = ShiftGrid(plan.reference.schedule, config.period_s, config.steps, config.on_rear_feet)
        self.model, self.clock = model, clock
        self.planner = None if model is None else GoalShiftPlanner(plan, model, target, config)
        self.solver = solver(QP)
        shape = (self.grid.updates, GOAL_AXES)
        self.exploration = np.zeros(shape) if exploration is None else exploration
        self.shifts = np.zeros(shape)
        self.recorder = DeviationRecorder(plan.reference, Observation(config.period_s, config.average_s))
        self._shift, self._rate = np.zeros(GOAL_AXES), np.zeros(GOAL_AXES)
        """Shift of this tick, and its rate per s."""
        self._updates = 0
        self._measurement = measurement
        self._stood: list[StateEstimate] = []
        self._transition: Transition | None = None
        self._time_s = 0.0

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N, of the shifted plan; an update first, where one is due."""
        self._time_s = time_s
        if self._measurement is not None:
            self._measure_stance(self._measurement, time_s, estimate)
        update = self.recorder.update_at(time_s)
        before = self.shifts[update - 1] if update else np.zeros(GOAL_AXES)
        since_s = time_s - update * self.config.period_s
        share = min(since_s / self.config.period_s, 1.0)
        shift = before + share * (self.shifts[update] - before)
        if time_s <= self.reference.schedule.take_off_s:
            self._measure(time_s, estimate, frame, shift)
        if update >= self._updates:
            self._updates = update + 1
            self._update(update, before)
        self._shift = shift
        self._rate = (self.shifts[update] - before) / self.config.period_s * (share < 1.0)
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        torque, force = self._at("torque", row, shift), self._at("force", row, shift)
        stands = self.reference.force[row] != 0
        return np.clip(torque, -self.config.torque_nm, self.config.torque_nm) * moving, force * stands * moving

    def set_points(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Set points (joints,), rad and rad/s, of the plan with the shift that ``feed_forward`` used."""
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        velocity = self._at("joint_vel", row, self._shift) + self._rate @ self.plan.slopes["joint_pos"][:, row]
        if self._transition is not None:
            velocity -= self._transition.rate(self._time_s) * self._transition.missing["joint_pos"][row]
        return self._at("joint_pos", row, self._shift), velocity * moving

    def _at(self, quantity: str, row: int, shift: np.ndarray) -> np.ndarray:
        """A quantity of the shifted plan at this tick, (n,), on the way to the plan from a stance measured late."""
        values = self.plan.at(quantity, row, shift)
        if self._transition is None:
            return values
        return values - self._transition.share(self._time_s) * self._transition.missing[quantity][row]

    def _measure_stance(self, measurement: StanceMeasurement, time_s: float, estimate: StateEstimate) -> None:
        """Collect estimates until the stance is known; then take the plan and the model from that stance."""
        if time_s < measurement.until_s - ROUNDING_S:
            if np.isfinite([*estimate.base_position, *estimate.base_quaternion, *estimate.joint_pos]).all():
                self._stood.append(estimate)
            return
        self._measurement = None
        found = measurement.decide(self._stood) if self._stood else None
        if found is None:
            return
        if self.frame is not None:
            # The ground under the feet may be higher than that ahead: it is no deviation from the plan.
            height = np.mean([one.base_position[2] for one in self._stood])
            self.frame = replace(self.frame, level_m=float(height - found.plan.reference.state[0, Z]))
        self._transition = Transition.between(self.plan, found.plan, time_s, measurement.reach_s)
        self.plan, self.goal, self.stance_pitch, self.model = found.plan, found.goal, found.pitch, found.model
        self.planner = (
            None if self.model is None else GoalShiftPlanner(self.plan, self.model, found.target, self.config)
        )

    @property
    def deviations(self) -> np.ndarray:
        """How far trunk and feet were from the shifted plan at each update, (updates, 10)."""
        return self.recorder.deviations

    @property
    def kept_rows(self) -> int:
        """Number of ticks that a deviation is averaged over."""
        return self.recorder.kept_rows

    def _measure(self, time_s: float, estimate: StateEstimate, frame: StartFrame, shift: np.ndarray) -> None:
        """Take in the deviation of trunk and feet from the shifted plan."""
        row = self.reference.row(time_s)
        state = frame.state(estimate) - self._at("state", row, shift)
        foot = frame.foot(estimate, self.legs) - self._at("foot", row, shift)
        self.recorder.measure(np.concatenate([state, foot]))

    def _update(self, update: int, before: np.ndarray) -> None:
        """Choose the shift from this update on: the first of the QP's, or the one before where it has none."""
        deviation = self.recorder.keep(update)
        explored = self.exploration[update] - (self.exploration[update - 1] if update else 0.0)
        self.shifts[update:] = before + explored
        if self.model is None or self.planner is None or self._measurement is not None:
            return
        result = guarded_solve(
            lambda: self._problem(update, before, deviation), self.solver, SolutionRequirements(), self.clock
        )
        if result.fault is None and result.solution is not None:
            self.shifts[update:] += result.solution.x[:GOAL_AXES]
            return
        self.count_fallback(result.fault or NOT_FINITE)

    def _problem(self, update: int, before: np.ndarray, deviation: np.ndarray) -> Qp | None:
        if not np.isfinite(deviation).all():
            return None
        assert self.model is not None and self.planner is not None
        goal = self.goal + before
        now = (update, goal, self.stance_pitch, deviation)
        authority = self.model.authority
        expected = self.model.expect(self.goal, self.stance_pitch)
        expected = expected + np.einsum("tij,tj->i", authority[:update], self.shifts[:update])
        expected += authority[update:].sum(axis=0) @ before
        landing = believe(expected, self.model.predict(*now), self.model.spread(*now), self.config.disbelief)
        return self.planner.problem(update, landing, before)
