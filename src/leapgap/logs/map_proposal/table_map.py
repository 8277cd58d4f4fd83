"""A column map proposed from a table and a robot."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.logs.importers.table_format import UNKNOWN
from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.base_columns import find_base
from leapgap.logs.map_proposal.evidence import (
    CLEAR,
    GUESSED,
    MISSING,
    SURE,
    UNUSED,
    Draft,
    correlations,
    factors,
)
from leapgap.logs.map_proposal.joint_columns import Family, choose, families, find_order, read_families
from leapgap.logs.map_proposal.joint_units import (
    judge_set_points,
    judge_units,
    judge_velocities,
    leave_open,
    names_of,
    some_rows,
    their_column,
)
from leapgap.logs.map_proposal.unit_readings import find_time, judge_time
from leapgap.robot.model import Robot
from leapgap.robot.stated_joints import Tie, servo_gains, tied_joints

SAME_TORQUE = 0.3  # measured over sent torque may be off 1 by this: motors are weak, currents poor torque sensors
TOO_STRONG = 5.0  # torques mostly so many times those that a motor of the model can give are of another unit


def judge_torques(draft: Draft) -> None:
    """Whether the measured torque is the one sent, or that of a joint PD, whose gains are then estimated."""
    judge_size("tau", draft)
    judge_size("cmd_tau", draft)
    have = draft.values.keys()
    if "tau" not in have or draft.time is None:
        return
    if "cmd_tau" in have:
        _, sent, torque = some_rows(draft, "cmd_tau", "tau")
        slope = factors(torque, sent)
        found = np.nan_to_num(np.diag(correlations(sent, torque)))
        clear = np.abs(found) > CLEAR
        if clear.any():
            ratio = float(np.median(slope[clear]))
            kind = SURE if abs(ratio - 1) < SAME_TORQUE else MISSING
            advice = "" if kind == SURE else ": check unit and sign of one of them"
            draft.say(kind, f"the measured torque is {ratio:.3g} times the one that was sent{advice}")
            moved = np.ptp(sent, axis=0) > 0
            if kind == SURE and clear[moved].all():
                draft.torque_alone = True
                return
    if {"cmd_pos", "joint_pos", "joint_vel"} <= have and not {"cmd_kp", "cmd_kd"} <= have:
        estimate_gains(draft)


def judge_size(quantity: str, draft: Draft) -> None:
    """Whether motors of the model can give such torques; else measured ones are left out, sent ones asked about.

    So are measured ones that nobody measured: a message has a place for them, and drivers leave it 0.
    """
    if quantity not in draft.values:
        return
    if quantity == "tau" and not np.nan_to_num(draft.values["tau"]).any():
        draft.leave_out("tau", "measured torques: left out, they are 0 in all samples")
        return
    limit, usual = draft.robot.torque_limits, np.nanmedian(np.abs(draft.values[quantity]), axis=0)
    times = float(np.max(np.where(np.isfinite(limit) & (limit > 0), usual / np.maximum(limit, 1e-9), 0.0)))
    if times < TOO_STRONG:
        return
    says = f"{quantity} is mostly {times:.3g} times what the motors of the model can give"
    if quantity == "tau":
        draft.leave_out("tau", f"measured torques: left out, {says}; state units.tau/* (mNm, Ncm, …) or factors")
        draft.unplaced.add("tau")
    else:
        says = f"the unit of the torques that were sent: {says}; state units.cmd_tau/* or factors"
        leave_open("cmd_tau", says, draft)


def estimate_gains(draft: Draft) -> None:
    """Gains of the joint PD from the measured torque."""
    names = ("tau", "cmd_pos", "joint_pos", "joint_vel", "cmd_vel", "cmd_tau")
    quantities = [name for name in names if name in draft.values]
    at = dict(zip(quantities, some_rows(draft, *quantities)[1:], strict=True))
    error, rate_error = at["cmd_pos"] - at["joint_pos"], at.get("cmd_vel", 0.0) - at["joint_vel"]
    sent = at["cmd_tau"].T if "cmd_tau" in at else [None] * len(draft.robot.joints)
    fits = [fit_gains(*of_joint) for of_joint in zip(at["tau"].T, error.T, rate_error.T, sent, strict=True)]
    kp, kd, explained = np.array(fits).T
    driven = draft.robot.driven
    weak = names_of(driven & ~((explained > CLEAR) & (kp > 0)), draft)
    if weak:
        draft.say(
            MISSING, f"gains of the joint PD: undetermined by the measured torque for {weak}; state cmd_kp, cmd_kd"
        )
        return
    for name, values in (("cmd_kp", kp), ("cmd_kd", np.maximum(kd, 0.0))):
        draft.put("constants", f"{name}/*", [float(f"{on * x:.3g}") for x, on in zip(values, driven, strict=True)])
    worst = explained[driven].min()
    draft.say(
        GUESSED, f"gains of the joint PD by least squares: they explain {worst:.0%} or more of the measured torque"
    )


def fit_gains(
    torque: np.ndarray, error: np.ndarray, rate_error: np.ndarray, sent: np.ndarray | None
) -> tuple[float, float, float]:
    """Gains kp and kd of a joint PD by least squares over rows, and the share of the torque's variance they explain.

    τ = a τ_sent + kp (q_set − q) + kd (q̇_set − q̇) + a constant.
    """
    parts = [error, rate_error, np.ones_like(error), *([] if sent is None else [sent])]
    design = np.stack(parts, axis=1)
    solution, *_ = np.linalg.lstsq(design, torque, rcond=None)
    left = torque - design @ solution
    return float(solution[0]), float(solution[1]), 1 - float(left.var() / max(torque.var(), 1e-300))


def fill_commands(draft: Draft) -> None:
    """Commands that no column holds: zero where that is the only sense, else missing."""
    have = set(draft.values)
    stated = {key.partition("/")[0] for key in draft.options.get("constants", {})}
    if draft.unplaced & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        return
    if not have & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        draft.say(MISSING, "commands: no column looks like torques or set points that were sent")
        return
    if draft.torque_alone:
        for quantity in ("cmd_pos", "cmd_vel"):  # references of a controller outside, which no motor follows
            draft.drop(quantity)
        have -= {"cmd_pos", "cmd_vel"}
        why = "the torque that was sent is the measured one: no joint PD acts"
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, draft, why)
        return
    if "cmd_pos" not in have:
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, draft, "torques alone are sent, no joint PD")
        return
    zero(("cmd_tau",), have | stated, draft, "set points alone are sent, no feed-forward torque")
    zero(("cmd_vel",), have | stated, draft, "the joint PD damps towards rest")
    lacking = [name for name in ("cmd_kp", "cmd_kd") if name not in have | stated]
    if len(lacking) == 2 and take_gains_of_servos(draft.robot, draft):
        return
    if lacking and not any("gains" in sentence for sentence in draft.notes_of(MISSING)):
        draft.say(MISSING, f"gains of the joint PD: state constants.{'/*, constants.'.join(lacking)}/*")


def take_gains_of_servos(robot: Robot, draft: Draft) -> bool:
    """Take the gains of the model file's position servos as a start, if it has such, and say that they are unknown."""
    if servo_gains(robot) is None:
        return False
    draft.options["gains"] = UNKNOWN
    draft.notes = [one for one in draft.notes if not (one[0] == MISSING and "gains" in one[1])]
    draft.say(
        GUESSED,
        "gains of the joint PD are unknown; those of the servos in the model file are a first guess. If known, state "
        "constants.cmd_kp/* and cmd_kd/* (N·m/rad, N·m·s/rad) in place of gains: unknown",
    )
    return True


def zero(quantities: Iterable[str], have: set[str], draft: Draft, why: str) -> None:
    """Zero constants for quantities that are not there."""
    added = [name for name in quantities if name not in have]
    for name in added:
        draft.put("constants", f"{name}/*", 0.0)
    if added:
        draft.say(GUESSED, f"{', '.join(added)}: 0, since {why}")


def with_tied(found: Sequence[Family], draft: Draft) -> list[Family]:
    """The families, those that lack nothing but tied joints with columns of these, which are added to the table."""
    robot, completed, told = draft.robot, [], dict[str, str]()
    for one in found:
        keys = {joint: key for key, joint in one.joints.items()}
        if not keys and len(one.members) == len(robot.driven_joints):  # without names: the joints with motors, in order
            keys = dict(zip(robot.driven_joints, one.keys, strict=True))
        ties = tied_joints(robot, set(robot.joints) - set(keys))
        if not keys or not ties or set(robot.joints) - set(keys) - set(ties):
            completed.append(one)
            continue
        told |= {joint: tie.of for joint, tie in ties.items()}
        added = {joint: f"{one.template} of {joint}" for joint in ties}
        values = {added[joint]: values_of(one, keys[tie.of], tie, draft.table) for joint, tie in ties.items()}
        draft.table = Table(draft.table.path, {**draft.table.arrays, **values})
        every = {**{joint: one.members[key] for joint, key in keys.items()}, **added}
        completed.append(
            replace(
                one,
                members={keys.get(joint, joint): every[joint] for joint in robot.joints},
                joints={**one.joints, **{joint: joint for joint in ties}} if one.joints else {},
            )
        )
    for joint, other in told.items():
        draft.say(GUESSED, f"{joint} is not in the file: it follows {other}, to which the model ties it")
    return completed


def values_of(one: Family, key: str, tie: Tie, table: Table) -> np.ndarray:
    """What a joint has that is tied to that of a member, in the units of the file; commands and torques are none."""
    values = table.numbers(one.members[key])
    follow = {"joint_pos": tie.position, "joint_vel": tie.velocity}.get(one.quantity)
    return np.zeros_like(values) if follow is None else follow(values)


NUMBER = re.compile(r"\d+")
MOST_NAMED = 20  # unused columns that are named


def propose(table: Table, robot: Robot, stated: Mapping[str, Any]) -> Draft:
    """The map of a table to the columns of a log of this robot; ``stated`` is what the files say of themselves."""
    draft = Draft(table, robot, stated)
    columns = [column for column in table.columns if is_numeric(table, column)]
    if {"time", *(f"joint_pos/{joint}" for joint in robot.joints)} <= set(columns):
        draft.say(GUESSED, "columns that have the names of leapgap are taken as they are, in SI units")
        return draft
    find_time(columns, draft)
    found = families(columns, robot.joints, motors=len(robot.driven_joints))
    chosen = choose(with_tied(found, draft), robot)
    find_order(chosen, draft)
    read_families(chosen, draft)
    reading = judge_units(draft)
    judge_time(columns, reading, draft)
    judge_velocities(reading, draft)
    judge_set_points(reading, draft)
    judge_torques(draft)
    fill_commands(draft)
    if robot.has_free_base:
        find_base(columns, draft)
    tell_unused(columns, table, robot, draft)
    return draft


def tell_unused(columns: Sequence[str], table: Table, robot: Robot, draft: Draft) -> None:
    """Name the columns that the map does not use: of numbers, of text, and those that are no columns of the log."""
    # The columns of a table that the map names, with ``*`` for what each joint is called in it
    used = {str(draft.options.get(part, "")) for part in ("cut_by", "steps")}
    for ours, theirs in draft.options.get("columns", {}).items():
        quantity, _, place = ours.partition("/")
        named = set(theirs) if isinstance(theirs, Mapping) else {str(theirs)}
        used |= {their_column(quantity, joint, draft) for joint in robot.joints} if place == "*" else named
    if names := in_groups([column for column in columns if column not in used]):
        draft.say(UNUSED, names)
    others = {name: array for name, array in table.arrays.items() if not array.ndim or table.rows not in array.shape}
    if names := in_groups(list(others)):
        draft.say(UNUSED, f"not part of the log, of another length: {names}")
    texts = [name for name in table.columns if name in table.arrays and table.arrays[name].dtype.kind in "OSU"]
    empty = [name for name in table.columns if has_numbers(table, name) and not is_numeric(table, name)]
    if names := in_groups([name for name in empty if name not in others]):
        draft.say(UNUSED, f"no number in any sample: {names}")
    if names := in_groups([name for name in texts if name not in others]):
        draft.say(UNUSED, f"texts, which can cut the log or drop rows (cut_by, drop_rows): {names}")


def in_groups(columns: Sequence[str]) -> str:
    """Names of columns, those that numbers tell apart as one."""
    groups: dict[str, list[str]] = {}
    for column in columns:
        groups.setdefault(NUMBER.sub("#", column), []).append(column)
    names = [of[0] if len(of) == 1 else f"{of[0]} to {of[-1]}" for of in groups.values()]
    if len(names) > MOST_NAMED:
        names = [*names[:MOST_NAMED], f"{len(names) - MOST_NAMED} more"]
    return ", ".join(names)


def has_numbers(table: Table, column: str) -> bool:
    """Whether a column is as long as most and of a numeric type."""
    values = table.values(column)
    return values.dtype.kind in "biufMm" and len(values) == table.rows


def is_numeric(table: Table, column: str) -> bool:
    """Whether a column is as long as most and holds numbers."""
    return has_numbers(table, column) and bool(np.isfinite(table.values(column)).any())
