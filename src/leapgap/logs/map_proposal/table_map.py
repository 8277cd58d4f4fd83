"""A column map proposed from a table and a robot."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.base_columns import find_base
from leapgap.logs.map_proposal.commands import fill_commands, judge_torques
from leapgap.logs.map_proposal.joint_columns import choose, find_order, read_families
from leapgap.logs.map_proposal.joint_units import judge_set_points, judge_units, judge_velocities, their_column
from leapgap.logs.map_proposal.names import Family, families
from leapgap.logs.map_proposal.proposal import GUESSED, UNUSED, Evidence, Proposal
from leapgap.logs.map_proposal.time_column import find_time, judge_time
from leapgap.robot.model import Robot
from leapgap.robot.tied_joints import Tie, tied_joints


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
MOST_NAMED = 20
"""Unused columns that are named."""


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
    used = used_columns(robot, proposal)
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


def used_columns(robot: Robot, proposal: Proposal) -> set[str]:
    """The columns of a table that the map names, with ``*`` for what each joint is called in it."""
    used = {str(proposal.options.get(part, "")) for part in ("cut_by", "steps")}
    for ours, theirs in proposal.options.get("columns", {}).items():
        quantity, _, place = ours.partition("/")
        named = set(theirs) if isinstance(theirs, Mapping) else {str(theirs)}
        used |= {their_column(quantity, joint, proposal) for joint in robot.joints} if place == "*" else named
    return used


def has_numbers(table: Table, column: str) -> bool:
    """Whether a column is as long as most and of a numeric type."""
    values = table.values(column)
    return values.dtype.kind in "biufMm" and len(values) == table.rows


def is_numeric(table: Table, column: str) -> bool:
    """Whether a column is as long as most and holds numbers."""
    return has_numbers(table, column) and bool(np.isfinite(table.values(column)).any())
