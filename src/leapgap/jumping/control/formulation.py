"""The MPC's problem at each update: in states as measured (paper), or in deviations from the plan."""

from abc import ABC, abstractmethod

import numpy as np

from leapgap.jumping.control.condensed_qp import PreparedQp, prepare_qp
from leapgap.jumping.control.first_step_model import FirstStep, Uncompiled, first_step
from leapgap.jumping.control.horizon import ROUNDING_S, Horizon, horizon
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.models.affine_model import AffineModel, PredictionModel, Situation
from leapgap.jumping.models.deviation_model import CURVATURE, DeviationModel, PlannedSteps
from leapgap.logs.pair_force import FORCES


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
        self._first: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def prepare(self, time_s: float) -> PreparedQp:
        """The model of every step; at a planned force it is that of no departure from it."""
        steps = horizon(self.config.grid, self.reference.schedule, time_s)
        affine = along_plan(self.model, self.reference, steps)
        assert affine.by_state is not None
        constant = np.concatenate([affine.bias[0], affine.by_force[0].ravel()])
        self._first[round(time_s * 1e6)] = constant, affine.by_state[0].T.copy()
        return self.problem(steps, affine.at(slice(1, None)), np.zeros((len(steps), 6)), CURVATURE)

    def start(self, time_s: float, state: np.ndarray) -> np.ndarray:
        """The measured state less that of the plan at this time, (6,)."""
        return state - self.reference.state[self.reference.row(time_s)]

    def first_step(self, compiled: bool) -> FirstStep:
        """Of the deviation: h + C e is known once it is measured."""

        del compiled

        def at(state: np.ndarray, foot: np.ndarray, time_s: float) -> np.ndarray:
            del foot
            constant, by_state = self._first[round(time_s * 1e6)]
            found = constant.copy()
            found[:3] += state @ by_state
            return found

        return at


def along_plan(model: DeviationModel, reference: Reference, steps: Horizon) -> AffineModel:
    """The model of each step in deviations of the state and in forces on the ground, not their deviations."""
    begin = steps.time_s[:-1]
    planned = PlannedSteps(
        begin, steps.time_s[1:], reference.foot[reference.rows(begin)], steps.share > 0, reference.target
    )
    affine = model.along(planned)
    force = reference.mean_force(steps.time_s)
    return AffineModel(affine.bias - np.einsum("nij,nj->ni", affine.by_force, force), affine.by_force, affine.by_state)


NO_STEP = AffineModel(np.zeros((0, 3)), np.zeros((0, 3, FORCES)))
