"""The map from the columns of a table to those of a log: names, sums, units, factors, offsets, constants."""

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from leapgap.errors import InputError, did_you_mean
from leapgap.logs.importers.tables import Table
from leapgap.logs.schema import COMMANDS, QUANTITIES, quantity_of
from leapgap.robot.model import Robot
from leapgap.robot.stated_joints import Tie, tied_joints

TURN, INCH, FOOT, POUND, GRAVITY = 2 * math.pi, 0.0254, 0.3048, 4.4482216152605, 9.80665
FINE = {"decideg": TURN / 3600, "centideg": TURN / 36000, "tick4096": TURN / 4096}  # what drives count angles in
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60},
    "rad": {"rad": 1, "mrad": 1e-3, "deg": TURN / 360, "rev": TURN} | FINE,
    "rad/s": {"rad/s": 1, "mrad/s": 1e-3, "deg/s": TURN / 360, "rpm": TURN / 60, "rev/s": TURN}
    | {f"{unit}/s": factor for unit, factor in FINE.items()},
    "m": {"m": 1, "cm": 1e-2, "mm": 1e-3, "in": INCH, "ft": FOOT},
    "m/s": {"m/s": 1, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "m/s²": {"m/s²": 1, "m/s2": 1, "m/s^2": 1, "mm/s2": 1e-3, "g": GRAVITY},
    "N": {"N": 1, "mN": 1e-3, "kN": 1e3, "kgf": GRAVITY, "lbf": POUND},
    "N·m": {"N·m": 1, "Nm": 1, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3, "kNm": 1e3}
    | {"kgfcm": GRAVITY * 1e-2, "ozfin": POUND / 16 * INCH, "lbfft": POUND * FOOT},
    "N·m/rad": {"N·m/rad": 1, "Nm/rad": 1, "Nm/deg": 360 / TURN, "Nm/rev": 1 / TURN},
    "N·m·s/rad": {"N·m·s/rad": 1, "Nms/rad": 1, "Nms/deg": 360 / TURN, "Nm/rpm": 60 / TURN},
    "V": {"V": 1, "mV": 1e-3},
    "N/m": {"N/m": 1, "N/mm": 1e3},
    "N·s/m": {"N·s/m": 1, "Ns/m": 1, "Ns/mm": 1e3},
}
"""Our unit → names of units of the same dimension → factor from them to ours."""
OF_SLIDES = {"rad": "m", "rad/s": "m/s", "N·m": "N", "N·m/rad": "N/m", "N·m·s/rad": "N·s/m"}
"""What the quantities of joints are measured in where the joint slides."""


def unit_factor(column: str, unit: str, where: str) -> float:
    """What values of a column of ours are multiplied by that are logged in ``unit``.

    Columns of joints take lengths and forces too, because a joint may slide.
    """
    quantity = quantity_of(column)
    ours = "s" if column == "time" else quantity.unit if quantity else None
    known = dict(UNITS.get(ours or "", {}))
    if quantity is not None and quantity.per == "joint":
        known |= UNITS[OF_SLIDES[quantity.unit]]
    if unit not in known:
        expected = f"one of {', '.join(known)}" if known else "a column that has a unit"
        do = did_you_mean(unit, known) or "correct it, or use factors"
        raise InputError(f"{where}, {column}", f"the unit {unit}", expected, do)
    return float(known[unit])


ANY_JOINT = "*"


@dataclass(frozen=True)
class ColumnMap:
    """How the columns of a table become those of a log.

    ``*`` in a key stands for every joint of the robot, and in the name of a file's column for what that joint is
    called there. An entry of one joint stands before one of ``*``. Values are (the file's × unit × factor) + offset.
    A joint without a motor that the table lacks, and that the model ties to another, follows that one.
    """

    columns: dict[str, Any] = field(default_factory=dict)
    """Our name → the file's, such as ``joint_pos/*: q_*``, or several that are summed, each times a factor, such as
    ``cmd_tau/*: {tau_sent_*: 1, tau_friction_*: -1}``. A column not named here is taken under our own name."""
    units: dict[str, str] = field(default_factory=dict)
    """Our name → the unit in the file, such as ``joint_pos/*: deg``, ``joint_vel/*: rpm``, ``time: us``."""
    factors: dict[str, Any] = field(default_factory=dict)
    """Our name → factor of the file's values, one number or a list with one a joint, such as signs or gear ratios."""
    offsets: dict[str, Any] = field(default_factory=dict)  # our name → what is then added, in our unit, likewise
    constants: dict[str, Any] = field(default_factory=dict)
    """Our name → one value for all rows, such as ``cmd_kp/*: 300``, or a list with one a joint."""
    joint_names: dict[str, str] = field(default_factory=dict)
    """The file's names of joints → the robot's; a joint not named here has the same name there."""
    joint_order: list[str] = field(default_factory=list)
    """The robot's joints in the order of the file's columns, if these are numbered (from 0 or 1); lists follow it."""


def mapped(
    table: Table, options: ColumnMap, robot: Robot, where: str
) -> tuple[dict[str, np.ndarray], Mapping[str, Tie]]:
    """Columns of a log, as the map has them: time from 0, all else in SI; and joints that follow another by the model.

    ``where`` names the map in messages.
    """
    expand, ties = expansion_of(table, options, robot, where)
    constants = expand.numbers("constants", options.constants)
    check_ours([*expand.columns(), *constants], robot, where)
    theirs = {ours: one for ours, one in expand.columns().items() if ours not in constants}
    for column in table.columns:
        if column not in constants and is_ours(column, robot):
            theirs.setdefault(column, {column: 1.0})
    rows = None
    columns: dict[str, np.ndarray] = {}
    for ours in sorted(theirs, key=lambda one: one != "time"):  # the time says how many rows there are
        columns[ours] = weighted_sum(table, ours, theirs[ours], rows, where)
        rows = len(columns[ours]) if rows is None else rows
    for ours, unit in expand.of_joints(options.units).items():
        imported(columns, ours, f"{where}.units")
        columns[ours] = columns[ours] * unit_factor(ours, str(unit), f"{where}.units")
    for ours, factor in expand.numbers("factors", options.factors).items():
        columns[ours] = imported(columns, ours, f"{where}.factors") * factor
    for ours, offset in expand.numbers("offsets", options.offsets).items():
        columns[ours] = imported(columns, ours, f"{where}.offsets") + offset
    for ours, value in constants.items():
        columns[ours] = np.full(rows or 0, value)
    # The columns with positions and velocities of tied joints, as far as the joints that they follow have them
    found = dict(columns)
    for joint, tie in ties.items():
        for quantity, follow in (("joint_pos", tie.position), ("joint_vel", tie.velocity)):
            if f"{quantity}/{tie.of}" in columns:
                found[f"{quantity}/{joint}"] = follow(columns[f"{quantity}/{tie.of}"])
    return found, ties


def expansion_of(table: Table, options: ColumnMap, robot: Robot, where: str) -> tuple["Expansion", Mapping[str, Tie]]:
    """The map written out for a table, and ties by the model of joints that the table has no position of."""

    def lacking(one: Expansion) -> int:
        return sum(column not in table for terms in one.columns().values() for column in terms)

    # Their numbers of joints begin at 1 where only so each numbered column is there
    from_0, from_1 = (Expansion(options, robot, where, first=first) for first in (0, 1))
    whole = from_1 if options.joint_order and lacking(from_1) < lacking(from_0) else from_0
    every = whole.columns()
    without = [
        joint
        for joint in robot.joints
        if f"joint_pos/{joint}" not in table
        and f"joint_pos/{joint}" not in options.columns
        and not all(column in table for column in every.get(f"joint_pos/{joint}", {"": 1.0}))
    ]
    ties = tied_joints(robot, without)
    return replace(whole, without=frozenset(ties)), ties


def check_ours(columns: Iterable[str], robot: Robot, where: str) -> None:
    """Refuse names that mean nothing in a log, which would be imported and never looked at."""
    for column in columns:
        quantity, joint = quantity_of(column), column.partition("/")[2]
        if quantity is None and column != "time":
            expected = f"time, or one of {', '.join(QUANTITIES)}, with its joint, foot or axis"
            do = did_you_mean(column, ["time", *QUANTITIES]) or "correct the name of the column"
            raise InputError(where, column, expected, do)
        if quantity is not None and quantity.per == "joint" and joint not in robot.joints:
            expected = f"a joint of the robot: {', '.join(robot.joints)}"
            raise InputError(
                where, column, expected, did_you_mean(joint, robot.joints) or "correct the joint, or use joint_names"
            )


def imported(columns: Mapping[str, np.ndarray], ours: str, where: str) -> np.ndarray:
    """A column that an entry is about; ``InputError`` where nothing is imported under that name."""
    if ours not in columns:
        raise InputError(where, ours, "a column that is imported", "map the column too")
    return columns[ours]


def weighted_sum(table: Table, ours: str, theirs: Mapping[str, float], rows: int | None, where: str) -> np.ndarray:
    """Sum of columns of the table, each times its factor."""
    total: np.ndarray | None = None
    for column, factor in theirs.items():
        if column not in table:
            expected = f"the column that is to be {ours}"
            raise InputError(table.path, f"no column {column}", expected, f"correct {where}.columns")
        values = table.instants(column, rows) if ours == "time" else table.numbers(column, rows)
        rows = len(values)
        total = factor * values if total is None else total + factor * values
    assert total is not None  # an entry without columns is refused where it is read
    return total


@dataclass(frozen=True)
class Expansion:
    """Writes ``*`` out for every joint, in keys, in their names and in lists."""

    options: ColumnMap
    robot: Robot
    where: str
    without: frozenset[str] = frozenset()  # joints that ``*`` does not stand for: they are not in the table
    first: int = 0  # the number of the first joint of ``joint_order``

    def __post_init__(self) -> None:
        unknown = {*self.options.joint_names.values(), *self.options.joint_order} - set(self.robot.joints)
        if unknown:
            known = f"joints of the robot: {', '.join(self.robot.joints)}"
            do = did_you_mean(min(unknown), self.robot.joints) or "correct the names"
            raise InputError(f"{self.where}, joints", ", ".join(sorted(unknown)), known, do)

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that ``*`` stands for."""
        return tuple(joint for joint in self.robot.joints if joint not in self.without)

    @property
    def order(self) -> tuple[str, ...]:
        """The joints in the order of lists."""
        return tuple(self.options.joint_order) or self.robot.joints

    def their_name(self, joint: str) -> str:
        """What a joint of the robot is called in the table: its name there, or its number."""
        for theirs, ours in self.options.joint_names.items():
            if ours == joint:
                return theirs
        return str(self.first + self.order.index(joint)) if joint in self.options.joint_order else joint

    def of_joints(self, mapping: Mapping[str, Any]) -> dict[str, Any]:
        """The mapping with each key of ``*`` written out; a list gives each joint its own item.

        A list is as long as the joints, or as those that are in the table.
        """
        written: dict[str, Any] = {}
        for key, value in sorted(mapping.items(), key=lambda one: ANY_JOINT not in one[0]):  # single joints stand last
            for joint in self.joints if ANY_JOINT in key else ("",):
                written[key.replace(ANY_JOINT, joint)] = self.item(key, value, joint)
        return written

    def item(self, key: str, value: Any, joint: str) -> Any:
        """What a value means for one joint."""
        if not isinstance(value, list | tuple):
            return value
        in_table = tuple(joint for joint in self.order if joint not in self.without)
        for order in (self.order, in_table):
            if ANY_JOINT in key and len(value) == len(order) and joint in order:
                return value[order.index(joint)]
        expected = f"one number, or with * a list of {len(in_table)}, for {', '.join(in_table)}"
        raise InputError(f"{self.where}, {key}", f"a list of {len(value)}", expected, "correct it")

    def numbers(self, part: str, mapping: Mapping[str, Any]) -> dict[str, float]:
        """The same of a part of the map whose values are numbers."""
        found = self.of_joints(mapping)
        for key, value in found.items():
            if not is_number(value):
                raise InputError(f"{self.where}.{part}, {key}", repr(value)[:100], "a number", "correct it")
            if part == "factors" and value == 0:
                raise InputError(f"{self.where}.{part}, {key}", "0", "a number but 0", "leave the column out instead")
        return {key: float(value) for key, value in found.items()}

    def columns(self) -> dict[str, dict[str, float]]:
        """Ours → their columns and the factor of each."""
        written: dict[str, dict[str, float]] = {}
        for key, value in sorted(self.options.columns.items(), key=lambda one: ANY_JOINT not in one[0]):
            terms = {value: 1.0} if isinstance(value, str) else value
            sound = isinstance(terms, Mapping) and all(isinstance(c, str) and is_number(f) for c, f in terms.items())
            if not terms or not sound:
                expected = "the name of a column, or a mapping from names to factors"
                raise InputError(f"{self.where}.columns, {key}", repr(value), expected, "correct it")
            for joint in self.joints if ANY_JOINT in key else ("",):
                name = self.their_name(joint) if joint else ANY_JOINT
                written[key.replace(ANY_JOINT, joint)] = {
                    column.replace(ANY_JOINT, name): float(factor) for column, factor in terms.items()
                }
        return written


def is_number(value: Any) -> bool:
    """Whether a value is a number that is finite as a float."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def is_ours(column: str, robot: Robot) -> bool:
    """Whether an unmapped column is imported under its own name: time, a known quantity, a command of a joint."""
    quantity, of = quantity_of(column), column.partition("/")[2]
    if quantity is None:
        return column == "time"
    return quantity.name not in COMMANDS or of in robot.joints


def column_order(robot: Robot) -> Callable[[str], tuple]:
    """Sort key: time first, the base, then by quantity and the robot's joints; a fixed order gives fixed bytes."""

    def key(column: str) -> tuple:
        quantity, _, of = column.partition("/")
        return (
            column != "time",
            not column.startswith("base_"),
            quantity,
            robot.joints.index(of) if of in robot.joints else -1,
            of,
        )

    return key
