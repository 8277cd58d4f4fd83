"""MPC of the ground forces: from the present state to the forces of the horizon, or to a fallback with its reason."""

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from leapgap.jumping.control.condensed_qp import PreparedQp, prepare_qp
from leapgap.jumping.control.first_step_model import FirstStep, Uncompiled, first_step
from leapgap.jumping.control.guarded_solve import NOT_FINITE, guarded_solve
from leapgap.jumping.control.horizon import ROUNDING_S, Horizon, horizon
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.qp import Qp, QpSolution, QpSolver, solver
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.learning.windows import MOST_STEPS
from leapgap.jumping.models.affine_model import AffineModel, PredictionModel, Situation
from leapgap.jumping.models.deviation_model import CURVATURE, DeviationModel, PlannedSteps
from leapgap.jumping.models.rigid_body import PITCH, advance
from leapgap.logs.pair_force import FORCES, per_axis


class Formulation(ABC):
    """States of the problem, and the model of each step."""

    reference: Reference
    config: "MpcConfig"

    @abstractmethod
    def prepare(self, time_s: float) -> PreparedQp:
        """All of an update's problem that no measurement is needed for."""

    def start(self, time_s: float, state: np.ndarray) -> np.ndarray:
        """The problem's first state from the measured one, (6,)."""
        del time_s
        return state

    @abstractmethod
    def first_step(self, compiled: bool) -> FirstStep:
        """The model of the first step."""

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

    def __init__(self, reference: Reference, model: PredictionModel, config: "MpcConfig") -> None:
        self.reference, self.model, self.config = reference, model, config

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

    def first_step(self, compiled: bool) -> FirstStep:
        """The model at the measured state."""
        return first_step(self.model) if compiled else Uncompiled(self.model)


class AlongPlan(Formulation):
    """In deviations from the plan; forces stay those on the ground. All of its models are constants of the jump."""

    def __init__(self, reference: Reference, model: DeviationModel, config: "MpcConfig") -> None:
        self.reference, self.model, self.config = reference, model, config
        self.first_models: dict[int, tuple[np.ndarray, np.ndarray]] = {}

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
        self.first_models[round(time_s * 1e6)] = constant, affine.by_state[0].T.copy()
        return self.problem(steps, affine.at(slice(1, None)), self.wanted(steps.time_s[1:]), CURVATURE)

    def start(self, time_s: float, state: np.ndarray) -> np.ndarray:
        """The measured state less that of the plan at this time, (6,)."""
        return state - self.reference.state[self.reference.row(time_s)]

    def first_step(self, compiled: bool) -> FirstStep:
        """Of the deviation: h + C e is known once it is measured."""

        del compiled

        def at(state: np.ndarray, foot: np.ndarray, time_s: float) -> np.ndarray:
            del foot
            constant, by_state = self.first_models[round(time_s * 1e6)]
            found = constant.copy()
            found[:3] += state @ by_state
            return found

        return at


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
    force: np.ndarray
    """Front x z, rear x z on the robot, N, constant during each step, (n, 4)."""
    solution: QpSolution | None = None
    fallback: str | None = None
    """Why this update has no usable solution, or None."""

    def at(self, time_s: float) -> np.ndarray:
        """Force planned for a moment, (4,); zero outside of the horizon."""
        step = int(np.searchsorted(self.horizon.time_s, time_s + ROUNDING_S, side="right")) - 1
        return self.force[step] if 0 <= step < len(self.force) else np.zeros(FORCES)


class Solved(NamedTuple):
    """Result of an update: its variables (n,), the solver's solution if any, and why it must not be used, or None."""

    x: np.ndarray | None
    solution: QpSolution | None
    fault: str | None


class ForcePlanner:
    """Solves the MPC's problem along one reference with one prediction model.

    Everything that does not depend on the measured state is computed beforehand, for every update of the jump.
    """

    compiled: ClassVar[bool] = False

    def __init__(
        self,
        reference: Reference,
        model: PredictionModel | DeviationModel,
        config: MpcConfig,
        clock: Callable[[], float] = time.perf_counter,
        qp_solver: QpSolver | None = None,
    ) -> None:
        self.reference, self.config, self.clock = reference, config, clock
        along = isinstance(model, DeviationModel)
        self.formulation = (AlongPlan if along else AsMeasured)(reference, model, config)  # type: ignore[arg-type]
        self.first_step = self.formulation.first_step(self.compiled)
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
        x, solution, fault = self._solve(time_s, prepared, state, foot)
        if fault is None and x is not None:
            self._good = ForcePlan(prepared.horizon, prepared.forces(x), solution)
            return self._good
        reason = fault or NOT_FINITE
        self.fallbacks[reason] += 1
        return ForcePlan(prepared.horizon, self._substitute(prepared.horizon), solution, reason)

    def _solve(self, time_s: float, prepared: PreparedQp, state: np.ndarray, foot: np.ndarray) -> Solved:
        """Solve the update of this time from a measured state and feet."""
        result = guarded_solve(
            lambda: self._problem(time_s, prepared, state, foot), self.solver, self.config.demands, self.clock
        )
        return Solved(None if result.solution is None else result.solution.x, result.solution, result.fault)

    def _problem(self, time_s: float, prepared: PreparedQp, state: np.ndarray, foot: np.ndarray) -> Qp | None:
        if not (np.isfinite(state).all() and np.isfinite(foot).all()):
            return None
        start = self.formulation.start(time_s, state)
        model = self.first_step(start, foot, time_s)
        return prepared.qp(start, AffineModel(model[None, :3], model[3:].reshape(1, 3, FORCES)))

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
