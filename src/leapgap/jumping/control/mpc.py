"""MPC of the ground forces: from the present state to the forces of the horizon, or to a fallback with its reason."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from leapgap.jumping.control.condensed_qp import ROUNDING_S, ForceLimits, Horizon, PreparedQp, horizon, prepare_qp
from leapgap.jumping.control.leg_kinematics import StartFrame
from leapgap.jumping.control.qp import (
    Qp,
    QpConfig,
    QpSolution,
    QpSolver,
    SolutionRequirements,
    guarded_solve,
    solver,
)
from leapgap.jumping.control.tracking import JumpController, PhaseGains, Reference
from leapgap.jumping.learning.windows import MOST_STEPS, TimeGrid
from leapgap.jumping.models.rigid_body import (
    CURVATURE,
    PITCH,
    AffineModel,
    DeviationModel,
    PlannedSteps,
    PredictionModel,
    Situation,
    advance,
)
from leapgap.logs.pair_force import FORCES, per_axis
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class StateWeights:
    """Diagonal of Q: how much a deviation from the reference costs, by state; as used on the robot."""

    x: float = 50.0
    z: float = 2.5
    pitch: float = 50.0
    vx: float = 10.0
    vz: float = 0.2
    pitch_rate: float = 10.0

    @property
    def diagonal(self) -> np.ndarray:
        """The weights in the order of the state, (6,)."""
        return np.array([self.x, self.z, self.pitch, self.vx, self.vz, self.pitch_rate])


@dataclass(frozen=True)
class MpcConfig:
    """Settings of the MPC, as published."""

    grid: TimeGrid = field(default_factory=TimeGrid)
    period_s: float = 0.025  # Time between updates; the first force is held in between
    weights: StateWeights = field(default_factory=StateWeights)
    landing_weights: StateWeights | None = None
    """In place of ``weights`` at the planned landing, where the horizon reaches it; None: the same there."""
    force_weight: float = 1e-6  # Cost of a force's difference from the reference, per N²
    to_expected: bool = False
    """Whether the MPC aims at what a model of the deviation expects of the plan alone, not at the plan: the goal was
    chosen for that."""
    limits: ForceLimits = field(default_factory=ForceLimits)
    qp: QpConfig = field(default_factory=QpConfig)
    demands: SolutionRequirements = field(default_factory=SolutionRequirements)
    plan_valid_s: float = 0.1  # An update without a solution uses the last plan if that is no older, else the reference

    def __post_init__(self) -> None:
        positive = (self.period_s, self.force_weight)
        weights = np.concatenate([one.diagonal for one in (self.weights, self.landing_weights) if one])
        if not (all(0 < one < np.inf for one in positive) and (weights >= 0).all() and np.isfinite(weights).all()):
            raise ValueError("period_s and force_weight finite and above 0, weights finite and not below 0")
        if not 0 <= self.plan_valid_s < np.inf:
            raise ValueError("plan_valid_s finite and not below 0")


class Formulation(ABC):
    """States of the problem, and the model of each step."""

    def __init__(self, reference: Reference, model: Any, config: MpcConfig) -> None:
        self.reference, self.model, self.config = reference, model, config
        self.first_models: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @abstractmethod
    def prepare(self, time_s: float) -> PreparedQp:
        """All of an update's problem that no measurement is needed for."""

    def start(self, time_s: float, state: np.ndarray) -> np.ndarray:
        """The problem's first state from the measured one, (6,)."""
        del time_s
        return state

    @abstractmethod
    def first_step(self, time_s: float, start: np.ndarray, foot: np.ndarray) -> AffineModel:
        """The model of the first step, from the problem's first state (6,) and measured feet (4,)."""

    def weights(self, steps: Horizon) -> np.ndarray:
        """Diagonal of Q at the end of each step, (n, 6): that of the landing where the horizon reaches it."""
        found = np.tile(self.config.weights.diagonal, (len(steps), 1))
        if self.config.landing_weights and steps.time_s[-1] > self.reference.schedule.landing_s - ROUNDING_S:
            found[-1] = self.config.landing_weights.diagonal
        return found

    def problem(self, steps: Horizon, later: AffineModel, target: np.ndarray, curvature: float) -> PreparedQp:
        """The QP with the plan's forces and the configured weights and limits."""
        config, force = self.config, self.reference.mean_force(steps.time_s)
        return prepare_qp(
            steps, later, target, force, self.weights(steps), config.force_weight, config.limits, curvature
        )


class AsMeasured(Formulation):
    """The paper's: later steps at the reference's states, the first one at the measured state."""

    def prepare(self, time_s: float) -> PreparedQp:
        """Evaluate model and reference at all but the first step, and compute their part of the QP."""
        reference = self.reference
        steps = horizon(self.config.grid, reference.schedule, time_s)
        rows = reference.rows(steps.time_s)
        later = rows[1:-1]
        start = np.tile(reference.state[rows[0]], (len(later), 1))
        there = Situation(reference.state[later], reference.foot[later], steps.time_s[1:-1], start)
        affine = self.model.affine(there, steps.contact[1:]) if len(later) else NO_STEP
        return self.problem(steps, affine, reference.state[rows[1:]], self.model.curvature)

    def first_step(self, time_s: float, start: np.ndarray, foot: np.ndarray) -> AffineModel:
        """The model at the measured state."""
        there = Situation(start[None], foot[None], np.array([time_s]), start[None])
        affine: AffineModel = self.model.affine(there, np.array([True]))
        return affine


class AlongPlan(Formulation):
    """In deviations from the plan; forces stay those on the ground. All of its models are constants of the jump."""

    @cached_property
    def expected(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of the whole jump, s, (n + 1,), and the deviation there that is expected of the plan, (n + 1, 6)."""
        steps = horizon(replace(self.config.grid, steps=MOST_STEPS), self.reference.schedule, 0.0)
        affine, force = along_plan(self.model, self.reference, steps), self.reference.mean_force(steps.time_s)
        found = [np.zeros(6)]
        for k, step_s in enumerate(steps.step_s):
            now = affine.at(slice(k, k + 1)).seen_from(found[-1][None])
            found.append(advance(found[-1], now.acceleration(force[k : k + 1])[0], step_s, CURVATURE))
        return steps.time_s, np.array(found)

    def wanted(self, times_s: np.ndarray) -> np.ndarray:
        """Deviation that is aimed at, at some times (n,), (n, 6): none, or the expected one."""
        if not self.config.to_expected:
            return np.zeros((len(times_s), 6))
        nodes, expected = self.expected
        return np.stack([np.interp(times_s, nodes, column) for column in expected.T], axis=1)

    def prepare(self, time_s: float) -> PreparedQp:
        """The model of every step; at a planned force it is that of no departure from it."""
        steps = horizon(self.config.grid, self.reference.schedule, time_s)
        affine = along_plan(self.model, self.reference, steps)
        assert affine.by_state is not None
        constant = np.concatenate([affine.bias[0], affine.by_force[0].ravel()])
        self.first_models[microseconds(time_s)] = constant, affine.by_state[0].T.copy()
        return self.problem(steps, affine.at(slice(1, None)), self.wanted(steps.time_s[1:]), CURVATURE)

    def start(self, time_s: float, state: np.ndarray) -> np.ndarray:
        """The measured state less that of the plan at this time, (6,)."""
        return state - self.reference.state[self.reference.row(time_s)]

    def first_step(self, time_s: float, start: np.ndarray, foot: np.ndarray) -> AffineModel:
        """Of the deviation: h + C e is known once it is measured."""
        del foot
        constant, by_state = self.first_models[microseconds(time_s)]
        bias = constant[:3] + start @ by_state
        return AffineModel(bias[None], constant[3:].reshape(1, 3, FORCES))


def along_plan(model: DeviationModel, reference: Reference, steps: Horizon) -> AffineModel:
    """The model of each step in deviations of the state and in forces on the ground, not their deviations."""
    begin = steps.time_s[:-1]
    planned = PlannedSteps(
        begin,
        steps.time_s[1:],
        reference.foot[reference.rows(begin)],
        steps.share > 0,
        reference.target,
        float(reference.state[0, PITCH]),
    )
    affine = model.along(planned)
    force = reference.mean_force(steps.time_s)
    return AffineModel(affine.bias - np.einsum("nij,nj->ni", affine.by_force, force), affine.by_force, affine.by_state)


NO_STEP = AffineModel(np.zeros((0, 3)), np.zeros((0, 3, FORCES)))


@dataclass(frozen=True)
class ForcePlan:
    """Forces of the steps of a horizon, and the solution they come from."""

    horizon: Horizon
    force: np.ndarray  # Front x z, rear x z on the robot, N, constant during each step, (n, 4)
    solution: QpSolution | None = None
    fallback: str | None = None  # Why this update has no usable solution, or None

    def at(self, time_s: float) -> np.ndarray:
        """Force planned for a moment, (4,); zero outside of the horizon."""
        step = int(np.searchsorted(self.horizon.time_s, time_s + ROUNDING_S, side="right")) - 1
        return self.force[step] if 0 <= step < len(self.force) else np.zeros(FORCES)


class ForcePlanner:
    """Solves the MPC's problem along one reference with one prediction model.

    Everything that does not depend on the measured state is computed beforehand, for every update of the jump.
    """

    def __init__(
        self,
        reference: Reference,
        model: PredictionModel | DeviationModel,
        config: MpcConfig,
        qp_solver: QpSolver | None = None,
    ) -> None:
        self.reference, self.config = reference, config
        formulation = AlongPlan if isinstance(model, DeviationModel) else AsMeasured
        self.formulation = formulation(reference, model, config)
        self.solver = qp_solver or solver(config.qp)
        self.fallbacks: Counter[str] = Counter()
        self._good: ForcePlan | None = None
        updates = np.arange(0.0, reference.schedule.take_off_s - ROUNDING_S, config.period_s)
        self.prepared = {microseconds(t): self.formulation.prepare(float(t)) for t in updates}

    def plan(self, time_s: float, state: np.ndarray, foot: np.ndarray) -> ForcePlan:
        """Plan at a time since the start from a measured state (6,) and foot − base (4,), both in the start frame."""
        if time_s > self.reference.schedule.take_off_s - ROUNDING_S:
            return ForcePlan(horizon(self.config.grid, self.reference.schedule, time_s), np.zeros((0, FORCES)))
        prepared = self.prepared.get(microseconds(time_s)) or self.formulation.prepare(time_s)
        problem = self.problem(time_s, prepared, state, foot)
        x, fault, solution = guarded_solve(problem, self.solver, self.config.demands)
        if x is not None:
            self._good = ForcePlan(prepared.horizon, prepared.forces(x), solution)
            return self._good
        self.fallbacks[fault] += 1
        return ForcePlan(prepared.horizon, self._substitute(prepared.horizon), solution, fault)

    def problem(self, time_s: float, prepared: PreparedQp, state: np.ndarray, foot: np.ndarray) -> Qp | None:
        """The QP of the update of this time from a measured state and feet; None where one of them is not finite."""
        if not (np.isfinite(state).all() and np.isfinite(foot).all()):
            return None
        start = self.formulation.start(time_s, state)
        return prepared.qp(start, self.formulation.first_step(time_s, start, foot))

    def _substitute(self, steps: Horizon) -> np.ndarray:
        """Fallback forces: the last plan shifted to these steps while it is valid, else the reference's forces."""
        good, begin = self._good, steps.time_s[:-1]
        planned = self.reference.mean_force(steps.time_s)
        if good is None or begin[0] - good.horizon.time_s[0] > self.config.plan_valid_s + ROUNDING_S:
            return planned
        within = begin < good.horizon.time_s[-1] - ROUNDING_S
        shifted = np.array([good.at(float(t)) for t in begin])
        return np.where(within[:, None], shifted, planned) * per_axis(steps.share > 0)


def microseconds(time_s: float) -> int:
    """A time as a whole number, to be used as a key."""
    return round(time_s * 1e6)


POSE_NOT_FINITE = "pose not finite"
PUSHING = {pairs: per_axis(np.array(pairs)) for pairs in product((False, True), repeat=2)}
"""Which of the four forces push, by the contact of the front and the rear pair."""


class JumpMpc(JumpController):
    """Plans at the MPC's period from the measured state, holds the first force, maps it to torques at every tick.

    Gravity, momentum and pitch are planned as a planar body along the heading of the start; ``model`` is the nominal
    ``RigidBodyModel``, a learned one, or one of the deviation from the plan. ``plan_now`` is the latest plan.
    """

    def __init__(
        self,
        reference: Reference,
        robot: Robot,
        gains: PhaseGains,
        model: PredictionModel | DeviationModel,
        config: MpcConfig,
    ) -> None:
        super().__init__(reference, robot, gains)
        self.config = config
        self.planner = ForcePlanner(reference, model, config)
        self.fallbacks = self.planner.fallbacks
        self.plan_now: ForcePlan | None = None
        self._updates = 0
        self._pose: tuple[np.ndarray, np.ndarray] | None = None

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """τ = −Jᵀ u of the first planned force, while the schedule has feet on the ground."""
        contact = self.reference.schedule.pairs_in_contact(time_s)
        if not any(contact):
            return self.zero_feed_forward()
        force = self._decided(time_s, estimate, frame) * PUSHING[contact]
        return self.legs.torque(*self._measured_pose(time_s, estimate), frame.in_world(force)), force

    def _decided(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> np.ndarray:
        """Force of the latest plan, (4,), N; an update first, where one is due."""
        if time_s > self._updates * self.config.period_s - ROUNDING_S:
            self._update(time_s, estimate, frame)
        assert self.plan_now is not None
        return self.plan_now.force[0]

    def _update(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> None:
        """Plan again; the next update is due at the next whole period."""
        self._updates = int((time_s + ROUNDING_S) / self.config.period_s) + 1
        self.plan_now = self.planner.plan(time_s, frame.state(estimate), frame.foot(estimate, self.legs))
        if self.plan_now.fallback is not None:
            self.substituted.append((time_s, self.plan_now.fallback))

    def _measured_pose(self, time_s: float, estimate: StateEstimate) -> tuple[np.ndarray, np.ndarray]:
        """Quaternion (4,) and joints (joints,), measured; where not finite, the last finite ones or the reference's."""
        pose = (estimate.base_quaternion, estimate.joint_pos)
        if math.isfinite(pose[0] @ pose[0] + pose[1] @ pose[1]):  # of limited size, by the border
            self._pose = pose
            return pose
        self.fallbacks[POSE_NOT_FINITE] += 1
        self.substituted.append((time_s, POSE_NOT_FINITE))
        if self._pose is not None:
            return self._pose
        return np.array([1.0, 0.0, 0.0, 0.0]), self.reference.joint_pos[self.reference.row(time_s)]


class DepartingMpc(JumpMpc):
    """The plan's own torques, which move the legs too and overcome what its joints are known to resist; the MPC adds
    what its forces depart from the plan's by."""

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N."""
        torque, force = self.planned(time_s)
        contact = self.reference.schedule.pairs_in_contact(time_s)
        if not any(contact):
            return torque, force
        decided = self._decided(time_s, estimate, frame)
        departs = (self.config.limits.within(force + decided - self._mean) - force) * PUSHING[contact]
        pose = self._measured_pose(time_s, estimate)
        return torque + self.legs.torque(*pose, frame.in_world(departs)), force + departs

    def _update(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> None:
        super()._update(time_s, estimate, frame)
        assert self.plan_now is not None
        self._mean = self.reference.mean_force(self.plan_now.horizon.time_s[:2])[0]
        """Of the plan over the first step, (4,), N."""
