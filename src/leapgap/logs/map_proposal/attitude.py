"""How a quaternion of the base is to be read, by what else tells how the base lies and turns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.derivatives import angular_velocity
from leapgap.logs.map_proposal.physics import CLEAR, factors, mean_rates, mean_values, rows_meant, usable_rows
from leapgap.logs.map_proposal.proposal import GUESSED, SURE, Evidence
from leapgap.robot.rotations import continuous, upright_cosine

ORDERS = {"w x y z": (0, 1, 2, 3), "x y z w": (3, 0, 1, 2)}
"""Order of the columns → indices of w, x, y, z in them."""
UNLIKE = 0.6
"""Correlation below which a quaternion does not turn as a gyro says."""
NEAR, APART = 0.15, 0.35
"""Distance of two directions of gravity, of length 1, up to which they are the same; and from which on they are not."""
UPRIGHT = 0.7
"""Cosine of the largest tilt of a base that stands."""
FEWEST = 40


@dataclass(frozen=True)
class Attitude:
    """One reading of four columns as an attitude, and how sure it is."""

    columns: tuple[str, ...]
    order: tuple[int, ...]
    """Indices of w, x, y, z in the columns."""
    inverse: bool = False
    """Whether it turns axes of the world into those of the base, the inverse of what a log holds."""
    known: str = GUESSED
    why: str = "nothing decides it"

    @property
    def words(self) -> str:
        """The order in words."""
        order = next(words for words, order in ORDERS.items() if order == self.order)
        return f"{order}, world to base, which is turned round" if self.inverse else order

    @property
    def is_straight(self) -> bool:
        """Whether the columns are w x y z, base to world, as they stand."""
        return self.order == ORDERS["w x y z"] and not self.inverse

    def of(self, values: np.ndarray) -> np.ndarray:
        """Quaternions w x y z, base to world, of length 1, from the columns, (rows, 4)."""
        found = values[:, list(self.order)] * ([1, -1, -1, -1] if self.inverse else [1, 1, 1, 1])
        return continuous(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12))


def together(columns: Sequence[str], evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Clock, (rows,), and some columns, (rows, n), in the rows where all are finite and the time increases."""
    values = np.stack([evidence.table.numbers(column) for column in columns], axis=1)
    clock = evidence.time if evidence.time is not None else np.arange(float(len(values)))
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


def attitude_by_physics(found: Mapping[str, Sequence[str]], gravity: str, evidence: Evidence, named: bool) -> Attitude:
    """The reading that gyro, gravity and accelerometer leave; ``named`` keeps the order, which names state."""
    orders = [ORDERS["w x y z"]] if named else list(ORDERS.values())
    columns = tuple(found["base_quat"])
    every = [Attitude(columns, order, inverse) for inverse in (False, True) for order in orders]
    left, fits, why = every, every, []
    for judge, name, says in (
        (by_gyro, "base_angvel", "so it turns as the gyro says"),
        (by_gravity, gravity, "so gravity points where it is logged"),
        (by_gravity, "imu_acc", "so the accelerometer feels gravity"),
    ):
        if name not in found:
            continue
        time, values = together([*found["base_quat"], *found[name]], evidence)
        if len(time) < FEWEST:
            continue
        verdicts = [judge(one.of(values[:, :4]), values[:, 4:], time, -1 if name == gravity else 1) for one in every]
        if True in verdicts:
            left = [one for one, verdict in zip(every, verdicts, strict=True) if one in left and verdict is not False]
            fits = [one for one, verdict in zip(every, verdicts, strict=True) if one in fits and verdict is True]
            why.append(says)
    _, values = together(found["base_quat"], evidence)
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


def own_rate(attitude: Attitude, found: Mapping[str, Sequence[str]], evidence: Evidence) -> tuple[bool, bool, float]:
    """Whether a gyro turns as the attitude does, whether in axes of the base, and its factor to rad/s."""
    time, values = together([*found["base_quat"], *found["base_angvel"]], evidence)
    if len(time) < FEWEST or evidence.time is None:
        return False, True, 1.0
    quaternion, gyro = attitude.of(values[:, :4]), values[:, 4:]
    turn, of_world, gyro = rates_beside(time, quaternion, gyro)
    base, world = agreement(turn, gyro), agreement(of_world, gyro)
    if max(base, world) < CLEAR:
        return False, True, 1.0
    of_base = base >= world - 0.05
    size = factors((turn if of_base else of_world).reshape(-1, 1), gyro.reshape(-1, 1))
    return True, of_base, float(size[0])
