"""A column map proposed from a table and a robot."""

import re

from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.base_columns import find_base
from leapgap.logs.map_proposal.commands import fill_commands, judge_torques
from leapgap.logs.map_proposal.joint_columns import choose, read_families
from leapgap.logs.map_proposal.joint_units import (
    judge_positions,
    judge_set_points,
    judge_velocities,
    their_column,
)
from leapgap.logs.map_proposal.names import families
from leapgap.logs.map_proposal.proposal import UNUSED, Evidence, Proposal
from leapgap.logs.map_proposal.tied_columns import with_tied
from leapgap.logs.map_proposal.time_column import find_time
from leapgap.robot.model import Robot

NUMBER = re.compile(r"\d+")
MOST_NAMED = 20
"""Unused columns that are named."""


def propose(table: Table, robot: Robot) -> Proposal:
    """The map of a table to the columns of a log of this robot."""
    proposal, evidence = Proposal(), Evidence(table, robot)
    columns = [column for column in table.columns if is_numeric(table, column)]
    find_time(columns, evidence, proposal)
    found = families(columns, robot.joints, motors=len(robot.driven_joints))
    chosen = choose(with_tied(found, evidence, proposal), robot)
    read_families(chosen, evidence, proposal)
    judge_positions(evidence, proposal)
    judge_velocities(evidence, proposal)
    judge_set_points(evidence, proposal)
    judge_torques(evidence, proposal)
    fill_commands(evidence, proposal)
    if robot.has_free_base:
        find_base(columns, evidence, proposal)
    tell_unused(columns, robot, proposal)
    return proposal


def tell_unused(columns: list[str], robot: Robot, proposal: Proposal) -> None:
    """Name the columns of numbers that the map does not use, those that numbers tell apart as one."""
    used = used_columns(robot, proposal)
    groups: dict[str, list[str]] = {}
    for column in columns:
        if column not in used:
            groups.setdefault(NUMBER.sub("#", column), []).append(column)
    names = [of[0] if len(of) == 1 else f"{of[0]} to {of[-1]}" for of in groups.values()]
    if len(names) > MOST_NAMED:
        names = [*names[:MOST_NAMED], f"{len(names) - MOST_NAMED} more"]
    if names:
        proposal.say(UNUSED, ", ".join(names))


def used_columns(robot: Robot, proposal: Proposal) -> set[str]:
    """The columns of a table that the map names, with ``*`` for what each joint is called in it."""
    used = {str(proposal.options.get("cut_by", ""))}
    for ours, theirs in proposal.options.get("columns", {}).items():
        quantity, _, place = ours.partition("/")
        used |= {their_column(quantity, joint, proposal) for joint in robot.joints} if place == "*" else {str(theirs)}
    return used


def is_numeric(table: Table, column: str) -> bool:
    """Whether a column is as long as most and holds numbers."""
    values = table.values(column)
    return values.dtype.kind in "biufMm" and len(values) == table.rows()
