"""Are the columns what their names say, in all logs alike: signs, units, order of joints?"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import mujoco
import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints
from leapgap.diagnosis.checks.pieces import Pieces, as_logged, departure, spread_starts
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

MEASURED, POINTS, TORQUE = ("joint_pos", "joint_vel", "tau"), ("cmd_pos", "cmd_vel"), ("cmd_tau",)
COMMANDS = (*POINTS, *TORQUE, "cmd_kp", "cmd_kd")
ANGLES = ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel")
MOST_ORDERS = 4  # Up to so many joints every order of them is one
MOST_PAIRS = 7  # Up to so many joints every two may be exchanged, else neighbours, and what is alike in two limbs
FOUR = 4  # Limbs that may be exchanged in pairs
LARGEST_ANGLE = 4.0  # A column in which nothing is larger is in no other unit than rad
PIECES, LENGTH_S, ROWS = 12, 0.05, 4  # Pieces of all logs together; they last so long and have so many rows at least
SEEN = 5.0  # A joint tells something where it departs from even motion by so many standard deviations of its noise
STILL = 1e-9  # A joint that departs from even motion by less, rad or m, counts as if it did by that
UNEXPLAINED = 0.9
"""A joint is in doubt where replays miss so much of its departure from even motion, in the median of the logs: with
columns of something else they miss all of it or more."""
FIRST_LOOK = 4  # Readings are tried on so many of the pieces first, and on all where these speak for one
MOST_READINGS = 4  # So many readings may hold together
AS_GOOD = 0.8  # Another reading is a rival where it makes the gap so many times as much smaller as the best


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
    """Joints that hang on each other, in their order: below the base, or below the world."""
    limbs: dict[int, list[str]] = {}
    bodies = [int(robot.model.jnt_bodyid[robot.model.joint(joint).id]) for joint in joints]
    for joint, body in zip(joints, bodies, strict=True):
        root = body
        while body > 0:
            root = body if body in bodies else root
            body = int(robot.model.body_parentid[body])
        limbs.setdefault(root, []).append(joint)
    return list(limbs.values())


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


@dataclass(frozen=True)
class Judged:
    """The errors that replays make by a reading."""

    missed: np.ndarray  # Share of its departure from even motion that a replay misses, (joints,); root mean squares
    by_log: np.ndarray  # The same of each log, (logs, joints)


class Wiring(Check):
    """What is wrong in all logs alike is no cause: short pieces are replayed by other readings of the columns.

    The statistic is how many times smaller the gap of the joints is by the best reading, in short pieces. A cause may
    well move the gap of a joint by a factor; a reading counts from a larger one on, in every log.
    """

    name = "wiring"
    threshold = 2.5
    place = 9
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Try the readings one after the other, each with those found before."""
        if robot is None or not have_joints(logs, robot.joints):
            return None
        length = 1 + max(ROWS, round(LENGTH_S / float(np.median([log.info.sample_period_s for log in logs]))))
        pieces = Pieces.of(logs, robot, spread_starts(logs, length, PIECES), length)
        if not pieces.logs or not (tells := telling(pieces, robot)).any():
            return None
        first = judged(pieces, as_logged)
        best = first
        found: list[Reading] = []
        rivals: list[str] = []
        few = pieces.some(FIRST_LOOK)
        while len(found) < MOST_READINGS and (doubt := tells & (np.median(best.by_log, axis=0) > UNEXPLAINED)).any():
            doubtful = [robot.joints[k] for k in np.flatnonzero(doubt)]
            before = chain(found)
            by_few = judged(few, before)
            tried = [
                (reading, judged(pieces, chain([*found, reading])))
                for reading in readings(robot, [before(log) for log in pieces.logs], doubtful)
                if gain(by_few, judged(few, chain([*found, reading])), reading, robot, tells) > np.log(threshold) / 2
            ]
            gains = [gain(best, of, reading, robot, tells) for reading, of in tried]
            if not gains or max(gains) < np.log(threshold):
                break
            totals = [
                total(best, of, tells) if gains[k] >= np.log(threshold) else -np.inf for k, (_, of) in enumerate(tried)
            ]
            at = int(np.argmax(totals))
            rivals += [
                reading.says
                for k, (reading, _) in enumerate(tried)
                if k != at and totals[k] > totals[at] + np.log(AS_GOOD)
            ]
            found, best = [*found, tried[at][0]], tried[at][1]
        smaller = size(first.missed, tells) / max(size(best.missed, tells), np.finfo(float).tiny)
        per_log = dict(
            zip(dict.fromkeys(pieces.of_log), (float(size(own, tells)) for own in first.by_log), strict=True)
        )
        if not found:
            says = "no other sign, unit or order of the joints' columns fits the model better"
            return CheckResult(self.name, True, 1.0, threshold, says, per_log)
        says = f"read as {' and '.join(reading.says for reading in found)}, the gap is {smaller:.2g} times smaller"
        says += f" (or {'; '.join(rivals)})" if rivals else ""
        return CheckResult(self.name, False, float(smaller), threshold, says, per_log)


def chain(found: Sequence[Reading]) -> Callable[[Log], Log]:
    """Several readings one after the other."""

    def read(log: Log) -> Log:
        for reading in found:
            log = reading.read(log)
        return log

    return read


def telling(pieces: Pieces, robot: Robot) -> np.ndarray:
    """Whether each joint departs from even motion visibly, bool, (joints,)."""
    return np.sqrt((pieces.moved**2).mean(axis=(0, 1))) > SEEN * pieces.resolved


def judged(pieces: Pieces, read: Callable[[Log], Log]) -> Judged:
    """The errors of replays by a reading."""
    simulated, measured = pieces.motions(read)
    moved = np.stack([departure(read(log), pieces.robot) for log in pieces.logs])
    wrong = np.nan_to_num((simulated - measured) ** 2, nan=1e6, posinf=1e6).mean(axis=1)
    square = (moved**2).mean(axis=1)
    names = np.array(pieces.of_log)
    of_logs = [names == name for name in dict.fromkeys(pieces.of_log)]
    by_log = [missed_of(wrong[own], square[own]) for own in of_logs]
    return Judged(missed_of(wrong, square), np.array(by_log))


def missed_of(wrong: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Root mean square of errors over that of motions, (joints,), from mean squares (pieces, joints)."""
    return np.asarray(np.sqrt(wrong.sum(axis=0) / np.maximum(square.sum(axis=0), STILL**2)))


def logs_of(missed: np.ndarray) -> np.ndarray:
    """Logarithms of shares, of any shape, that may be zero."""
    return np.asarray(np.log(np.maximum(missed, np.finfo(float).tiny)))


def total(before: Judged, after: Judged, tells: np.ndarray) -> float:
    """Sum over joints of the logarithms of how many times less is missed."""
    return float((logs_of(before.missed) - logs_of(after.missed))[tells].sum())


def gain(before: Judged, after: Judged, reading: Reading, robot: Robot, tells: np.ndarray) -> float:
    """Logarithm of how many times less is missed of the joints that a reading concerns; that of the worst log, if less.

    Joints that it does not concern may not come off much worse.
    """
    own = np.array([joint in reading.joints for joint in robot.joints]) & tells
    if not own.any():
        return 0.0
    ratio = logs_of(before.missed) - logs_of(after.missed)
    of_logs = (logs_of(before.by_log) - logs_of(after.by_log))[:, own].mean(axis=1)
    others = float(np.minimum(ratio[tells & ~own], 0.0).sum())
    return float(min(ratio[own].mean(), 2 * np.median(of_logs), 4 * of_logs.min())) + others


def size(missed: np.ndarray, tells: np.ndarray) -> float:
    """Root mean square of what is missed, (joints,), of those that tell something."""
    return float(np.sqrt(np.mean(missed[tells] ** 2)))
