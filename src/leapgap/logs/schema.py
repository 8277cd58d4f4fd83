"""The columns of a log as data: name, unit, kind and possible values of each quantity. Every reader goes through it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from leapgap.errors import InputError
from leapgap.robot.topology import PAIRS


@dataclass(frozen=True)
class Quantity:
    """One logged quantity: a column for each component of the base, or one for each joint or foot."""

    name: str
    unit: str
    per: str  # ``base``, ``joint``, ``foot``, ``pair`` or ``log``: one value a row
    meaning: str
    low: float  # values below this one are impossible for any robot, in the quantity's unit
    high: float  # the same of values above
    components: tuple[str, ...] = ()  # suffixes of the name in the columns of the base

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a quantity of the base: ``base_pos_x`` and so on."""
        return tuple(f"{self.name}_{component}" for component in self.components)


PAIR_FORCE_AXES = tuple(f"{pair}_{axis}" for pair in PAIRS for axis in ("x", "z"))
"""Components of a force of each pair of feet: ``front_x``, ``front_z``, ``rear_x``, ``rear_z``."""
XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")

QUANTITIES = {
    quantity.name: quantity
    for quantity in (
        Quantity("base_pos", "m", "base", "origin of the base body in the world", -1e7, 1e7, XYZ),
        Quantity("base_quat", "1", "base", "base to world", -1.01, 1.01, WXYZ),
        Quantity("base_linvel", "m/s", "base", "velocity of that origin in the world", -300, 300, XYZ),
        Quantity("base_angvel", "rad/s", "base", "in base axes, as a gyro reads it", -1e3, 1e3, XYZ),
        Quantity("imu_acc", "m/s²", "base", "acceleration that the IMU measured", -1e5, 1e5, XYZ),
        Quantity("joint_pos", "rad", "joint", "measured position", -1e4, 1e4),
        Quantity("joint_vel", "rad/s", "joint", "measured velocity", -5e3, 5e3),
        Quantity("tau", "N·m", "joint", "measured torque", -1e5, 1e5),
        Quantity("cmd_tau", "N·m", "joint", "feed-forward torque that was sent", -1e5, 1e5),
        Quantity("cmd_pos", "rad", "joint", "set point of the joint PD", -1e4, 1e4),
        Quantity("cmd_vel", "rad/s", "joint", "set point of the joint PD", -5e3, 5e3),
        Quantity("cmd_kp", "N·m/rad", "joint", "gain of the joint PD", 0, 1e6),
        Quantity("cmd_kd", "N·m·s/rad", "joint", "gain of the joint PD", 0, 1e5),
        Quantity("foot_force", "N", "foot", "foot sensor, as logged", -1e6, 1e6),
        Quantity("contact", "1", "foot", "1 where the foot touches, 0 where it does not", 0, 1),
        Quantity("supply_voltage", "V", "log", "of the motors' supply", 0, 2000),
        Quantity(
            "mpc_force", "N", "pair", "ground force on the robot that the MPC asked for", -1e6, 1e6, PAIR_FORCE_AXES
        ),
        Quantity("pd_force", "N", "pair", "ground force that the joint PD stands for", -1e6, 1e6, PAIR_FORCE_AXES),
        Quantity("train_force", "N", "pair", "the source's own filtered force", -1e6, 1e6, PAIR_FORCE_AXES),
    )
}
"""Every quantity by name; a log holds some of them, and may hold other columns."""

BASE_POSITION = QUANTITIES["base_pos"].columns
BASE_QUATERNION = QUANTITIES["base_quat"].columns
BASE_VELOCITY = QUANTITIES["base_linvel"].columns
BASE_ANGULAR_VELOCITY = QUANTITIES["base_angvel"].columns
COMMANDS = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")


def quantity_of(column: str) -> Quantity | None:
    """The quantity that a column holds; None for ``time`` and for unknown columns."""
    name, _, part = column.partition("/")
    if name in QUANTITIES and bool(part) == (QUANTITIES[name].per in ("joint", "foot", "pair")):
        return QUANTITIES[name]
    return next((quantity for quantity in QUANTITIES.values() if column in quantity.columns), None)


LATEST_S = 1e7  # latest time in a log, s: time counts from its first row, not from an epoch


@cache
def limits(column: str) -> tuple[float, float, str]:
    """Lowest and highest possible value of a column, and its unit; of an unknown column every finite number."""
    if column == "time":
        return -LATEST_S, LATEST_S, "s"
    quantity = quantity_of(column)
    return (quantity.low, quantity.high, quantity.unit) if quantity else (-np.inf, np.inf, "")


def check_values(columns: Mapping[str, np.ndarray], where: object) -> None:
    """``InputError`` for the first column with values that no robot can have."""
    for name, values in columns.items():
        low, high, unit = limits(name)
        if low <= values.min() and values.max() <= high:
            continue
        bad = np.flatnonzero((values < low) | (values > high))
        found = f"{values[bad[0]]:g} in row {bad[0]} ({len(bad)} such values)"
        do = "correct its unit or factor, or leave the log out"
        raise InputError(f"{where}, column {name}", found, f"{low:g} to {high:g} {unit}".rstrip(), do)
