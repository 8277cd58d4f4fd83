"""The force planner with compiled updates: the same plans, from tables of every update (``dual_qp``)."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leapgap.jumping.control.compiler import require_compiler
from leapgap.jumping.control.condensed_qp import PreparedQp
from leapgap.jumping.control.dual_qp import FAILED, INACCURATE, NOT_FINITE, SOLVED, dual_tables, solve_update
from leapgap.jumping.control.first_step_model import first_step
from leapgap.jumping.control.guarded_solve import NOT_FINITE as REASON_NOT_FINITE
from leapgap.jumping.control.mpc import ForcePlanner, MpcConfig, Solved, microseconds
from leapgap.jumping.control.qp import FAILED as REASON_FAILED
from leapgap.jumping.control.qp import OUT_OF_TIME
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.models.affine_model import PredictionModel

FAULTS = {SOLVED: None, NOT_FINITE: REASON_NOT_FINITE, INACCURATE: "inaccurate", FAILED: REASON_FAILED}


class CompiledPlanner(ForcePlanner):
    """Plans as ``ForcePlanner`` with an exact solver does, to rounding; everything is compiled when it is made."""

    def __init__(
        self,
        reference: Reference,
        model: PredictionModel,
        config: MpcConfig,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        require_compiler("mpc.compiled")
        super().__init__(reference, model, config, clock)
        self._first_step = first_step(model)
        self._tables = {key: self._update_tables(ready) for key, ready in self._prepared.items()}

    def _solve(self, ready: PreparedQp, state: np.ndarray, foot: np.ndarray) -> Solved:
        """See ``ForcePlanner``."""
        deadline_s, began = self.config.demands.deadline_s, self.clock()
        time_s = float(ready.horizon.time_s[0])
        tables = self._tables.get(microseconds(time_s)) or self._update_tables(ready)
        state, foot = np.array(state, float), np.array(foot, float)  # of the layout that was compiled for
        model = self._first_step(state, foot, time_s)
        if deadline_s is not None and self.clock() - began >= deadline_s:
            return Solved(None, None, OUT_OF_TIME)
        status, x, *_ = solve_update(state, foot, model, self.config.qp.max_iterations, *tables)
        if deadline_s is not None and self.clock() - began > deadline_s:
            return Solved(None, None, OUT_OF_TIME)
        return Solved(x, None, FAULTS[status])

    def _update_tables(self, ready: PreparedQp) -> tuple[np.ndarray, ...]:
        """Arguments of ``solve_update``; at first those rows are active that are so at the reference."""
        demands = self.config.demands
        tables = dual_tables(ready, demands.primal_tolerance_n, demands.relative_dual_tolerance)
        time_s = float(ready.horizon.time_s[0])
        row = self.reference.row(time_s)
        state, foot = self.reference.state[row].copy(), self.reference.foot[row].copy()
        model = self._first_step(state, foot, time_s)
        status, _, active, size = solve_update(state, foot, model, self.config.qp.max_iterations, *tables.arguments)
        return replace(tables, start=active[:size].copy()).arguments if status == SOLVED else tables.arguments
