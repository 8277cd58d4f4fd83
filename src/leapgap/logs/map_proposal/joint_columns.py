"""Which columns of a table are which quantity of which joint, by their names."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.names import Family
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, Evidence, Proposal
from leapgap.logs.map_proposal.unit_readings import SPUN_RAD, inside, real_limits
from leapgap.logs.schema import COMMANDS
from leapgap.robot.model import Robot

MODEL = "in the order of the model"


def known_orders(robot: Robot) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Orders of the joints, each with what it is called, the likeliest first."""
    joints = robot.joints
    yield MODEL, joints
    depth = dict(zip(joints, levels(robot), strict=True))
    breadth = "kind by kind through the tree of the model (breadth-first, as Isaac Lab has them)"
    yield breadth, tuple(sorted(joints, key=lambda joint: depth[joint]))
    yield f"{breadth}, branches by the alphabet", tuple(sorted(joints, key=lambda joint: (depth[joint], joint)))
    stated = tuple(motor.target for motor in robot.published_spec().actuators)
    if set(stated) == set(joints):
        yield "in the order of the model file's actuators", stated
    yield "by the alphabet", tuple(sorted(joints))


def levels(robot: Robot) -> list[int]:
    """Number of joints between each joint and the base."""
    model = robot.model

    def level(body: int) -> int:
        if body == 0:
            return 0
        return level(int(model.body_parentid[body])) + int(np.isin(robot.joint_bodies, body).sum())

    return [level(int(model.body_parentid[body])) for body in robot.joint_bodies]


def fitting_order(position: np.ndarray, robot: Robot) -> tuple[str, Sequence[str], list[str]]:
    """The first order in which positions (rows, joints) lie within the limits, in rad or deg, and others that fit too.

    The model's own where none does.
    """
    limits, real = real_limits(robot)
    unit = UNITS["rad"]["rad" if np.nanmax(np.abs(position)) < 1.5 * SPUN_RAD else "deg"]
    low, high = np.nanmin(position, axis=0), np.nanmax(position, axis=0)

    def fits(order: Sequence[str], turned: bool) -> bool:
        at = [order.index(joint) for joint in robot.joints]
        good = inside(low[at] * unit, high[at] * unit, limits)
        return bool((good | (turned & inside(-high[at] * unit, -low[at] * unit, limits)))[real].all())

    every = {order: words for words, order in reversed([*known_orders(robot)])}
    for turned in (False, True):  # joints that count backwards are thought of last
        found = [order for order in reversed(every) if fits(order, turned)]
        if found:
            return every[found[0]], found[0], [every[order] for order in found[1:]]
    return MODEL, robot.joints, []


OF_JOINTS = ("joint_pos", "joint_vel", "tau", *COMMANDS)


def choose(found: list[Family], robot: Robot) -> dict[str, Family]:
    """The best family for each quantity: one that names the robot's joints, all of them, in the plainest words."""
    chosen: dict[str, Family] = {}
    for one in sorted(found, key=lambda one: (fit_of(one, robot), one.preference), reverse=True):
        chosen.setdefault(one.quantity, one)
    return chosen


def fit_of(one: Family, robot: Robot) -> float:
    """How well the members of a family go with the joints."""
    if one.joints:
        named = len(set(one.joints.values()) & set(robot.joints)) / len(robot.joints)
        return 3 if named == 1 else 1.5 if named > 0.5 else 0
    return 2 if len(one.members) == len(robot.joints) else 1


def read_families(chosen: dict[str, Family], evidence: Evidence, proposal: Proposal) -> None:
    """Take each family into the map, with the joints its members are of."""
    joints = evidence.robot.joints
    nameless = defaultdict[str, list[str]](list)
    for quantity in OF_JOINTS:
        one = chosen.get(quantity)
        if one is None:
            continue
        if one.joints and not set(one.joints.values()) >= set(joints):
            lacking = ", ".join(joint for joint in joints if joint not in one.joints.values())
            proposal.say(MISSING, f"{quantity} of {lacking}: {one.template} names the others only")
            continue
        keys = keys_of(one, evidence)
        if keys is None and add_some(quantity, one, evidence, proposal):
            continue
        if keys is None:
            nameless[", ".join(one.members)].append(f"{quantity}: {one.template}")
            evidence.unplaced.add(quantity)
            continue
        add_family(quantity, one, keys, evidence, proposal)
    for names, entries in nameless.items():
        which = f"which of {names} is which joint ({', '.join(joints)})"
        proposal.say(MISSING, f"{which}: state joint_names, {{theirs: the robot's}}, to map {', '.join(entries)}")


def keys_of(one: Family, evidence: Evidence) -> list[str] | None:
    """What stands for each joint in a family, in our order of joints; None where that cannot be said."""
    joints = evidence.robot.joints
    if one.joints:
        by_joint = {joint: key for key, joint in one.joints.items()}
        return [by_joint[joint] for joint in joints]
    if evidence.their_joints and set(evidence.their_joints) <= set(one.members):
        return evidence.their_joints
    keys = keys_in_order(one, evidence)
    if len(keys) != len(joints):
        return None
    return [keys[evidence.order.index(joint)] for joint in joints]


def keys_in_order(one: Family, evidence: Evidence) -> list[str]:
    """What stands for ``*`` in a family that names no joints, by number; motors that the robot lacks left out."""
    keys = sorted(one.members, key=int) if one.numbered else list(one.members)
    if len(keys) > len(evidence.robot.joints):  # motors that the robot does not have read zero
        keys = [key for key in keys if np.ptp(evidence.table.numbers(one.members[key])) > 0]
    return keys


def find_order(chosen: dict[str, Family], evidence: Evidence, proposal: Proposal) -> None:
    """The order of columns that name no joints: the first known one in which positions lie within their limits."""
    evidence.order, evidence.order_words = evidence.robot.joints, MODEL
    one = chosen.get("joint_pos")
    if one is None or one.joints:
        return
    keys = keys_in_order(one, evidence)
    if len(keys) != len(evidence.robot.joints):
        return
    position = np.stack([evidence.table.numbers(one.members[key]) for key in keys], axis=1)
    if not np.isfinite(position).any(axis=0).all():
        return
    evidence.order_words, evidence.order, others = fitting_order(position, evidence.robot)
    if evidence.order_words != MODEL:
        also = f"; so they would {' and '.join(others)}" if others else ""
        proposal.say(GUESSED, f"joints {evidence.order_words}: so positions lie within the joints' limits{also}")


def add_some(quantity: str, one: Family, evidence: Evidence, proposal: Proposal) -> bool:
    """Add torques of some joints, which the family calls as others did; the other joints have no motor."""
    theirs = evidence.their_joints or []
    if quantity not in ("tau", "cmd_tau") or not set(one.members) < set(theirs):
        return False
    idle = []
    values = np.zeros((evidence.table.rows, len(theirs)))
    for i, (key, joint) in enumerate(zip(theirs, evidence.robot.joints, strict=True)):
        if key in one.members:
            proposal.put("columns", f"{quantity}/{joint}", one.members[key])
            values[:, i] = evidence.table.numbers(one.members[key])
            continue
        idle.append(joint)
        if quantity == "cmd_tau":
            proposal.put("constants", f"cmd_tau/{joint}", 0.0)
    evidence.values[quantity] = values
    proposal.say(GUESSED, f"{quantity} is {one.template}, by its name; {', '.join(idle)} has none, as without a motor")
    return True


def add_family(quantity: str, one: Family, keys: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """Add the entries of one family, by ``*`` where the names of joints go with those of the others."""
    joints, known = evidence.robot.joints, evidence.their_joints == keys
    evidence.named |= {quantity} if one.joints else set()
    if evidence.their_joints is None:
        evidence.their_joints = keys
        renamed = {key: joint for key, joint in zip(keys, joints, strict=True) if key != joint}
        if renamed:
            proposal.options["joint_names"] = renamed
    if evidence.their_joints == keys:
        proposal.put("columns", f"{quantity}/*", one.template)
    else:  # other names than the first family has
        for key, joint in zip(keys, joints, strict=True):
            proposal.put("columns", f"{quantity}/{joint}", one.members[key])
    evidence.values[quantity] = np.stack([evidence.table.numbers(one.members[key]) for key in keys], axis=1)
    if one.joints:
        how = "the joints are named in it"
    elif known:
        how = "its joints are called the same"
    else:
        pairs = sorted(zip(keys, joints, strict=True), key=lambda pair: evidence.order.index(pair[1]))
        order = ", ".join(f"{key} = {joint}" for key, joint in pairs if key != joint)
        other = " (Unitree's begin with FR)" if evidence.robot.has_free_base else ""
        how = f"joints {evidence.order_words}, where makers may have another{other}: {order}"
    proposal.say(GUESSED, f"{quantity} is {one.template}, by its name; {how}")
