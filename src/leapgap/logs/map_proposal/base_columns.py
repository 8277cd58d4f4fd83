"""Columns of the base of a robot, by name: attitude, gyro, accelerometer, velocity, position."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.derivatives import angular_velocity
from leapgap.logs.importers.column_map import GRAVITY
from leapgap.logs.map_proposal.evidence import (
    ABSENT,
    CLEAR,
    GUESSED,
    SURE,
    Draft,
    factors,
    mean_rates,
    mean_values,
    rows_meant,
    usable_rows,
)
from leapgap.logs.map_proposal.joint_columns import words
from leapgap.logs.map_proposal.unit_readings import nearest
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_QUATERNION, QUANTITIES
from leapgap.robot.rotations import continuous, upright_cosine

ORDERS = {"w x y z": [0, 1, 2, 3], "x y z w": [3, 0, 1, 2]}  # order of the columns → indices of w, x, y, z in them
UNLIKE = 0.6  # correlation below which a quaternion does not turn as a gyro says
NEAR, APART = 0.15, 0.35
"""Distance of two directions of gravity, of length 1, up to which they are the same; and from which on they are not."""
UPRIGHT = 0.7  # cosine of the largest tilt of a base that stands
FEWEST = 40


@dataclass(frozen=True)
class Attitude:
    """One reading of four columns as an attitude, and how sure it is."""

    columns: tuple[str, ...]
    order: str  # of the columns, one of ``ORDERS``
    inverse: bool = False  # whether it turns axes of the world into those of the base, the inverse of what a log holds
    known: str = GUESSED
    why: str = "nothing decides it"

    @property
    def words(self) -> str:
        """The order in words."""
        return f"{self.order}, world to base, which is turned round" if self.inverse else self.order

    def of(self, values: np.ndarray) -> np.ndarray:
        """Quaternions w x y z, base to world, of length 1, from the columns, (rows, 4)."""
        found = values[:, ORDERS[self.order]] * ([1, -1, -1, -1] if self.inverse else [1, 1, 1, 1])
        return continuous(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12))


def together(columns: Sequence[str], draft: Draft) -> tuple[np.ndarray, np.ndarray]:
    """Clock, (rows,), and some columns, (rows, n), in the rows where all are finite and the time increases."""
    values = np.stack([draft.table.numbers(column) for column in columns], axis=1)
    clock = draft.time if draft.time is not None else np.arange(float(len(values)))
    rows = usable_rows(clock, values)
    return clock[rows], values[rows]


def rates_beside(
    time: np.ndarray, quaternion: np.ndarray, gyro: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean angular velocities of turning quaternions in axes of the base and in those of the world, and of a gyro."""
    half = max(1, rows_meant(float(np.median(np.diff(time)))) // 2)
    middle = quaternion[half:-half]
    turn = angular_velocity(middle, mean_rates(time, quaternion, 2 * half))
    return turn, turned(middle, turn), mean_values(time, gyro, 2 * half)


def agreement(first: np.ndarray, second: np.ndarray) -> float:
    """Correlation of two vectors, (rows, 3), over all axes at once: 1 where one is the other times a factor."""
    size = np.linalg.norm(first) * np.linalg.norm(second)
    return float((first * second).sum() / size) if size > 0 else 0.0


def attitude_by_physics(found: Mapping[str, Sequence[str]], gravity: str, draft: Draft, named: bool) -> Attitude:
    """The reading that gyro, gravity and accelerometer leave; ``named`` keeps the order, which names state."""
    orders, columns = ["w x y z"] if named else list(ORDERS), tuple(found["base_quat"])
    every = [Attitude(columns, order, inverse) for inverse in (False, True) for order in orders]
    left, fits, why = every, every, []
    for judge, name, says in (
        (by_gyro, "base_angvel", "so it turns as the gyro says"),
        (by_gravity, gravity, "so gravity points where it is logged"),
        (by_gravity, "imu_acc", "so the accelerometer feels gravity"),
    ):
        if name not in found:
            continue
        time, values = together([*found["base_quat"], *found[name]], draft)
        if len(time) < FEWEST:
            continue
        verdicts = [judge(one.of(values[:, :4]), values[:, 4:], time, -1 if name == gravity else 1) for one in every]
        if True in verdicts:
            left = [one for one, verdict in zip(every, verdicts, strict=True) if one in left and verdict is not False]
            fits = [one for one, verdict in zip(every, verdicts, strict=True) if one in fits and verdict is True]
            why.append(says)
    _, values = together(found["base_quat"], draft)
    candidates = (fits if why else left) or every
    candidates = sorted(candidates, key=lambda one: (one.inverse, not heads_forward(one.of(values))))
    standing = [one for one in candidates if is_upright(one.of(values))]
    best = (standing or candidates)[0]
    known = SURE if why and left == fits == [best] and not best.inverse else GUESSED
    if 0 < len(standing) < len(candidates):
        why.append("so it stands at first")
    rivals = [one.words for one in left if one != best and (one in standing or not standing)]
    also = f"; {' or '.join(rivals)} would do as well" if rivals else ""
    return replace(best, known=known, why=(" and ".join(why) or "nothing decides it") + also)


def by_gyro(quaternion: np.ndarray, gyro: np.ndarray, time: np.ndarray, _: int) -> bool | None:
    """Whether an attitude turns as a gyro says, in axes of the base or of the world; None where that is not clear."""
    turn, of_world, rate = rates_beside(time, quaternion, gyro)
    best = max(agreement(turn, rate), agreement(of_world, rate))
    return True if best > CLEAR else False if best < UNLIKE else None


def by_gravity(quaternion: np.ndarray, felt: np.ndarray, _: np.ndarray, sign: int) -> bool | None:
    """Whether the vertical is where a vector in axes of the base says; None where that is not clear."""
    vertical = sign * turned(quaternion * [1, -1, -1, -1], np.array([[0.0, 0.0, 1.0]]))
    length = np.maximum(np.linalg.norm(felt, axis=1, keepdims=True), 1e-12)
    apart = float(np.median(np.linalg.norm(felt / length - vertical, axis=1)))
    return True if apart < NEAR else False if apart > APART else None


def turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors, (rows, 3), turned by quaternions: from axes of the base into those of the world."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    return vector + 2 * np.cross(v, np.cross(v, vector) + w * vector)


def is_upright(quaternion: np.ndarray) -> bool:
    """Whether the base stands in the first tenth of the rows."""
    first = quaternion[: max(1, len(quaternion) // 10)]
    return len(first) > 0 and bool(np.median(upright_cosine(first)) > UPRIGHT)


def heads_forward(quaternion: np.ndarray) -> bool:
    """Whether the base at first is turned by less than a right angle, as most logs begin."""
    return len(quaternion) > 0 and bool(abs(quaternion[0, 0]) > 0.7)


GRAVITY_OF_BASE = "gravity"  # direction of gravity in base axes, of length 1: in no log, but it tells the attitude
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
FAST = 15.0  # rates of a base, rad/s, above which they are rather in degrees
LAST = re.compile(r"^(.*?)(?:\[(\d)\]|[._/]?([wxyzWXYZ]|\d))$")
COLUMNS = {
    name: QUANTITIES[name].columns for name in ("base_quat", "base_angvel", "imu_acc", "base_linvel", "base_pos")
}


def base_columns(columns: Sequence[str]) -> dict[str, list[str]]:
    """Quantity of the base → its columns: x y z, of an attitude four as the file has them, w x y z where it says so."""
    groups: dict[str, dict[str, str]] = defaultdict(dict)
    for column in columns:
        if found := LAST.match(column):
            groups[found[1]][(found[2] or found[3]).lower()] = column
    chosen: dict[str, list[str]] = {}
    for head, parts in groups.items():
        # The quantity of the base that the words of a name speak of
        said = set(words(head))
        spoken = next((quantity for pair, quantity in PAIRS.items() if set(pair) <= said), None)
        spoken = spoken or next((quantity for quantity, known in WORDS.items() if said & known), None)
        if spoken is None and len(said - BODIES) == 1:
            spoken = LETTERS.get(*(said - BODIES))
        quantity = None if spoken in ("base_linvel", "base_pos") and not said & BODIES else spoken
        keys = ("w", "x", "y", "z") if quantity == "base_quat" else ("x", "y", "z")
        numbers = tuple(str(i) for i in range(len(keys)))
        for names in (keys, numbers):
            if quantity is not None and set(names) == set(parts):
                chosen.setdefault(quantity, [parts[name] for name in names])
    return chosen


def find_base(columns: Sequence[str], draft: Draft) -> None:
    """Attitude, gyro and what else is known of the base; how they go together says what their names do not."""
    found = base_columns(columns)
    attitude = None
    if "base_quat" in found:
        named = {"w", "x"} <= {column[-1].lower() for column in found["base_quat"]}
        attitude = attitude_by_physics(found, GRAVITY_OF_BASE, draft, named)
        if not named or attitude.inverse or attitude.order != "w x y z":
            known = SURE if attitude.known == SURE and draft.time_known == SURE else GUESSED
            draft.say(known, f"the quaternion of the base is {attitude.words}: {attitude.why}")
        found["base_quat"] = [attitude.columns[i] for i in ORDERS[attitude.order]]
        if attitude.inverse:
            for column in BASE_QUATERNION[1:]:
                draft.put("factors", column, -1.0)
    judge_gyro(found, attitude, draft)
    judge_accelerometer(found, draft)
    judge_velocity(found, attitude, draft)
    for quantity, ours in COLUMNS.items():
        for own, column in zip(ours, found.get(quantity, ()), strict=False):
            draft.put("columns", own, column)
        if quantity in found:
            draft.say(GUESSED, f"{quantity} is {', '.join(found[quantity])}, by the names")
    lacking = ", ".join(name for name in COLUMNS if name not in found)
    if lacking:
        draft.say(ABSENT, f"{lacking} of the base: left out, as not measured")


def judge_gyro(found: dict[str, list[str]], attitude: Attitude | None, draft: Draft) -> None:
    """The unit and the axes of the gyro, by the rate of the quaternion."""
    if "base_angvel" not in found:
        return
    fits, of_base, factor = False, True, 1.0
    if attitude and draft.time is not None:
        time, values = together([*attitude.columns, *found["base_angvel"]], draft)
        if len(time) >= FEWEST:
            turn, of_world, gyro = rates_beside(time, attitude.of(values[:, :4]), values[:, 4:])
            base, world = agreement(turn, gyro), agreement(of_world, gyro)
            fits, of_base = max(base, world) >= CLEAR, base >= world - 0.05
            factor = float(factors((turn if of_base else of_world).reshape(-1, 1), gyro.reshape(-1, 1))[0])
    stated_world = "w" in words(LAST.sub(r"\1", found["base_angvel"][0]))
    if (fits and not of_base) or (not fits and stated_world):
        draft.say(ABSENT, f"{found.pop('base_angvel')[0]} …: left out, it turns in axes of the world, not of the base")
        return
    unit = nearest(factor, "rad/s") if fits and factor > 0 else None
    known, says = GUESSED, ": the quaternion turns so"
    if unit is None:
        size = np.linalg.norm(together(found["base_angvel"], draft)[1], axis=1)
        unit = "deg/s" if np.quantile(size, 0.9) > FAST else "rad/s"
        why = "the quaternion does not turn as it says, so that nothing decides it" if attitude else "no quaternion"
        says = f", by its size: {why}"
    elif draft.time_known == SURE and not (attitude and attitude.inverse):
        known = SURE
    draft.put_units(BASE_ANGULAR_VELOCITY, unit, "rad/s")
    draft.say(known, f"the gyro is in {unit}{says}")


def judge_accelerometer(found: dict[str, list[str]], draft: Draft) -> None:
    """The unit of accelerations: they are mostly as long as gravity; what lacks gravity is left out."""
    if "imu_acc" not in found:
        return
    length = float(np.median(np.linalg.norm(together(found["imu_acc"], draft)[1], axis=1)))
    unit = nearest(GRAVITY / max(length, 1e-9), "m/s²", within=0.3)
    if unit is None:
        says = f"it is mostly {length:.3g} long, which is gravity in no unit"
        draft.say(ABSENT, f"{found.pop('imu_acc')[0]} …: left out as accelerometer, {says}")
        return
    draft.put_units(COLUMNS["imu_acc"], unit, "m/s²")
    draft.say(GUESSED, f"the accelerometer is in {unit}: it is mostly as long as gravity")


def judge_velocity(found: dict[str, list[str]], attitude: Attitude | None, draft: Draft) -> None:
    """Whether the velocity of the base is in axes of the world, as a log has it, by the position and by its name."""
    if "base_linvel" not in found:
        return
    said = words(LAST.sub(r"\1", found["base_linvel"][0]))
    in_base = "b" in said or "body" in said
    if attitude is not None and "base_pos" in found and draft.time is not None:
        time, both = together([*found["base_pos"], *found["base_linvel"], *attitude.columns], draft)
        velocities = (both[:, 3:6], turned(attitude.of(both[:, 6:]), both[:, 3:6]))
        rows = rows_meant(float(np.median(np.diff(time))))
        speed = mean_rates(time, both[:, :3], rows)
        world, base = (agreement(speed, mean_values(time, one, rows)) for one in velocities)
        in_base = base > world + 0.1 if max(world, base) > CLEAR else in_base
    if in_base:
        draft.say(
            ABSENT, f"{found.pop('base_linvel')[0]} …: left out, a velocity in axes of the base, not of the world"
        )
    else:
        draft.say(GUESSED, "the velocity of the base is in axes of the world, of the origin of the base")
