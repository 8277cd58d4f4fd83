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
    ABSENT,
    ASKED,
    CLEAR,
    GUESSED,
    MISSING,
    SURE,
    UNUSED,
    Evidence,
    Proposal,
    correlations,
    factors,
    fit_gains,
)
from leapgap.logs.map_proposal.joint_columns import Family, choose, families, find_order, read_families
from leapgap.logs.map_proposal.joint_units import (
    judge_set_points,
    judge_units,
    judge_velocities,
    some_rows,
    their_column,
)
from leapgap.logs.map_proposal.unit_readings import find_time, judge_time
from leapgap.robot.model import Robot
from leapgap.robot.stated_joints import Tie, servo_gains, tied_joints

SAME_TORQUE = 0.3  # measured over sent torque may be off 1 by this: motors are weak, currents poor torque sensors
TOO_STRONG = 5.0  # torques mostly so many times those that a motor of the model can give are of another unit


def judge_torques(evidence: Evidence, proposal: Proposal) -> None:
    """Whether the measured torque is the one sent, or that of a joint PD, whose gains are then estimated."""
    judge_size("tau", evidence, proposal)
    judge_size("cmd_tau", evidence, proposal)
    have = evidence.values.keys()
    if "tau" not in have or evidence.time is None:
        return
    if "cmd_tau" in have:
        _, sent, torque = some_rows(evidence, "cmd_tau", "tau")
        slope = factors(torque, sent)
        found = np.nan_to_num(np.diag(correlations(sent, torque)))
        clear = np.abs(found) > CLEAR
        if clear.any():
            ratio = float(np.median(slope[clear]))
            kind = SURE if abs(ratio - 1) < SAME_TORQUE else MISSING
            advice = "" if kind == SURE else ": check unit and sign of one of them"
            proposal.say(kind, f"the measured torque is {ratio:.3g} times the one that was sent{advice}")
            moved = np.ptp(sent, axis=0) > 0
            if kind == SURE and clear[moved].all():
                evidence.torque_alone = True
                return
    if {"cmd_pos", "joint_pos", "joint_vel"} <= have and not {"cmd_kp", "cmd_kd"} <= have:
        estimate_gains(evidence, proposal)


def judge_size(quantity: str, evidence: Evidence, proposal: Proposal) -> None:
    """Whether motors of the model can give such torques; else measured ones are left out, sent ones asked about.

    So are measured ones that nobody measured: a message has a place for them, and drivers leave it 0.
    """
    if quantity not in evidence.values:
        return
    if quantity == "tau" and not np.nan_to_num(evidence.values["tau"]).any():
        proposal.drop("tau")
        proposal.say(ABSENT, "measured torques: left out, they are 0 in all samples")
        del evidence.values["tau"]
        return
    limit, usual = evidence.robot.torque_limits, np.nanmedian(np.abs(evidence.values[quantity]), axis=0)
    times = float(np.max(np.where(np.isfinite(limit) & (limit > 0), usual / np.maximum(limit, 1e-9), 0.0)))
    if times < TOO_STRONG:
        return
    says = f"{quantity} is mostly {times:.3g} times what the motors of the model can give"
    if quantity == "tau":
        proposal.drop("tau")
        proposal.say(ABSENT, f"measured torques: left out, {says}; state units.tau/* (mNm, Ncm, …) or factors")
    else:
        proposal.put("units", "cmd_tau/*", ASKED)
        proposal.say(MISSING, f"the unit of the torques that were sent: {says}; state units.cmd_tau/* or factors")
    del evidence.values[quantity]
    evidence.unplaced.add(quantity)


def estimate_gains(evidence: Evidence, proposal: Proposal) -> None:
    """Gains of the joint PD from the measured torque."""
    names = ("tau", "cmd_pos", "joint_pos", "joint_vel", "cmd_vel", "cmd_tau")
    quantities = [name for name in names if name in evidence.values]
    at = dict(zip(quantities, some_rows(evidence, *quantities)[1:], strict=True))
    error, rate_error = at["cmd_pos"] - at["joint_pos"], at.get("cmd_vel", 0.0) - at["joint_vel"]
    sent = at["cmd_tau"].T if "cmd_tau" in at else [None] * len(evidence.robot.joints)
    fits = [fit_gains(*of_joint) for of_joint in zip(at["tau"].T, error.T, rate_error.T, sent, strict=True)]
    driven = evidence.robot.driven
    good = [one.explained > CLEAR and one.kp > 0 for one in fits] | ~driven
    if not all(good):
        weak = ", ".join(joint for joint, one in zip(evidence.robot.joints, good, strict=True) if not one)
        proposal.say(
            MISSING, f"gains of the joint PD: undetermined by the measured torque for {weak}; state cmd_kp, cmd_kd"
        )
        return
    for name, values in (("cmd_kp", [one.kp for one in fits]), ("cmd_kd", [max(0.0, one.kd) for one in fits])):
        proposal.put("constants", f"{name}/*", [float(f"{on * x:.3g}") for x, on in zip(values, driven, strict=True)])
    worst = min(one.explained for one, on in zip(fits, driven, strict=True) if on)
    proposal.say(
        GUESSED, f"gains of the joint PD by least squares: they explain {worst:.0%} or more of the measured torque"
    )


def fill_commands(evidence: Evidence, proposal: Proposal) -> None:
    """Commands that no column holds: zero where that is the only sense, else missing."""
    have = set(evidence.values)
    stated = {key.partition("/")[0] for key in proposal.options.get("constants", {})}
    if evidence.unplaced & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        return
    if not have & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        proposal.say(MISSING, "commands: no column looks like torques or set points that were sent")
        return
    if evidence.torque_alone:
        for quantity in ("cmd_pos", "cmd_vel"):  # references of a controller outside, which no motor follows
            proposal.drop(quantity)
        have -= {"cmd_pos", "cmd_vel"}
        why = "the torque that was sent is the measured one: no joint PD acts"
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, why)
        return
    if "cmd_pos" not in have:
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, "torques alone are sent, no joint PD")
        return
    zero(("cmd_tau",), have | stated, proposal, "set points alone are sent, no feed-forward torque")
    zero(("cmd_vel",), have | stated, proposal, "the joint PD damps towards rest")
    lacking = [name for name in ("cmd_kp", "cmd_kd") if name not in have | stated]
    if len(lacking) == 2 and take_gains_of_servos(evidence.robot, proposal):
        return
    if lacking and not any("gains" in sentence for sentence in proposal.notes_of(MISSING)):
        proposal.say(MISSING, f"gains of the joint PD: state constants.{'/*, constants.'.join(lacking)}/*")


def take_gains_of_servos(robot: Robot, proposal: Proposal) -> bool:
    """Take the gains of the model file's position servos as a start, if it has such, and say that they are unknown."""
    if servo_gains(robot) is None:
        return False
    proposal.options["gains"] = UNKNOWN
    proposal.notes = [one for one in proposal.notes if not (one[0] == MISSING and "gains" in one[1])]
    proposal.say(
        GUESSED,
        "gains of the joint PD are unknown; those of the servos in the model file are a first guess. If known, state "
        "constants.cmd_kp/* and cmd_kd/* (N·m/rad, N·m·s/rad) in place of gains: unknown",
    )
    return True


def zero(quantities: Iterable[str], have: set[str], proposal: Proposal, why: str) -> None:
    """Zero constants for quantities that are not there."""
    added = [name for name in quantities if name not in have]
    for name in added:
        proposal.put("constants", f"{name}/*", 0.0)
    if added:
        proposal.say(GUESSED, f"{', '.join(added)}: 0, since {why}")


def with_tied(found: Sequence[Family], evidence: Evidence, proposal: Proposal) -> list[Family]:
    """The families, those that lack nothing but tied joints with columns of these, which are added to the evidence."""
    robot, completed, told = evidence.robot, [], dict[str, str]()
    for one in found:
        keys = keys_by_joint(one, robot)
        ties = tied_joints(robot, set(robot.joints) - set(keys))
        if not keys or not ties or set(robot.joints) - set(keys) - set(ties):
            completed.append(one)
            continue
        told |= {joint: tie.of for joint, tie in ties.items()}
        added = {joint: f"{one.template} of {joint}" for joint in ties}
        values = {added[joint]: values_of(one, keys[tie.of], tie, evidence.table) for joint, tie in ties.items()}
        evidence.table = Table(evidence.table.path, {**evidence.table.arrays, **values})
        every = {**{joint: one.members[key] for joint, key in keys.items()}, **added}
        completed.append(
            replace(
                one,
                members={keys.get(joint, joint): every[joint] for joint in robot.joints},
                joints={**one.joints, **{joint: joint for joint in ties}} if one.joints else {},
            )
        )
    for joint, other in told.items():
        proposal.say(GUESSED, f"{joint} is not in the file: it follows {other}, to which the model ties it")
    return completed


def keys_by_joint(one: Family, robot: Robot) -> Mapping[str, str]:
    """Which member of a family is of which joint; one that names none has the joints with motors, in their order."""
    if one.joints:
        return {joint: key for key, joint in one.joints.items()}
    keys = sorted(one.members, key=int) if one.numbered else list(one.members)
    return dict(zip(robot.driven_joints, keys, strict=True)) if len(keys) == len(robot.driven_joints) else {}


def values_of(one: Family, key: str, tie: Tie, table: Table) -> np.ndarray:
    """What a joint has that is tied to that of a member, in the units of the file; commands and torques are none."""
    values = table.numbers(one.members[key])
    follow = {"joint_pos": tie.position, "joint_vel": tie.velocity}.get(one.quantity)
    return np.zeros_like(values) if follow is None else follow(values)


NUMBER = re.compile(r"\d+")
MOST_NAMED = 20  # unused columns that are named


def propose(table: Table, robot: Robot, stated: Mapping[str, Any]) -> Proposal:
    """The map of a table to the columns of a log of this robot; ``stated`` is what the files say of themselves."""
    proposal, evidence = Proposal(), Evidence(table, robot, stated)
    columns = [column for column in table.columns if is_numeric(table, column)]
    if {"time", *(f"joint_pos/{joint}" for joint in robot.joints)} <= set(columns):
        proposal.say(GUESSED, "columns that have the names of leapgap are taken as they are, in SI units")
        return proposal
    find_time(columns, evidence, proposal)
    found = families(columns, robot.joints, motors=len(robot.driven_joints))
    chosen = choose(with_tied(found, evidence, proposal), robot)
    find_order(chosen, evidence, proposal)
    read_families(chosen, evidence, proposal)
    reading = judge_units(evidence, proposal)
    judge_time(columns, reading, evidence, proposal)
    judge_velocities(reading, evidence, proposal)
    judge_set_points(reading, evidence, proposal)
    judge_torques(evidence, proposal)
    fill_commands(evidence, proposal)
    if robot.has_free_base:
        find_base(columns, evidence, proposal)
    tell_unused(columns, table, robot, proposal)
    return proposal


def tell_unused(columns: Sequence[str], table: Table, robot: Robot, proposal: Proposal) -> None:
    """Name the columns that the map does not use: of numbers, of text, and those that are no columns of the log."""
    # The columns of a table that the map names, with ``*`` for what each joint is called in it
    used = {str(proposal.options.get(part, "")) for part in ("cut_by", "steps")}
    for ours, theirs in proposal.options.get("columns", {}).items():
        quantity, _, place = ours.partition("/")
        named = set(theirs) if isinstance(theirs, Mapping) else {str(theirs)}
        used |= {their_column(quantity, joint, proposal) for joint in robot.joints} if place == "*" else named
    if names := in_groups([column for column in columns if column not in used]):
        proposal.say(UNUSED, names)
    others = {name: array for name, array in table.arrays.items() if not array.ndim or table.rows not in array.shape}
    if names := in_groups(list(others)):
        proposal.say(UNUSED, f"not part of the log, of another length: {names}")
    texts = [name for name in table.columns if name in table.arrays and table.arrays[name].dtype.kind in "OSU"]
    empty = [name for name in table.columns if has_numbers(table, name) and not is_numeric(table, name)]
    if names := in_groups([name for name in empty if name not in others]):
        proposal.say(UNUSED, f"no number in any sample: {names}")
    if names := in_groups([name for name in texts if name not in others]):
        proposal.say(UNUSED, f"texts, which can cut the log or drop rows (cut_by, drop_rows): {names}")


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
