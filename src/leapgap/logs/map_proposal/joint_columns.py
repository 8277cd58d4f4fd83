"""Which columns of a table are which quantity of which joint, by their names."""

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from leapgap.logs.importers.column_map import UNITS
from leapgap.logs.map_proposal.evidence import GUESSED, MISSING, SPUN_RAD, Draft, inside, real_limits
from leapgap.logs.schema import COMMANDS
from leapgap.robot.model import Robot

POSITION = {"q", "pos", "position", "positions", "angle", "angles", "ang", "qpos", "theta", "joint_pos", "p"}
VELOCITY = {"dq", "qd", "qdot", "vel", "velocity", "velocities", "speed", "omega", "qvel", "rate", "dtheta", "v"}
TORQUE = {"tau", "torque", "torques", "trq", "effort", "u", "moment"}
ANGLE_UNITS, TORQUE_UNITS = {"deg", "degree", "degrees", "rad", "radian", "radians"}, {"nm"}
PER_SECOND, SPEED_UNITS = {"s", "sec", "second", "per"}, {"dps", "rpm", "degs", "rads"}
STIFFNESS, DAMPING = {"kp", "stiffness", "pgain"}, {"kd", "damping", "dgain"}
TIME = {"time", "t", "stamp", "timestamp", "timestamps", "clock", "ts", "times", "elapsed"}
COUNTERS = {"tick", "ticks"}
SECONDS, NANOSECONDS = ("sec", "secs", "seconds", "s"), ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds", "ns")
COMMAND = {
    *("cmd", "command", "commands", "commanded", "des", "desired", "ref", "reference", "target", "set", "setpoint"),
    *("goal", "con", "sent", "action", "actions", "sp", "lowcmd", "clipped", "ctrl", "control", "d"),
}
MEASURED = {
    *("meas", "present", "observation", "obs", "measured", "act", "actual", "state", "fb", "feedback", "lowstate"),
    "joint",
}
SECONDHAND = {"filt", "filtered", "est", "estimated", "smooth", "lpf"}
OTHER = {
    *("acc", "accel", "acceleration", "ddq", "qdd", "fric", "friction", "pert", "err", "error", "temp", "temperature"),
    *("root", "projected", "gravity", "odom", "load", "index", "frame", "episode", "voltage", "max", "min", "limit"),
    *("limits", "mode", "current", "imu", "foot", "base", "gyro", "quat", "quaternion"),
}
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
NUMBER = re.compile(r"\d+")
CHUNK, PART = re.compile(r"[A-Za-z0-9]+"), re.compile(r"[^./\[\]]+")
ANY = "*"


@dataclass(frozen=True)
class Family:
    """Columns whose names differ in one part, such as ``q_*``: one quantity, a column for each joint."""

    template: str
    members: dict[str, str]  # what stands for ``*`` → the column, in the order of the file
    joints: dict[str, str]  # what stands for ``*`` → the joint that it names; empty where numbers or other words do
    quantity: str
    preference: int  # more of it: rather this family for its quantity

    @property
    def keys(self) -> list[str]:
        """What stands for ``*``: numbers in their order, names in that of the file."""
        return sorted(self.members, key=int) if all(map(str.isdigit, self.members)) else list(self.members)


def words(name: str) -> list[str]:
    """Lower-case words and numbers of a name: ``tail_meas_AngVel[2]`` gives tail, meas, ang, vel, 2."""
    return [word.lower() for word in WORD.findall(name)]


def kind_by_unit(found: Sequence[str]) -> str | None:
    """What has the unit that stands in a name, as in ``A1_actual_deg``: positions, velocities or torques."""
    for word, after in pairwise([*found, ""]):
        if word in SPEED_UNITS or (word in ANGLE_UNITS and after in PER_SECOND):
            return "vel"
        if word in ANGLE_UNITS:
            return "pos"
        if word in TORQUE_UNITS:
            return "tau"
    return None


def quantity_by_words(found: Sequence[str]) -> tuple[str, int] | None:
    """The quantity of a joint that some words speak of, and how plainly; None where they speak of something else."""
    said = set(found)
    if said & OTHER:
        return None
    preference = len(said & MEASURED) - 2 * len(said & SECONDHAND) + ("clipped" in said)
    for kind, known in (("kp", STIFFNESS), ("kd", DAMPING)):
        if said & known:
            return f"cmd_{kind}", preference
    said_kind = next(
        (kind for kind, known in (("tau", TORQUE), ("vel", VELOCITY), ("pos", POSITION)) if said & known),
        kind_by_unit(found),
    )
    if said & COMMAND:
        return f"cmd_{said_kind or 'pos'}", preference - (said_kind is None)
    if said_kind is None:
        return ("joint_pos", preference - 1) if "state" in said else None
    return ("tau" if said_kind == "tau" else f"joint_{said_kind}"), preference


def joint_in(column: str, joints: Sequence[str]) -> tuple[int, int, str] | None:
    """Where a joint's name stands in a column's, and which joint: the longest name that does."""
    found = []
    for joint in joints:
        short = re.sub(r"_?joint_?", "", joint, flags=re.IGNORECASE)
        for alias in {joint, short} if len(short) > 1 and not short.isdigit() else {joint}:
            for at in re.finditer(re.escape(alias), column, flags=re.IGNORECASE):
                around = column[max(0, at.start() - 1) : at.start()] + column[at.end() : at.end() + 1]
                if not re.search(r"[a-zA-Z0-9]" if len(alias) < 4 else r"\d", around):
                    found.append((at.start(), at.end(), joint))
    return max(found, key=lambda one: one[1] - one[0], default=None)


def families(columns: Sequence[str], joints: Sequence[str], motors: int | None = None) -> list[Family]:
    """All families of columns that may be a quantity of the joints, those that name joints first.

    Columns that numbers tell apart are one if they are as many as the joints, or as those with ``motors``.
    """
    fewest = len(joints) if motors is None else motors
    named: dict[str, dict[str, tuple[str, str]]] = defaultdict(dict)
    numbered: dict[str, dict[str, str]] = defaultdict(dict)
    worded: dict[str, dict[str, str]] = defaultdict(dict)
    for column in columns:
        place = joint_in(column, joints)
        if place is not None:
            begin, end, joint = place
            named[f"{column[:begin]}{ANY}{column[end:]}"][column[begin:end]] = (column, joint)
    whole = {column for members in named.values() if len(members) >= fewest for column, _ in members.values()}
    for column in columns:
        if column in whole:
            continue
        for number in NUMBER.finditer(column):
            numbered[f"{column[: number.start()]}{ANY}{column[number.end() :]}"][number.group()] = column
        chunks = [*CHUNK.finditer(column), *(part for part in PART.finditer(column) if "_" in part.group())]
        for chunk in chunks:
            worded[f"{column[: chunk.start()]}{ANY}{column[chunk.end() :]}"][chunk.group()] = column
    found = [
        family(template, {k: c for k, (c, _) in members.items()}, {k: j for k, (_, j) in members.items()})
        for template, members in named.items()
    ]
    found += [family(template, members, {}) for template, members in numbered.items() if len(members) >= fewest]
    if len(joints) == 1:  # nothing has to tell its columns apart
        found += [family(column, {joints[0]: column}, {joints[0]: joints[0]}) for column in columns]
    taken = whole | {column for one in found if one and not one.joints for column in one.members.values()}
    for template, members in worded.items():
        left = {key: column for key, column in members.items() if column not in taken}
        if len(left) > 1 and not any(quantity_by_words(words(key)) for key in left):
            found.append(family(template, left, {}))
    return [one for one in found if one is not None]


def family(template: str, members: dict[str, str], joints: dict[str, str]) -> Family | None:
    """A family, if the words of its template speak of a quantity of joints."""
    quantity = quantity_by_words(words(template.replace(ANY, " ")))
    return None if quantity is None else Family(template, members, joints, *quantity)


def time_columns(columns: Sequence[str]) -> list[str]:
    """Columns that may be the time by their names, the plainest first, counters of ticks last."""
    said = {column: set(words(column)) for column in columns}
    found = [column for column in columns if said[column] & (TIME | COUNTERS) and not said[column] & OTHER]
    return sorted(found, key=lambda column: (not said[column] & TIME, len(words(column)), columns.index(column)))


MODEL = "in the order of the model"


def known_orders(robot: Robot) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Orders of the joints, each with what it is called, the likeliest first."""
    joints = robot.joints
    yield MODEL, joints
    # Number of joints between each joint and the base
    model = robot.model

    def level(body: int) -> int:
        if body == 0:
            return 0
        return level(int(model.body_parentid[body])) + int(np.isin(robot.joint_bodies, body).sum())

    depth = dict(zip(joints, [level(int(model.body_parentid[body])) for body in robot.joint_bodies], strict=True))
    breadth = "kind by kind through the tree of the model (breadth-first, as Isaac Lab has them)"
    yield breadth, tuple(sorted(joints, key=lambda joint: depth[joint]))
    yield f"{breadth}, branches by the alphabet", tuple(sorted(joints, key=lambda joint: (depth[joint], joint)))
    stated = tuple(motor.target for motor in robot.published_spec().actuators)
    if set(stated) == set(joints):
        yield "in the order of the model file's actuators", stated
    yield "by the alphabet", tuple(sorted(joints))


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


def read_families(chosen: dict[str, Family], draft: Draft) -> None:
    """Take each family into the map, with the joints its members are of."""
    joints = draft.robot.joints
    nameless = defaultdict[str, list[str]](list)
    for quantity in OF_JOINTS:
        one = chosen.get(quantity)
        if one is None:
            continue
        if one.joints and not set(one.joints.values()) >= set(joints):
            lacking = ", ".join(joint for joint in joints if joint not in one.joints.values())
            draft.say(MISSING, f"{quantity} of {lacking}: {one.template} names the others only")
            continue
        keys = keys_of(one, draft)
        if keys is None and add_some(quantity, one, draft):
            continue
        if keys is None:
            nameless[", ".join(one.members)].append(f"{quantity}: {one.template}")
            draft.unplaced.add(quantity)
            continue
        add_family(quantity, one, keys, draft)
    for names, entries in nameless.items():
        which = f"which of {names} is which joint ({', '.join(joints)})"
        draft.say(MISSING, f"{which}: state joint_names, {{theirs: the robot's}}, to map {', '.join(entries)}")


def keys_of(one: Family, draft: Draft) -> list[str] | None:
    """What stands for each joint in a family, in our order of joints; None where that cannot be said."""
    joints = draft.robot.joints
    if one.joints:
        by_joint = {joint: key for key, joint in one.joints.items()}
        return [by_joint[joint] for joint in joints]
    if draft.their_joints and set(draft.their_joints) <= set(one.members):
        return draft.their_joints
    keys = keys_in_order(one, draft)
    if len(keys) != len(joints):
        return None
    return [keys[draft.order.index(joint)] for joint in joints]


def keys_in_order(one: Family, draft: Draft) -> list[str]:
    """What stands for ``*`` in a family that names no joints, by number; motors that the robot lacks left out."""
    keys = one.keys
    if len(keys) > len(draft.robot.joints):  # motors that the robot does not have read zero
        keys = [key for key in keys if np.ptp(draft.table.numbers(one.members[key])) > 0]
    return keys


def find_order(chosen: dict[str, Family], draft: Draft) -> None:
    """The order of columns that name no joints: the first known one in which positions lie within their limits.

    In rad or deg; that of the model where none does.
    """
    draft.order, draft.order_words = draft.robot.joints, MODEL
    one = chosen.get("joint_pos")
    if one is None or one.joints:
        return
    keys = keys_in_order(one, draft)
    if len(keys) != len(draft.robot.joints):
        return
    position = np.stack([draft.table.numbers(one.members[key]) for key in keys], axis=1)
    if not np.isfinite(position).any(axis=0).all():
        return
    limits, real = real_limits(draft.robot)
    unit = UNITS["rad"]["rad" if np.nanmax(np.abs(position)) < 1.5 * SPUN_RAD else "deg"]
    low, high = np.nanmin(position, axis=0), np.nanmax(position, axis=0)

    def fits(order: Sequence[str], turned: bool) -> bool:
        at = [order.index(joint) for joint in draft.robot.joints]
        good = inside(low[at] * unit, high[at] * unit, limits)
        return bool((good | (turned & inside(-high[at] * unit, -low[at] * unit, limits)))[real].all())

    every = {order: words for words, order in reversed([*known_orders(draft.robot)])}
    # Joints that count backwards are thought of last
    turned = not any(fits(order, False) for order in every)
    fitting = [order for order in reversed(every) if fits(order, turned)]
    if not fitting:
        return
    draft.order, *others = fitting
    draft.order_words = every[draft.order]
    if draft.order_words != MODEL:
        also = f"; so they would {' and '.join(every[order] for order in others)}" if others else ""
        draft.say(GUESSED, f"joints {draft.order_words}: so positions lie within the joints' limits{also}")


def add_some(quantity: str, one: Family, draft: Draft) -> bool:
    """Add torques of some joints, which the family calls as others did; the other joints have no motor."""
    theirs = draft.their_joints or []
    if quantity not in ("tau", "cmd_tau") or not set(one.members) < set(theirs):
        return False
    idle = []
    values = np.zeros((draft.table.rows, len(theirs)))
    for i, (key, joint) in enumerate(zip(theirs, draft.robot.joints, strict=True)):
        if key in one.members:
            draft.put("columns", f"{quantity}/{joint}", one.members[key])
            values[:, i] = draft.table.numbers(one.members[key])
            continue
        idle.append(joint)
        if quantity == "cmd_tau":
            draft.put("constants", f"cmd_tau/{joint}", 0.0)
    draft.values[quantity] = values
    draft.say(GUESSED, f"{quantity} is {one.template}, by its name; {', '.join(idle)} has none, as without a motor")
    return True


def add_family(quantity: str, one: Family, keys: list[str], draft: Draft) -> None:
    """Add the entries of one family, by ``*`` where the names of joints go with those of the others."""
    joints, known = draft.robot.joints, draft.their_joints == keys
    draft.named |= {quantity} if one.joints else set()
    if draft.their_joints is None:
        draft.their_joints = keys
        renamed = {key: joint for key, joint in zip(keys, joints, strict=True) if key != joint}
        if renamed:
            draft.options["joint_names"] = renamed
    if draft.their_joints == keys:
        draft.put("columns", f"{quantity}/*", one.template)
    else:  # other names than the first family has
        for key, joint in zip(keys, joints, strict=True):
            draft.put("columns", f"{quantity}/{joint}", one.members[key])
    draft.values[quantity] = np.stack([draft.table.numbers(one.members[key]) for key in keys], axis=1)
    if one.joints:
        how = "the joints are named in it"
    elif known:
        how = "its joints are called the same"
    else:
        pairs = sorted(zip(keys, joints, strict=True), key=lambda pair: draft.order.index(pair[1]))
        order = ", ".join(f"{key} = {joint}" for key, joint in pairs if key != joint)
        other = " (Unitree's begin with FR)" if draft.robot.has_free_base else ""
        how = f"joints {draft.order_words}, where makers may have another{other}: {order}"
    draft.say(GUESSED, f"{quantity} is {one.template}, by its name; {how}")
