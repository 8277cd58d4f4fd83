"""Joints that a table lacks and that the model ties to others: what an import gives them, for the physics to judge."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.logs.map_proposal.names import Family
from leapgap.logs.map_proposal.proposal import GUESSED, Evidence, Proposal
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
