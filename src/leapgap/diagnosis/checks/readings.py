"""Readings of a log's columns that people mix up: signs, units, order of joints."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import mujoco
import numpy as np

from leapgap.logs.log import Log
from leapgap.robot.model import Robot

MEASURED, POINTS, TORQUE = ("joint_pos", "joint_vel", "tau"), ("cmd_pos", "cmd_vel"), ("cmd_tau",)
COMMANDS = (*POINTS, *TORQUE, "cmd_kp", "cmd_kd")
ANGLES = ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel")
MOST_ORDERS = 4  # Up to so many joints every order of them is one
MOST_PAIRS = 7  # Up to so many joints every two may be exchanged, else neighbours, and what is alike in two limbs
FOUR = 4  # Limbs that may be exchanged in pairs
LARGEST_ANGLE = 4.0  # A column in which nothing is larger is in no other unit than rad


@dataclass(frozen=True)
class Reading:
    """One way to read the columns."""

    says: str
    joints: tuple[str, ...]  # Those that it concerns
    read: Callable[[Log], Log]


def readings(robot: Robot, logs: Sequence[Log], doubtful: Sequence[str]) -> Iterator[Reading]:
    """What may be mixed up of joints that do not move as the model says; ``logs`` show which columns there are."""
    joints = tuple(joint for joint in robot.joints if joint in logs[0].joints)
    doubted = tuple(joint for joint in joints if joint in doubtful)
    for group in [*((joint,) for joint in doubted), *([doubted] if len(doubted) > 1 else [])]:
        yield from of_group(group, logs, robot)
    for one, other in pairs(robot, joints):
        if one in doubtful or other in doubtful:
            swapped = {one: other, other: one}
            yield Reading(f"{one} and {other} exchanged", (one, other), exchange(swapped, (*MEASURED, *COMMANDS)))
            yield Reading(f"commands of {one} and {other} exchanged", (one, other), exchange(swapped, COMMANDS))
            yield Reading(f"measurements of {one} and {other} exchanged", (one, other), exchange(swapped, MEASURED))
    for says, order in orders(robot, joints):
        moved = {joint: of for joint, of in zip(joints, order, strict=True) if joint != of}
        if len(moved) > 2:
            yield Reading(says, tuple(moved), exchange(moved, (*MEASURED, *COMMANDS)))
            yield Reading(f"{says}, in the commands alone", tuple(moved), exchange(moved, COMMANDS))
            yield Reading(f"{says}, in the measurements alone", tuple(moved), exchange(moved, MEASURED))


def of_group(joints: tuple[str, ...], logs: Sequence[Log], robot: Robot) -> Iterator[Reading]:
    """Signs and units of some joints' columns."""
    named = ", ".join(joints)

    def largest(quantity: str) -> float:
        columns = [log[f"{quantity}/{joint}"] for log in logs for joint in joints if f"{quantity}/{joint}" in log]
        return max((float(np.abs(values).max()) for values in columns), default=0.0)

    signs = [
        ("set points of {} with the other sign", POINTS),
        ("measurements of {} with the other sign", MEASURED),
        ("{} turned round", (*MEASURED, *POINTS, *TORQUE)),
    ]
    if largest("cmd_tau") > 0:
        signs.append(("feed-forward torques of {} with the other sign", TORQUE))
    for says, quantities in signs:
        yield Reading(says.format(named), joints, scale(joints, quantities, -1.0))
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    hinges = [joint for joint in joints if robot.model.joint(joint).type[0] == hinge]
    degree = np.pi / 180
    if hinges and largest("joint_pos") > LARGEST_ANGLE:
        yield Reading(f"measurements of {named} in degrees", joints, scale(hinges, ANGLES[:2], degree))
        yield Reading(f"{named} in degrees", joints, scale(hinges, ANGLES, degree))
    if hinges and largest("cmd_pos") > LARGEST_ANGLE:
        yield Reading(f"set points of {named} in degrees", joints, scale(hinges, POINTS, degree))
    ranged = all(np.ptp(robot.model.joint(joint).range) > 0 for joint in joints)
    if ranged and max(largest("joint_pos"), largest("cmd_pos")) > LARGEST_ANGLE:
        for says, quantities in (("{} in percent of their ranges", ANGLES), ("set points of {} in percent", POINTS)):
            for low in (-100.0, 0.0):
                words = says.format(named) + f" ({low:g} to 100)"
                yield Reading(words, joints, percent(joints, quantities, low, robot))


def pairs(robot: Robot, joints: Sequence[str]) -> list[tuple[str, str]]:
    """Joints that may be exchanged."""
    if len(joints) <= MOST_PAIRS:
        return list(combinations(joints, 2))
    near = [(one, other) for one, other in combinations(joints, 2) if 0 < joints.index(other) - joints.index(one) <= 2]
    limbs = limbs_of(joints, robot)
    alike = [pair for a, b in combinations(limbs, 2) if len(a) == len(b) for pair in zip(a, b, strict=True)]
    return list(dict.fromkeys([*near, *alike]))


def limbs_of(joints: Sequence[str], robot: Robot) -> list[list[str]]:
    """Joints that hang on each other, in their order."""
    limbs: dict[int, list[str]] = {}
    for joint in joints:
        body = int(robot.model.jnt_bodyid[robot.model.joint(joint).id])
        limbs.setdefault(root_of(robot, body, joints), []).append(joint)
    return list(limbs.values())


def root_of(robot: Robot, body: int, joints: Sequence[str]) -> int:
    """The outermost body of the limb of a body: below the base, or below the world."""
    ids = {int(robot.model.jnt_bodyid[robot.model.joint(joint).id]) for joint in joints}
    root = body
    while body > 0:
        root = body if body in ids else root
        body = int(robot.model.body_parentid[body])
    return root


def orders(robot: Robot, joints: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Usual other orders of all joints: limb by limb against kind by kind, limbs exchanged, and from the last."""
    limbs = limbs_of(joints, robot)
    if len(limbs) > 1 and len({len(limb) for limb in limbs}) == 1:
        by_kind = [limb[k] for k in range(len(limbs[0])) for limb in limbs]
        yield "joints in the order kind by kind, not limb by limb", inverse(joints, by_kind)
        yield "joints in the order limb by limb, not kind by kind", by_kind
        for a, b in combinations(range(len(limbs)), 2):
            changed = list(limbs)
            changed[a], changed[b] = changed[b], changed[a]
            says = f"the limbs of {limbs[a][0]} and {limbs[b][0]} exchanged"
            yield says, rearranged(joints, limbs, changed)
        if len(limbs) == FOUR:
            one, two, three, four = limbs
            yield "the first two limbs exchanged, and the last two", rearranged(joints, limbs, [two, one, four, three])
            yield "the first two limbs and the last two exchanged", rearranged(joints, limbs, [three, four, one, two])
    if len(joints) <= MOST_ORDERS:
        for order in permutations(joints):
            yield f"{', '.join(joints)} being {', '.join(order)}", list(order)
    else:
        yield "joints in the opposite order", list(reversed(joints))
        yield "joints in the order from the second on", [*joints[1:], joints[0]]
        yield "joints in the order from the last on", [joints[-1], *joints[:-1]]


def rearranged(joints: Sequence[str], limbs: Sequence[Sequence[str]], changed: Sequence[Sequence[str]]) -> list[str]:
    """For each joint the one whose columns it gets where limbs get those of others."""
    of = {joint: got for a, b in zip(limbs, changed, strict=True) for joint, got in zip(a, b, strict=True)}
    return [of[joint] for joint in joints]


def inverse(joints: Sequence[str], order: Sequence[str]) -> list[str]:
    """For each joint the one whose columns it gets where columns in ``order`` were named in the order of the joints."""
    return [joints[list(order).index(joint)] for joint in joints]


def scale(joints: Sequence[str], quantities: Sequence[str], factor: float) -> Callable[[Log], Log]:
    """The reading by which some columns are multiplied."""

    def read(log: Log) -> Log:
        names = [f"{of}/{joint}" for of in quantities for joint in joints]
        return replace(log, columns={**log.columns, **{name: factor * log[name] for name in names if name in log}})

    return read


def percent(joints: Sequence[str], quantities: Sequence[str], low: float, robot: Robot) -> Callable[[Log], Log]:
    """The reading by which some columns are shares of the range, from ``low`` to 100."""

    def read(log: Log) -> Log:
        columns = dict(log.columns)
        for joint in joints:
            first, last = robot.model.joint(joint).range
            for of in quantities:
                if f"{of}/{joint}" in log:
                    share = (columns[f"{of}/{joint}"] - (low if of.endswith("pos") else 0.0)) / (100 - low)
                    columns[f"{of}/{joint}"] = (last - first) * share + (first if of.endswith("pos") else 0.0)
        return replace(log, columns=columns)

    return read


def exchange(source: Mapping[str, str], quantities: Sequence[str]) -> Callable[[Log], Log]:
    """The reading by which some joints get the columns of others."""

    def read(log: Log) -> Log:
        moved = {
            f"{of}/{joint}": log[f"{of}/{other}"]
            for of in quantities
            for joint, other in source.items()
            if f"{of}/{other}" in log and f"{of}/{joint}" in log
        }
        return replace(log, columns={**log.columns, **moved})

    return read
