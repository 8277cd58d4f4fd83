"""Columns of the base of a robot, by name: attitude, gyro, accelerometer, velocity, position."""

import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from leapgap.logs.importers.units import GRAVITY
from leapgap.logs.map_proposal.attitude import Attitude, agreement, attitude_by_physics, own_rate, together, turned
from leapgap.logs.map_proposal.names import words
from leapgap.logs.map_proposal.physics import CLEAR, mean_rates, mean_values, rows_meant
from leapgap.logs.map_proposal.proposal import ABSENT, GUESSED, SURE, Evidence, Proposal
from leapgap.logs.map_proposal.unit_readings import nearest
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, QUANTITIES

GRAVITY_OF_BASE = "gravity"
"""Direction of gravity in base axes, of length 1: no quantity of a log, but it tells the attitude."""
WORDS = {
    "base_quat": {"quat", "quaternion", "orientation"},
    "base_angvel": {"gyro", "gyroscope", "angvel", "angular"},
    "imu_acc": {"acc", "accel", "accelerometer", "acceleration"},
    "base_linvel": {"linvel", "linear"},
    GRAVITY_OF_BASE: {"projected"},
    "base_pos": {"position", "pos"},
}
"""Words that name a quantity of the base, looked for in this order."""
LETTERS = {"q": "base_quat", "g": "base_angvel", "w": "base_angvel", "a": "imu_acc"}
"""Letters that stand for a quantity where a name has nothing else but a word for the body: ``imu_qx``, ``gx``."""
PAIRS = {("ang", "vel"): "base_angvel", ("lin", "vel"): "base_linvel", ("lin", "acc"): "imu_acc"}
"""Words that name a quantity of the base together."""
BODIES = {"base", "trunk", "body", "pelvis", "root", "torso", "odom", "imu", "pose"}
"""Words one of which must stand beside a position or a velocity, for joints have those too."""
FAST = 15.0
"""Rates of a base, rad/s, above which they are rather in degrees."""
LAST = re.compile(r"^(.*?)(?:\[(\d)\]|[._/]?([wxyzWXYZ]|\d))$")
COLUMNS = {
    "base_quat": BASE_QUATERNION,
    "base_angvel": BASE_ANGULAR_VELOCITY,
    "imu_acc": QUANTITIES["imu_acc"].columns,
    "base_linvel": BASE_VELOCITY,
    "base_pos": BASE_POSITION,
}


def base_columns(columns: Sequence[str]) -> dict[str, list[str]]:
    """Quantity of the base → its columns: x y z, of an attitude four as the file has them, w x y z where it says so."""
    groups: dict[str, dict[str, str]] = defaultdict(dict)
    for column in columns:
        found = LAST.match(column)
        if found:
            groups[found[1]][(found[2] or found[3]).lower()] = column
    chosen: dict[str, list[str]] = {}
    for head, parts in groups.items():
        quantity = quantity_of_base(head)
        keys = ("w", "x", "y", "z") if quantity == "base_quat" else ("x", "y", "z")
        numbers = tuple(str(i) for i in range(len(keys)))
        for names in (keys, numbers):
            if quantity is not None and set(names) == set(parts):
                chosen.setdefault(quantity, [parts[name] for name in names])
    return chosen


def quantity_of_base(name: str) -> str | None:
    """The quantity of the base that the words of a name speak of."""
    said = set(words(name))
    found = next((quantity for pair, quantity in PAIRS.items() if set(pair) <= said), None)
    found = found or next((quantity for quantity, known in WORDS.items() if said & known), None)
    if found is None and len(said - BODIES) == 1:
        found = LETTERS.get(*(said - BODIES))
    return None if found in ("base_linvel", "base_pos") and not said & BODIES else found


def find_base(columns: Sequence[str], evidence: Evidence, proposal: Proposal) -> None:
    """Attitude, gyro and what else is known of the base; how they go together says what their names do not."""
    found = base_columns(columns)
    attitude = None
    if "base_quat" in found:
        named = {"w", "x"} <= {column[-1].lower() for column in found["base_quat"]}
        attitude = attitude_by_physics(found, GRAVITY_OF_BASE, evidence, named)
        if not named or not attitude.is_straight:
            known = SURE if attitude.known == SURE and evidence.time_known == SURE else GUESSED
            proposal.say(known, f"the quaternion of the base is {attitude.words}: {attitude.why}")
        found["base_quat"] = [attitude.columns[i] for i in attitude.order]
        if attitude.inverse:
            for column in BASE_QUATERNION[1:]:
                proposal.put("factors", column, -1.0)
    judge_gyro(found, attitude, evidence, proposal)
    judge_accelerometer(found, evidence, proposal)
    judge_velocity(found, attitude, evidence, proposal)
    for quantity, ours in COLUMNS.items():
        for own, column in zip(ours, found.get(quantity, ()), strict=False):
            proposal.put("columns", own, column)
        if quantity in found:
            proposal.say(GUESSED, f"{quantity} is {', '.join(found[quantity])}, by the names")
    lacking = ", ".join(name for name in COLUMNS if name not in found)
    if lacking:
        proposal.say(ABSENT, f"{lacking} of the base: left out, as not measured")


def judge_gyro(found: dict[str, list[str]], attitude: Attitude | None, evidence: Evidence, proposal: Proposal) -> None:
    """The unit and the axes of the gyro, by the rate of the quaternion."""
    if "base_angvel" not in found:
        return
    theirs = {**found, "base_quat": attitude.columns} if attitude else found
    fits, of_base, factor = own_rate(attitude, theirs, evidence) if attitude else (False, True, 1.0)
    stated_world = "w" in words(LAST.sub(r"\1", found["base_angvel"][0]))
    if (fits and not of_base) or (not fits and stated_world):
        proposal.say(
            ABSENT, f"{found.pop('base_angvel')[0]} …: left out, it turns in axes of the world, not of the base"
        )
        return
    unit = nearest(factor, "rad/s") if fits and factor > 0 else None
    known, says = GUESSED, ": the quaternion turns so"
    if unit is None:
        size = np.linalg.norm(together(found["base_angvel"], evidence)[1], axis=1)
        unit = "deg/s" if np.quantile(size, 0.9) > FAST else "rad/s"
        why = "the quaternion does not turn as it says, so that nothing decides it" if attitude else "no quaternion"
        says = f", by its size: {why}"
    elif evidence.time_known == SURE and not (attitude and attitude.inverse):
        known = SURE
    proposal.put_units(BASE_ANGULAR_VELOCITY, unit, "rad/s")
    proposal.say(known, f"the gyro is in {unit}{says}")


def judge_accelerometer(found: dict[str, list[str]], evidence: Evidence, proposal: Proposal) -> None:
    """The unit of accelerations: they are mostly as long as gravity; what lacks gravity is left out."""
    if "imu_acc" not in found:
        return
    length = float(np.median(np.linalg.norm(together(found["imu_acc"], evidence)[1], axis=1)))
    unit = nearest(GRAVITY / max(length, 1e-9), "m/s²", within=0.3)
    if unit is None:
        says = f"it is mostly {length:.3g} long, which is gravity in no unit"
        proposal.say(ABSENT, f"{found.pop('imu_acc')[0]} …: left out as accelerometer, {says}")
        return
    proposal.put_units(COLUMNS["imu_acc"], unit, "m/s²")
    proposal.say(GUESSED, f"the accelerometer is in {unit}: it is mostly as long as gravity")


def judge_velocity(
    found: dict[str, list[str]], attitude: Attitude | None, evidence: Evidence, proposal: Proposal
) -> None:
    """Whether the velocity of the base is in axes of the world, as a log has it, by the position and by its name."""
    if "base_linvel" not in found:
        return
    said = words(LAST.sub(r"\1", found["base_linvel"][0]))
    in_base = "b" in said or "body" in said
    if attitude is not None and "base_pos" in found and evidence.time is not None:
        time, both = together([*found["base_pos"], *found["base_linvel"], *attitude.columns], evidence)
        velocities = (both[:, 3:6], turned(attitude.of(both[:, 6:]), both[:, 3:6]))
        rows = rows_meant(float(np.median(np.diff(time))))
        speed = mean_rates(time, both[:, :3], rows)
        world, base = (agreement(speed, mean_values(time, one, rows)) for one in velocities)
        in_base = base > world + 0.1 if max(world, base) > CLEAR else in_base
    if in_base:
        proposal.say(
            ABSENT, f"{found.pop('base_linvel')[0]} …: left out, a velocity in axes of the base, not of the world"
        )
    else:
        proposal.say(GUESSED, "the velocity of the base is in axes of the world, of the origin of the base")
