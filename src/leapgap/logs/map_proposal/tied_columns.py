"""Joints that a table lacks and that the model ties to others: what an import gives them, for the physics to judge."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.names import Family
from leapgap.logs.map_proposal.proposal import GUESSED, Evidence, Proposal
from leapgap.robot.tied_joints import Tie, tied_joints


def with_tied(found: Sequence[Family], evidence: Evidence, proposal: Proposal) -> list[Family]:
    """The families, those that lack nothing but tied joints with columns of these, which are added to the evidence."""
    robot, completed, told = evidence.robot, [], dict[str, str]()
    for one in found:
        ties = tied_joints(robot, set(robot.joints) - set(one.joints.values())) if one.joints else {}
        if not ties or set(robot.joints) - set(one.joints.values()) - set(ties):
            completed.append(one)
            continue
        told |= {joint: tie.of for joint, tie in ties.items()}
        added = {joint: f"{one.template} of {joint}" for joint in ties}
        values = {added[joint]: values_of(one, tie, evidence.table) for joint, tie in ties.items()}
        evidence.table = Table(evidence.table.path, {**evidence.table.arrays, **values})
        completed.append(
            replace(one, members={**one.members, **added}, joints={**one.joints, **{joint: joint for joint in ties}})
        )
    for joint, other in told.items():
        proposal.say(GUESSED, f"{joint} is not in the file: it follows {other}, to which the model ties it")
    return completed


def values_of(one: Family, tie: Tie, table: Table) -> np.ndarray:
    """What a tied joint has in the units of the file; commands and torques are none."""
    key = next(key for key, joint in one.joints.items() if joint == tie.of)
    values = table.numbers(one.members[key])
    follow = {"joint_pos": tie.position, "joint_vel": tie.velocity}.get(one.quantity)
    return np.zeros_like(values) if follow is None else follow(values)
