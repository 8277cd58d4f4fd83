"""The force planner with compiled updates: the same plans, from tables of every update (``dual_qp``)."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from leapgap.jumping.control.compiler import require_compiler
from leapgap.jumping.control.condensed_qp import PreparedQp
from leapgap.jumping.control.dual_qp import (
    FAILED,
    INACCURATE,
    NOT_FINITE,
    SOLVED,
    DualTables,
    dual_tables,
    solve_update,
)
from leapgap.jumping.control.guarded_solve import NOT_FINITE as REASON_NOT_FINITE
from leapgap.jumping.control.mpc import ForcePlanner, Solved, microseconds
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.qp import FAILED as REASON_FAILED
from leapgap.jumping.control.qp import OUT_OF_TIME
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.models.affine_model import PredictionModel
from leapgap.jumping.models.deviation_model import DeviationModel

FAULTS = {SOLVED: None, NOT_FINITE: REASON_NOT_FINITE, INACCURATE: "inaccurate", FAILED: REASON_FAILED}


class CompiledPlanner(ForcePlanner):
    """Plans as ``ForcePlanner`` with an exact solver does, to rounding; everything is compiled when it is made."""

    compiled = True

    def __init__(
        self,
        reference: Reference,
        model: PredictionModel | DeviationModel,
        config: MpcConfig,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        require_compiler("mpc.compiled")
        super().__init__(reference, model, config, clock)
        self._tables = {key: update_tables(self, key / 1e6, ready).arguments for key, ready in self.prepared.items()}

    def _solve(self, time_s: float, prepared: PreparedQp, state: np.ndarray, foot: np.ndarray) -> Solved:
        """See ``ForcePlanner``."""
        deadline_s = self.config.demands.deadline_s
        began = 0.0 if deadline_s is None else self.clock()
        tables = self._tables.get(microseconds(time_s)) or update_tables(self, time_s, prepared).arguments
        state, foot = np.array(self.formulation.start(time_s, state), float), np.array(foot, float)  # as compiled for
        model = self.first_step(state, foot, time_s)
        if deadline_s is not None and self.clock() - began >= deadline_s:
            return Solved(None, None, OUT_OF_TIME)
        status, x, _, _ = solve_update(state, foot, model, self.config.qp.max_iterations, *tables)
        if deadline_s is not None and self.clock() - began > deadline_s:
            return Solved(None, None, OUT_OF_TIME)
        return Solved(x, None, FAULTS[status])


def update_tables(planner: ForcePlanner, time_s: float, prepared: PreparedQp) -> DualTables:
    """What ``solve_update`` needs for one update; at first those rows are active that are so at the reference."""
    demands, reference = planner.config.demands, planner.reference
    row = reference.row(time_s)
    tables = dual_tables(prepared, demands.primal_tolerance_n, demands.relative_dual_tolerance)
    state, foot = planner.formulation.start(time_s, reference.state[row]).copy(), reference.foot[row].copy()
    model = planner.first_step(state, foot, time_s)
    status, _, active, size = solve_update(state, foot, model, planner.config.qp.max_iterations, *tables.arguments)
    return replace(tables, start=active[:size].copy()) if status == SOLVED else tables
