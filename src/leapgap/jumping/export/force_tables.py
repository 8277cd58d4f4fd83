"""Everything that the learned MPC of one jump needs while it runs, as arrays and numbers; see ``tables``."""

from collections.abc import Sequence

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.compiled_planner import update_tables
from leapgap.jumping.control.condensed_qp import STATES
from leapgap.jumping.control.dual_qp import DualTables
from leapgap.jumping.control.mpc import AlongPlan
from leapgap.jumping.control.mpc_controller import DepartingMpc, JumpMpc
from leapgap.jumping.export.tables import IN_PLAN, ControllerTables, gain_tables, starts, with_body
from leapgap.jumping.models.deviation_model import CURVATURE, NominalDeviation
from leapgap.logs.pair_force import FORCES

MEANING = {
    "plan": "rows of the plan: joint set points, torques, forces, state, feet",
    "variables_of_update": "number of forces that are decided at each update",
    "firsts_of_update": "how many of them act in the first step",
    "variable_step": "step of the horizon that each of them acts in",
    "variable_force": "which it is: front x z, rear x z",
    "steps_of_update": "number of steps of the horizon",
    "edges_s": "begin of each step, and the end of the last one, s since the start of the jump",
    "planned_force": "mean force of the plan over the first step, N",
    "pushes_first": "whether each force acts in the first step",
    "first_step_s": "length of the first step, s",
    "first_push_s": "time for which each of its forces acts, s",
    "first_model": "accelerations x, z, pitch of the deviation in the first step: constant, then by each force",
    "first_by_state": "the same by the deviation of x, z, pitch and of their rates",
    "cost_to_go": "curvature of the cost by the state after the first step, later forces at their best",
    "slope_to_go": "its slope",
    "later_force": "later forces without limits, constant part, N",
    "later_by_state": "the same by the state after the first step",
    "later_inverse": "inverse curvature of the cost by the later forces",
    "cost": "curvature of the cost by the state after the first step and the later forces",
    "cost_slope": "its slope",
    "limits_of_update": "number of limits",
    "limit_variable": "the one or two forces of each limit",
    "limit_factor": "their factors; 0: none",
    "limit_bound": "what their sum must not exceed, N",
    "starts_of_update": "number of limits that are active at the plan",
    "start_row": "these limits",
}
"""What each table holds, beside those of all controllers."""


def force_tables_of(controller: JumpMpc) -> ControllerTables:
    """The tables of the learned MPC before its jump.

    In C, an update that comes late, because ticks were missed, uses the tables of the time at which it was due.
    """
    planner = controller.planner
    along = planner.formulation
    if not isinstance(along, AlongPlan) or isinstance(along.model, NominalDeviation):
        found = "a controller without a learned model of the deviation"
        raise InputError("export", found, "one that has practised", "choose a method of kind practised_mpc")
    reference, config = controller.reference, controller.config
    ready, models = list(planner.prepared.values()), [along.first_models[key] for key in planner.prepared]
    duals = [update_tables(planner, key / 1e6, one) for key, one in planner.prepared.items()]
    force = np.array([reference.mean_force(one.horizon.time_s[:2])[0] for one in ready])
    firsts, totals = ([len(one.first) for one in ready], [int(one.pushing.sum()) for one in ready])
    steps = max(len(one.horizon) for one in ready)
    arrays = {
        "plan": plan_rows(controller)[:, None],
        **gain_tables(controller),
        "variables_of_update": np.array(totals, np.int32),
        "firsts_of_update": np.array(firsts, np.int32),
        "variable_step": padded([np.nonzero(one.pushing)[0] for one in ready]).astype(np.int32),
        "variable_force": padded([np.nonzero(one.pushing)[1] for one in ready]).astype(np.int32),
        "steps_of_update": np.array([len(one.horizon) for one in ready], np.int32),
        "edges_s": padded([one.horizon.time_s for one in ready]),
        "planned_force": force,
        "pushes_first": np.array([one.horizon.share[0].repeat(2) > 0 for one in ready]).astype(np.int32),
        "first_step_s": np.array([one.step_s for one in ready]),
        "first_push_s": padded([one.first_push_s for one in ready], FORCES),
        "first_model": np.array([constant for constant, _ in models]),
        "first_by_state": np.array([by_state.T for _, by_state in models]),
        "cost_to_go": np.array([one.cost_to_go for one in duals]),
        "slope_to_go": np.array([one.slope_to_go for one in duals]),
        "later_force": padded([one.later for one in duals]),
        "later_by_state": padded([one.later_by_state for one in duals]),
        "later_inverse": padded([np.linalg.inv(one.quadratic[STATES:, STATES:]) for one in duals]),
        "cost": padded([one.quadratic for one in duals]),
        "cost_slope": padded([one.linear for one in duals]),
        **limit_tables(duals),
    }
    numbers = {
        **starts(controller),
        "UPDATES": len(ready),
        "UPDATE_S": config.period_s,
        "STEPS": steps,
        "VARIABLES": max(totals),
        "LIMITS": arrays["limit_bound"].shape[1],
        "LARGEST_ITERATIONS": config.qp.max_iterations,
        "FRONT_LIFT_OFF_S": reference.schedule.front_lift_off_s,
        "PLAN_VALID_S": config.plan_valid_s,
        "CURVATURE": CURVATURE,
        "FORCE_WEIGHT": config.force_weight,
        "TOLERANCE_N": config.demands.primal_tolerance_n,
        "RELATIVE_TOLERANCE": config.demands.relative_dual_tolerance,
        "DEPARTS": int(isinstance(controller, DepartingMpc)),
        "FRICTION": config.limits.friction,
        "SMALLEST_N": config.limits.smallest_n,
        "LARGEST_N": config.limits.largest_n,
    }
    return with_body(controller, arrays, numbers, MEANING)


def plan_rows(controller: JumpMpc) -> np.ndarray:
    """Rows of the plan in the order of ``IN_PLAN``, with the set points that the controller sends."""
    targets = {"joint_pos": controller.targets.position, "joint_vel": controller.targets.velocity}
    parts = [targets.get(name, getattr(controller.reference, name)) for name in IN_PLAN.values()]
    return np.concatenate(parts, axis=1)


def padded(parts: Sequence[np.ndarray], *shape: int) -> np.ndarray:
    """Arrays of several shapes as one, zero where there is none; of the largest shape, or of one that is given."""
    shape = shape or tuple(int(length) for length in np.max([part.shape for part in parts], axis=0))
    found = np.zeros((len(parts), *shape), parts[0].dtype)
    for one, part in zip(found, parts, strict=True):
        one[tuple(map(slice, part.shape))] = part
    return found


def limit_tables(duals: Sequence[DualTables]) -> dict[str, np.ndarray]:
    """The limits' rows, each of which has one force or two."""
    variables, factors = [], []
    for one in duals:
        variable, factor = np.zeros((len(one.rows), 2), np.int32), np.zeros((len(one.rows), 2))
        for row, values in enumerate(one.rows):
            (at,) = np.nonzero(values)
            variable[row, : len(at)], factor[row, : len(at)] = at, values[at]
        variables.append(variable)
        factors.append(factor)
    return {
        "limits_of_update": np.array([len(one.rows) for one in duals], np.int32),
        "limit_variable": padded(variables),
        "limit_factor": padded(factors),
        "limit_bound": padded([one.bounds for one in duals]),
        "starts_of_update": np.array([len(one.start) for one in duals], np.int32),
        "start_row": padded([one.start.astype(np.int32) for one in duals], max(1, *(len(one.start) for one in duals))),
    }
