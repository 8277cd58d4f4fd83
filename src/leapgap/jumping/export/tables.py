"""Everything that the goal-shift controller of one jump needs while it runs, as arrays and numbers.

The names here are those in the C files; what a table holds stands in ``MEANING``, which is written beside the tables.
Quadratic programs are tabled as far as no measurement is needed, neither of the robot nor of the stance that it may
begin in: for each update a part of the Hessian, and the constraints, scaled by their norm in the Hessian of the plan's
own goal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.border import DAMPING, HOLD_TICKS, LARGEST, LARGEST_TIME_S, LONGEST_GAP_S, QUATERNION_NORMS
from leapgap.jumping.control.condensed_qp import STATES
from leapgap.jumping.control.goal_shift_jump import LateStance, ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import RECENT, GoalShiftPlanner
from leapgap.jumping.control.mpc import AlongPlan, DepartingMpc, JumpMpc
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.goal_directed_jump import LandingModel
from leapgap.jumping.experiments.goal_shift_jump import LandingFeedback
from leapgap.jumping.export.dual_tables import DualTables, dual_tables
from leapgap.jumping.export.leg_chains import LegChains
from leapgap.jumping.models.rigid_body import CURVATURE, NominalDeviation
from leapgap.logs.pair_force import FORCES
from leapgap.robot.topology import PAIRS

IN_PLAN = {"POSITION": "joint_pos", "VELOCITY": "joint_vel", "TORQUE": "torque", "FORCE": "force", "STATE": "state"}
IN_PLAN |= {"FOOT": "foot"}
"""Parts of a row of the plan, in their order."""
MEANING = {
    "plan": "rows of the plan: value, then slopes by a shift of the goal in x, z, pitch, and by the stance if measured",
    "planned_goal": "goal of the plan: x, z, pitch",
    "target": "where to land: x, z, pitch",
    "stance_pitch": "pitches of the ground that may be measured at the start, rising, rad, nose-down",
    "stance_goal": "goal of a jump from each of them: x, z, pitch",
    "authority": "change of the landing by the shift during each update, for goals at several distances",
    "authority_x": "these distances, m",
    "landing_trend": "landing - goal: rows for 1, goal and pitch of the stance",
    "landing_scale": "by which goal and stance are divided",
    "landing_sample": "goals and stances of the kernel, divided by the scale",
    "landing_dual": "their weights",
    "carry": "deviation at each update from 1 and the ten of the update before, while nothing happens",
    "precision": "inverse covariance of what is left",
    "by_change": "change of the landing by what is sudden, now and before, at its first update and later",
    "matters_of_target": "landing errors that cost alike",
    "steps_of_update": "number of steps of the horizon",
    "edges_of_update": "first update of each step, and the end of the last one",
    "hessian": "costs of changes of the shift and of stated errors; the last three: slacks of pitch, height and effort",
    "bound_scale": "by which bounds are multiplied",
    "landing_row_scale": "by which limits of the landing's pitch, up and down, and of its height are multiplied",
    "landing_soft": "by how much their slacks widen them",
    "efforts_of_update": "first row of each update in the tables of efforts, and their number",
    "effort_step": "step of the horizon that an effort belongs to",
    "effort_slope": "its change by the shift, and by the stance if measured",
    "effort_soft": "by how much its slack widens it",
    "effort_room": "distance of the plan to the limit",
    "largest_shift": "of the goal",
    "largest_change": "of the shift at one update",
}

MEANING_OF_BODY = {
    "gains": "kp and kd of each phase, by joint",
    "gains_of_row": "which of them holds in a row of the plan",
    "links_of_foot": "first link of each foot in the tables of links, and their number",
    "link_position": "of a link in the one before, m",
    "link_rotation": "of a link in the one before, row by row",
    "link_joint": "joint that turns it, or -1",
    "link_axis": "of that joint, in the link",
    "link_anchor": "of that joint, in the link, m",
    "link_zero": "angle of the joint at which the link is as tabled",
    "foot_point": "centre of the foot in its last link, m",
    "foot_share": "part of the foot in the mean of the front and of the rear pair",
    "torque_limit": "of each motor, N m",
    "pair_of_joint": "0: front, 1: rear, -1: neither",
    "quaternion_norms": "least and largest that can have been measured",
    "largest_position": "that can have been measured, m",
    "largest_velocity": "the same, m/s",
    "largest_angular_velocity": "the same, rad/s",
    "largest_joint_pos": "the same, rad",
}
"""Of the tables of all controllers."""


@dataclass(frozen=True)
class ControllerTables:
    """Arrays by name, and numbers by name: sizes and places as int, others as float."""

    arrays: Mapping[str, np.ndarray]
    numbers: Mapping[str, int | float]
    meaning: Mapping[str, str]  # What each array holds


def tables_of(tracker: ShiftTracker) -> ControllerTables:
    """The tables of a controller that has not begun its jump."""
    model, planner = tracker.model, tracker.planner
    if not isinstance(model, LandingFeedback) or planner is None or tracker.exploration.any():
        found = "a controller that explores or has no learned model"
        raise InputError("export", found, "a controller that was learned", "let the robot practise")
    config, late, plan, reference = tracker.config, tracker.late, tracker.plan, tracker.plan.reference
    values = np.concatenate([getattr(reference, quantity) for quantity in IN_PLAN.values()], axis=1)
    slopes = np.concatenate([plan.slopes[quantity] for quantity in IN_PLAN.values()], axis=2)
    arrays = {
        "plan": np.concatenate([values[:, None], slopes.transpose(1, 0, 2)], axis=1),
        **gain_tables(tracker),
        "stance_pitch": np.array([float(tracker.stance_pitch)]) if late is None else late.pitches,
        "stance_goal": np.array([tracker.goal], float) if late is None else late.goals,
        **landing_tables(model.landing),
        "authority": model.shifts.mean,
        "authority_x": model.shifts.x_m,
        "carry": model.calm.carry,
        "precision": model.calm.precision,
        "by_change": model.by_change,
        **program_tables(planner),
        "planned_goal": np.asarray(tracker.goal, float),
        "target": np.asarray(planner.target, float),
    }
    numbers: dict[str, int | float] = {
        "AXES": plan.axes,
        "UPDATES": planner.grid.updates,
        "VARIABLES": arrays["hessian"].shape[1],
        "KNOTS": len(arrays["authority_x"]),
        "PITCHES": len(arrays["stance_pitch"]),
        "EFFORTS": len(arrays["effort_step"]),
        "LARGEST_EFFORTS": int(np.diff(arrays["efforts_of_update"]).max()),
        "SAMPLES": len(arrays["landing_sample"]),
        **starts(tracker),
        "KEPT": tracker.recorder.kept_rows,
        "UPDATE_S": config.period_s,
        "STANCE_PITCH_RAD": float(tracker.stance_pitch),
        "MEASURED_UNTIL_S": 0.0 if late is None else late.until_s,
        "REACHED_IN_S": LateStance.reach_s if late is None else late.reach_s,
        "FREE_UPDATES": planner.grid.free_updates,
        "AUTHORITY_DOUBT": config.authority_doubt,
        "TIMING_DOUBT": config.timing_doubt_s / config.period_s,
        "LEAST_SURPRISE": config.sudden.least_surprise,
        "TIMES_RECENT": config.sudden.times_recent,
        "RECENT": RECENT,
        "LARGEST_PITCH_RAD": config.largest_pitch_rad,
        "BELOW_TARGET_M": config.below_target_m,
        "TORQUE_NM": config.torque_nm,
    }
    return with_body(tracker, arrays, numbers, MEANING)


def with_body(
    tracker: JumpController,
    arrays: Mapping[str, np.ndarray],
    numbers: Mapping[str, int | float],
    meaning: Mapping[str, str],
) -> ControllerTables:
    """The tables of a controller with those of its robot, its border and its schedule."""
    of_border = {"position": "base_position", "velocity": "base_velocity", "angular_velocity": "base_angular_velocity"}
    of_border |= {"joint_pos": "joint_pos"}
    pair_of_joint = np.full(len(tracker.robot.joints), -1, np.int32)
    for pair, name in enumerate(PAIRS):
        pair_of_joint[tracker.robot.joints_at(name)] = pair
    own = {
        **vars(LegChains.of(tracker.robot)),
        "pair_of_joint": pair_of_joint,
        "torque_limit": tracker.border.limit_nm,
        "quaternion_norms": np.array(QUATERNION_NORMS),
        **{f"largest_{name}": np.array(LARGEST[key]) for name, key in of_border.items()},
    }
    schedule = tracker.reference.schedule
    shared: dict[str, int | float] = {
        "ROWS": len(arrays["plan"]),
        "COLUMNS": arrays["plan"].shape[2],
        "PHASES": len(arrays["gains"]),
        "JOINTS": len(own["torque_limit"]),
        "LINKS": len(own["link_joint"]),
        "FEET": len(own["foot_point"]),
        "HOLD_TICKS": HOLD_TICKS,
        "SAFE_KP": DAMPING.kp_nm_per_rad,
        "SAFE_KD": DAMPING.kd_nms_per_rad,
        "ROW_S": tracker.reference.period_s,
        "TAKE_OFF_S": schedule.take_off_s,
        "LANDING_S": schedule.landing_s,
        "LONGEST_GAP_S": LONGEST_GAP_S,
        "LARGEST_TIME_S": LARGEST_TIME_S,
    }
    return ControllerTables({**arrays, **own}, {**numbers, **shared}, {**MEANING_OF_BODY, **meaning})


def starts(tracker: JumpController) -> dict[str, int]:
    """Where each part begins in a row of the plan."""
    widths = [getattr(tracker.reference, quantity).shape[1] for quantity in IN_PLAN.values()]
    return {f"OF_{name}": int(at) for name, at in zip(IN_PLAN, np.cumsum([0, *widths[:-1]]), strict=True)}


def gain_tables(tracker: JumpController) -> dict[str, np.ndarray]:
    """The gains of the plan's rows."""
    both = np.stack([tracker.kp, tracker.kd], axis=1)
    gains, of_row = np.unique(both.reshape(len(both), -1), axis=0, return_inverse=True)
    return {"gains": gains.reshape(-1, *both.shape[1:]), "gains_of_row": of_row.reshape(-1).astype(np.int32)}


def landing_tables(model: LandingModel) -> dict[str, np.ndarray]:
    """A landing model as a trend and a kernel."""
    scale = np.array(model.config.scale)
    by_input = model.weights[1:] / scale[:, None]
    return {
        "landing_trend": np.concatenate([model.weights[:1] - model.centre @ by_input, by_input]),
        "landing_scale": scale * model.config.length,
        "landing_sample": model.samples.inputs / (scale * model.config.length),
        "landing_dual": model.dual,
    }


def program_tables(planner: GoalShiftPlanner) -> dict[str, np.ndarray]:
    """The quadratic programs of all updates, as far as they depend neither on the goal nor on what is measured."""
    bases, config = planner.bases, planner.config
    size, steps = max(len(basis.hessian) for basis in bases), max(basis.steps for basis in bases)
    hessian, edges = np.zeros((len(bases), size, size)), np.zeros((len(bases), steps + 1), np.int32)
    bounds, landing_scale = np.zeros((len(bases), size)), np.zeros((len(bases), 3))
    efforts: list[dict[str, np.ndarray]] = []
    for update, basis in enumerate(bases):
        n, ready = len(basis.hessian), planner.prepared(update)
        root = np.linalg.inv(np.linalg.cholesky(ready.hessian)).T
        hessian[update, :n, :n], edges[update, : basis.steps + 1] = basis.hessian, basis.edges
        bounds[update, :n] = 1 / np.linalg.norm(root, axis=1)
        landing_scale[update] = 1 / np.linalg.norm(ready.rows[:3] @ root, axis=1)
        norms = np.linalg.norm(basis.effort_rows @ root, axis=1)
        limits = basis.efforts
        efforts.append(
            {
                "effort_step": limits.step.astype(np.int32),
                "effort_slope": limits.slope / norms[:, None],
                "effort_soft": limits.soft / norms,
                "effort_room": limits.distance / norms,
            }
        )
    counts = [len(part["effort_step"]) for part in efforts]
    soft_pitch, soft_height = config.soft_landing
    return {
        "steps_of_update": np.array([basis.steps for basis in bases], np.int32),
        "edges_of_update": edges,
        "hessian": hessian,
        "bound_scale": bounds,
        "landing_row_scale": landing_scale,
        "landing_soft": np.array([soft_pitch, soft_pitch, soft_height]),
        "efforts_of_update": np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        **{name: np.concatenate([part[name] for part in efforts]) for name in efforts[0]},
        "largest_shift": np.array(config.largest),
        "largest_change": np.array(config.largest_change),
        "matters_of_target": np.array(config.matters),
    }


MEANING_OF_FORCES = {
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
    duals = [dual_tables(planner, key / 1e6, one) for key, one in planner.prepared.items()]
    force = np.array([reference.mean_force(one.horizon.time_s[:2])[0] for one in ready])
    firsts, totals = ([len(one.first) for one in ready], [int(one.pushing.sum()) for one in ready])
    steps = max(len(one.horizon) for one in ready)
    parts = [getattr(reference, name) for name in IN_PLAN.values()]
    arrays = {
        "plan": np.concatenate(parts, axis=1)[:, None],
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
        "later_inverse": padded([np.linalg.inv(one.quadratic[STATES:, STATES:]) for one in ready]),
        "cost": padded([one.quadratic for one in ready]),
        "cost_slope": padded([one.linear for one in ready]),
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
        "FRONT_LIFT_OFF_S": reference.schedule.double_contact_s,
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
    return with_body(controller, arrays, numbers, MEANING_OF_FORCES)


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
