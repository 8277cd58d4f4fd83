"""A column map proposed from a table and a robot."""

from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.base_columns import find_base
from leapgap.logs.map_proposal.commands import fill_commands, judge_torques
from leapgap.logs.map_proposal.joint_columns import choose, read_families
from leapgap.logs.map_proposal.joint_units import judge_positions, judge_set_points, judge_velocities
from leapgap.logs.map_proposal.names import families
from leapgap.logs.map_proposal.proposal import Evidence, Proposal
from leapgap.logs.map_proposal.tied_columns import with_tied
from leapgap.logs.map_proposal.time_column import find_time
from leapgap.robot.model import Robot


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
    return proposal


def is_numeric(table: Table, column: str) -> bool:
    """Whether a column is as long as most and holds numbers."""
    values = table.values(column)
    return values.dtype.kind in "biufMm" and len(values) == table.rows()
