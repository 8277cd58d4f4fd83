"""Columns of the base of a robot: attitude, gyro, accelerometer, position, by name and by how they go together."""

import re
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.importers.tables import Table
from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.names import words
from leapgap.logs.map_proposal.physics import CLEAR, correlations, named_factor
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, SURE, Evidence, Proposal
from leapgap.logs.missing_velocities import angular_velocity
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, QUANTITIES
from leapgap.robot.rotations import continuous

WORDS = {
    "base_quat": {"quat", "quaternion", "orientation"},
    "base_angvel": {"gyro", "gyroscope", "angvel", "angular"},
    "imu_acc": {"acc", "accel", "accelerometer", "acceleration"},
    "base_linvel": {"linvel", "linear"},
    "base_pos": {"position", "pos"},
}
"""Words that name a quantity of the base, looked for in this order."""
LETTERS = {"q": "base_quat", "g": "base_angvel", "w": "base_angvel", "a": "imu_acc"}
"""Letters that stand for a quantity where a name has nothing else but a word for the body: ``imu_qx``, ``gx``."""
BODIES = {"base", "trunk", "body", "pelvis", "root", "torso", "odom", "imu", "pose"}
"""Words one of which must stand beside a position or a velocity, for joints have those too."""
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
    found = next((quantity for quantity, known in WORDS.items() if said & known), None)
    if found is None and len(said - BODIES) == 1:
        found = LETTERS.get(*(said - BODIES))
    return None if found in ("base_linvel", "base_pos") and not said & BODIES else found


def turn_and_rate(
    table: Table, attitude: Sequence[str], gyro: Sequence[str], time: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rates of the turning quaternion ``attitude`` (rows, 3), rad/s, w first, and what the gyro says (rows, 3)."""
    turn = np.stack([table.numbers(column) for column in attitude], axis=1)
    rate = np.stack([table.numbers(column) for column in gyro], axis=1)
    rows = np.flatnonzero(np.isfinite(np.concatenate([turn, rate], axis=1)).all(axis=1))
    rows = rows[np.concatenate([[True], np.diff(time[rows]) > 0])]
    quaternion = continuous(turn[rows])
    slope = velocity_fit(time[rows], quaternion, 10 * float(np.median(np.diff(time[rows])))).velocity
    return angular_velocity(quaternion, slope), rate[rows]


def together(turn: np.ndarray, rate: np.ndarray) -> float:
    """Mean correlation of two rates, (rows, 3), over the axes that move."""
    found = np.diag(correlations(turn, rate))
    return float(np.nanmean(found)) if np.isfinite(found).any() else 0.0


def real_part_last(table: Table, attitude: Sequence[str], gyro: Sequence[str], time: np.ndarray) -> bool | None:
    """Whether a quaternion is x y z w, by which order turns as the gyro says; None where neither does clearly."""
    orders = (attitude, real_part_first(attitude))
    scores = [together(*turn_and_rate(table, order, gyro, time)) for order in orders]
    if max(scores) < CLEAR or abs(scores[0] - scores[1]) < 0.1:
        return None
    return scores[1] > scores[0]


def real_part_first(attitude: Sequence[str]) -> list[str]:
    """The columns of a quaternion x y z w as w x y z."""
    return [*attitude[3:], *attitude[:3]]


def judge_gyro(found: dict[str, list[str]], evidence: Evidence, proposal: Proposal) -> None:
    """The unit of the gyro, by the rate of the quaternion."""
    if evidence.time is None or not {"base_quat", "base_angvel"} <= found.keys():
        proposal.say(GUESSED, "the gyro is in rad/s: no turning quaternion decides it")
        return
    turn, rate = turn_and_rate(evidence.table, found["base_quat"], found["base_angvel"], evidence.time)
    unit = None
    if together(turn, rate) > CLEAR:
        unit = named_factor(float((turn * rate).sum() / max(float((rate**2).sum()), 1e-300)), "rad/s")
    if unit is None or unit[1] < 0:
        proposal.say(
            GUESSED, "the gyro is in rad/s: the quaternion does not turn as it says, so that nothing decides it"
        )
        return
    if UNITS["rad/s"][unit[0]] != 1:
        for column in BASE_ANGULAR_VELOCITY:
            proposal.put("units", column, unit[0])
    proposal.say(SURE, f"the gyro is in {unit[0]}: the quaternion turns so")


def find_base(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """Attitude, gyro and what else is known of the base; the gyro says in which order a quaternion is."""
    found = base_columns(columns)
    if "base_quat" in found and not {"w", "x"} <= {column[-1].lower() for column in found["base_quat"]}:
        last = None
        if "base_angvel" in found and evidence.time is not None:
            last = real_part_last(evidence.table, found["base_quat"], found["base_angvel"], evidence.time)
        if last:
            found["base_quat"] = real_part_first(found["base_quat"])
        kind, how = (GUESSED, "no gyro decides it") if last is None else (SURE, "so it turns as the gyro says")
        proposal.say(kind, f"the quaternion of the base is {'x y z w' if last else 'w x y z'}: {how}")
    if "base_angvel" in found:
        judge_gyro(found, evidence, proposal)
    for quantity, theirs in found.items():
        for ours, column in zip(COLUMNS[quantity], theirs, strict=True):
            proposal.put("columns", ours, column)
        proposal.say(GUESSED, f"{quantity} is {', '.join(theirs)}, by the names")
    lacking = ", ".join(name for name in COLUMNS if name not in found)
    if lacking:
        proposal.say(MISSING, f"{lacking} of the base: left out, as not measured")
