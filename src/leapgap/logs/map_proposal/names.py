"""Which quantity, and of which joint, a column may be by its name."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

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
    members: dict[str, str]
    """What stands for ``*`` → the column, in the order of the file."""
    joints: dict[str, str]
    """What stands for ``*`` → the joint of the robot that it names; empty where it is a number or another word."""
    quantity: str
    preference: int
    """More of it: rather this family for its quantity."""

    @property
    def numbered(self) -> bool:
        """Whether numbers stand for the joints."""
        return all(key.isdigit() for key in self.members)


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


def aliases(joint: str) -> list[str]:
    """Names by which a joint may be called: its own, and that without the word joint."""
    short = re.sub(r"_?joint_?", "", joint, flags=re.IGNORECASE)
    return [joint, *([short] if len(short) > 1 and not short.isdigit() and short != joint else [])]


def joint_in(column: str, joints: Sequence[str]) -> tuple[int, int, str] | None:
    """Where a joint's name stands in a column's, and which joint: the longest name that does."""
    found = []
    for joint in joints:
        for alias in aliases(joint):
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
