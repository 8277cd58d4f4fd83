"""A column map proposed from a table and a robot, with what is sure, what is guessed and what is missing."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap.logs.importers.tables import Table
from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.base_columns import COLUMNS, base_columns, real_part_last
from leapgap.logs.map_proposal.names import Family, families, time_columns
from leapgap.logs.map_proposal.physics import (
    CLEAR,
    MOST_ROWS,
    Gains,
    correlations,
    fit_gains,
    named_factor,
    order_of,
    rates,
    unit_of_positions,
    unit_of_time,
)
from leapgap.logs.schema import COMMANDS
from leapgap.robot.model import Robot

SURE, GUESSED, MISSING = "sure", "guessed", "missing"
LONG_GAP = 20
"""A step of the clock that is so many times the median one is a gap."""
MOST_STATES = 10
"""A column with more values than that is no flag."""
SAME_TORQUE = 0.3
"""Measured over sent torque may depart from 1 by this much: motors are weak, currents are poor torque sensors."""
OF_JOINTS = ("joint_pos", "joint_vel", "tau", *COMMANDS)


@dataclass
class Proposal:
    """A map in the making; it becomes options of an import when a person passes it."""

    options: dict[str, Any] = field(default_factory=dict)
    notes: list[tuple[str, str]] = field(default_factory=list)
    """``sure``, ``guessed`` or ``missing``, and a sentence."""

    def say(self, kind: str, sentence: str) -> None:
        """Add a note."""
        self.notes.append((kind, sentence))

    def put(self, part: str, ours: str, value: Any) -> None:
        """Add an entry to a part of the options."""
        self.options.setdefault(part, {})[ours] = value

    def notes_of(self, kind: str) -> list[str]:
        """The sentences of one kind."""
        return [sentence for one, sentence in self.notes if one == kind]


@dataclass
class Evidence:
    """The table as read so far: values in our order of joints, in the units that were found."""

    table: Table
    robot: Robot
    time: np.ndarray | None = None
    values: dict[str, np.ndarray] = field(default_factory=dict)
    """Quantity → (rows, joints), SI, as far as known."""
    their_joints: list[str] | None = None
    """What the first family calls our joints, in our order: what ``*`` stands for in their names."""
    position_unit: str = "rad"
    certainty: str = GUESSED
    """How sure that unit is: what follows from it is no surer."""
    torque_alone: bool = False
    """Whether the torques that were sent explain the measured ones, so that no joint PD acts beside them."""


def propose(table: Table, robot: Robot) -> Proposal:
    """The map of a table to the columns of a log of this robot."""
    proposal, evidence = Proposal(), Evidence(table, robot)
    columns = [column for column in table.columns if is_numeric(table, column)]
    find_time(columns, evidence, proposal)
    chosen = choose(families(columns, robot.joints), robot)
    read_families(chosen, evidence, proposal)
    judge_positions(evidence, proposal)
    judge_velocities(evidence, proposal)
    judge_set_points(evidence, proposal)
    judge_torques(evidence, proposal)
    fill_commands(evidence, proposal)
    if robot.has_free_base:
        find_base(columns, evidence, proposal)
    return proposal


def is_numeric(table: Table, column: str) -> bool:
    """Whether a column is as long as most and holds numbers."""
    values = table.values(column)
    return values.dtype.kind in "biufMm" and len(values) == table.rows()


def find_time(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """The clock: named so, increasing, and with the steps of a loop in one of its units."""
    for column in time_columns(columns):
        instants = evidence.table.instants(column)
        unit = unit_of_time(instants)
        if unit is None:
            continue
        proposal.put("columns", "time", column)
        if unit != "s":
            proposal.put("units", "time", unit)
        evidence.time = instants * UNITS["s"][unit]
        step, back = np.diff(evidence.time), int((np.diff(instants) <= 0).sum())
        longest = f"median {1e3 * np.median(step):.4g}, longest {1e3 * step.max():.4g}"
        proposal.say(SURE, f"time is {column} in {unit}: steps of {1e3 * step.mean():.4g} ms on average ({longest})")
        find_gaps(columns, evidence, proposal)
        if back:
            proposal.options["repeated_times"] = "drop"
            proposal.say(GUESSED, f"{back} time stamps repeat or run back; their rows are dropped")
        return
    proposal.say(MISSING, "a column with time stamps: map columns.time, or state period_s if the rows are even")


def find_gaps(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """Long gaps in the time, and a flag that changes where they are, which then cuts the file."""
    assert evidence.time is not None
    step = np.diff(evidence.time)
    gaps = np.flatnonzero(step > LONG_GAP * np.median(step))
    if not len(gaps):
        return
    for column in columns:
        values = evidence.table.numbers(column)
        if not np.isfinite(values).all() or len(np.unique(values)) > MOST_STATES:
            continue
        changes = np.flatnonzero(np.diff(values) != 0)
        if len(changes) and all(np.abs(changes - gap).min() <= 2 for gap in gaps):
            proposal.options["cut_by"] = column
            proposal.say(
                GUESSED, f"{len(gaps)} gaps of up to {step.max():.3g} s where {column} changes: it cuts the file"
            )
            return
    proposal.say(MISSING, f"what cuts the file at {len(gaps)} gaps of up to {step.max():.3g} s: cut_by, or pieces")


def choose(found: list[Family], robot: Robot) -> dict[str, Family]:
    """The best family for each quantity: one that names the robot's joints, all of them, in the plainest words."""
    chosen: dict[str, Family] = {}
    for one in sorted(found, key=lambda one: (fit_of(one, robot), one.preference), reverse=True):
        chosen.setdefault(one.quantity, one)
    return chosen


def fit_of(one: Family, robot: Robot) -> int:
    """How well the members of a family go with the joints."""
    if one.joints:
        return 3 if set(one.joints.values()) >= set(robot.joints) else 0
    return 2 if len(one.members) == len(robot.joints) else 1


def read_families(chosen: dict[str, Family], evidence: Evidence, proposal: Proposal) -> None:
    """Take each family into the map, with the joints its members are of."""
    joints = evidence.robot.joints
    for quantity in OF_JOINTS:
        one = chosen.get(quantity)
        if one is None:
            continue
        if one.joints and not set(one.joints.values()) >= set(joints):
            lacking = ", ".join(joint for joint in joints if joint not in one.joints.values())
            proposal.say(MISSING, f"{quantity} of {lacking}: {one.template} names the others only")
            continue
        keys = keys_of(one, evidence)
        if keys is None and add_some(quantity, one, evidence, proposal):
            continue
        if keys is None:
            names = ", ".join(one.members)
            proposal.say(
                MISSING, f"which of {names} is which joint ({', '.join(joints)}), to map {quantity}: {one.template}"
            )
            continue
        add_family(quantity, one, keys, evidence, proposal)


def keys_of(one: Family, evidence: Evidence) -> list[str] | None:
    """What stands for each joint in a family, in our order of joints; None where that cannot be said."""
    joints = evidence.robot.joints
    if one.joints:
        by_joint = {joint: key for key, joint in one.joints.items()}
        return [by_joint[joint] for joint in joints]
    if evidence.their_joints and set(evidence.their_joints) <= set(one.members):
        return evidence.their_joints
    keys = sorted(one.members, key=int) if one.numbered else list(one.members)
    if len(keys) > len(joints):  # motors that the robot does not have read zero
        keys = [key for key in keys if np.ptp(evidence.table.numbers(one.members[key])) > 0]
    return keys if len(keys) == len(joints) else None


def add_some(quantity: str, one: Family, evidence: Evidence, proposal: Proposal) -> bool:
    """Add torques of some joints, which the family calls as others did; the other joints have no motor."""
    theirs = evidence.their_joints or []
    if quantity not in ("tau", "cmd_tau") or not set(one.members) < set(theirs):
        return False
    idle = []
    values = np.zeros((evidence.table.rows(), len(theirs)))
    for i, (key, joint) in enumerate(zip(theirs, evidence.robot.joints, strict=True)):
        if key in one.members:
            proposal.put("columns", f"{quantity}/{joint}", one.members[key])
            values[:, i] = evidence.table.numbers(one.members[key])
            continue
        idle.append(joint)
        if quantity == "cmd_tau":
            proposal.put("constants", f"cmd_tau/{joint}", 0.0)
    evidence.values[quantity] = values
    proposal.say(GUESSED, f"{quantity} is {one.template}, by its name; {', '.join(idle)} has none, as without a motor")
    return True


def add_family(quantity: str, one: Family, keys: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """Add the entries of one family, by ``*`` where the names of joints go with those of the others."""
    joints = evidence.robot.joints
    if evidence.their_joints is None:
        evidence.their_joints = keys
        renamed = {key: joint for key, joint in zip(keys, joints, strict=True) if key != joint}
        if renamed:
            proposal.options["joint_names"] = renamed
    if evidence.their_joints == keys:
        proposal.put("columns", f"{quantity}/*", one.template)
    else:  # other names than the first family has
        for key, joint in zip(keys, joints, strict=True):
            proposal.put("columns", f"{quantity}/{joint}", one.members[key])
    evidence.values[quantity] = np.stack([evidence.table.numbers(one.members[key]) for key in keys], axis=1)
    if one.joints:
        proposal.say(GUESSED, f"{quantity} is {one.template}, by its name; the joints are named in it")
    else:
        order = ", ".join(f"{key} = {joint}" for key, joint in zip(keys, joints, strict=True))
        proposal.say(GUESSED, f"{quantity} is {one.template}, by its name; joints in the order of the model: {order}")


def some_rows(evidence: Evidence, *quantities: str) -> tuple[np.ndarray, ...]:
    """Time and quantities in the rows that are looked at: those whose numbers are whole and whose time increases."""
    assert evidence.time is not None
    values = [evidence.values[name] for name in quantities]
    good = np.isfinite(np.concatenate([evidence.time[:, None], *values], axis=1)).all(axis=1)
    later = np.concatenate([[True], evidence.time[1:] > np.maximum.accumulate(evidence.time)[:-1]])
    rows = np.flatnonzero(good & later)[:MOST_ROWS]
    return evidence.time[rows], *(one[rows] for one in values)


def judge_positions(evidence: Evidence, proposal: Proposal) -> None:
    """Unit and sign of positions by the limits of the joints."""
    joints = evidence.robot.joints
    if "joint_pos" not in evidence.values:
        proposal.say(MISSING, "measured positions of the joints: map columns.joint_pos/*")
        return
    position = evidence.values["joint_pos"]
    rows = np.isfinite(position).all(axis=1)
    unit, signs, decided = unit_of_positions(position[rows], limits_of(evidence.robot))
    scale("joint_pos", unit, signs, evidence, proposal)
    evidence.position_unit, evidence.certainty = unit, SURE if decided else GUESSED
    flipped = [joint for joint, sign in zip(joints, signs, strict=True) if sign < 0]
    if decided:
        proposal.say(SURE, f"positions are in {unit}: in that unit they lie within the joints' limits")
    else:
        proposal.say(GUESSED, f"positions are in {unit}: the limits of the joints do not decide it")
        check_limits(evidence, proposal)
    if flipped:
        proposal.say(GUESSED, f"sign of {', '.join(flipped)} turned round: only so they lie within their limits")


def limits_of(robot: Robot) -> np.ndarray:
    """Limits of each joint, rad, (joints, 2); infinite where the model has none."""
    found = np.full((len(robot.joints), 2), [-np.inf, np.inf])
    for i, name in enumerate(robot.joints):
        joint = robot.model.joint(name)
        if joint.limited[0]:
            found[i] = joint.range
    return found


def check_limits(evidence: Evidence, proposal: Proposal) -> None:
    """Name the joints whose positions leave their limits: an order, a unit or an offset is wrong."""
    limits, position = limits_of(evidence.robot), evidence.values["joint_pos"]
    for i, joint in enumerate(evidence.robot.joints):
        low, high = np.nanmin(position[:, i]), np.nanmax(position[:, i])
        if low < limits[i, 0] - 0.1 or high > limits[i, 1] + 0.1:
            bounds = f"its limits are {limits[i, 0]:.3g} to {limits[i, 1]:.3g}"
            says = f"{joint} moves from {low:.3g} to {high:.3g} rad, {bounds}"
            proposal.say(MISSING, f"{says}: check the order of joints, units and offsets")


def scale(quantity: str, unit: str, signs: np.ndarray, evidence: Evidence, proposal: Proposal) -> None:
    """Put unit and signs of a quantity into the map, and its values into SI."""
    dimension = {"joint_pos": "rad", "cmd_pos": "rad", "joint_vel": "rad/s", "cmd_vel": "rad/s"}.get(quantity, "N·m")
    if UNITS[dimension][unit] != 1:
        proposal.put("units", f"{quantity}/*", unit)
    if (signs < 0).any():
        same = (signs < 0).all()
        proposal.put("factors", f"{quantity}/*", -1.0 if same else signs.tolist())
    evidence.values[quantity] = evidence.values[quantity] * UNITS[dimension][unit] * signs


def judge_velocities(evidence: Evidence, proposal: Proposal) -> None:
    """Unit, sign and order of velocities by the rates of positions."""
    if "joint_vel" not in evidence.values:
        proposal.say(
            MISSING, "measured velocities: they are left out; velocities: fit would add slopes of the positions"
        )
        return
    if evidence.time is None or "joint_pos" not in evidence.values:
        return
    joints = evidence.robot.joints
    found = rates(*some_rows(evidence, "joint_pos", "joint_vel"))
    clear = np.abs(np.nan_to_num(found.correlation)) > CLEAR
    if not clear.any():
        proposal.say(
            MISSING, "velocities that follow from the positions: no column does; check time, order and columns"
        )
        return
    if clear.all() and (found.of != np.arange(len(joints))).any():
        reorder("joint_vel", found.of, evidence, proposal, "each follows the rate of that joint's position")
    unit = named_factor(float(np.median(np.abs(found.factor[clear]))), "rad/s")
    if unit is None:
        size = float(np.median(found.factor[clear]))
        proposal.say(
            MISSING, f"the unit of velocities: rates of positions are {size:.3g} times as large, which is no unit"
        )
        return
    signs = np.where(clear & (found.factor < 0), -1.0, 1.0)
    scale("joint_vel", unit[0], signs, evidence, proposal)
    which = "all joints" if clear.all() else ", ".join(j for j, one in zip(joints, clear, strict=True) if one)
    rests = f"they are the rates of positions in {evidence.position_unit} ({which})"
    proposal.say(evidence.certainty, f"velocities are in {unit[0]}: {rests}")
    if (signs < 0).any():
        turned = ", ".join(joint for joint, sign in zip(joints, signs, strict=True) if sign < 0)
        proposal.say(SURE, f"velocities of {turned} have the opposite sign of their positions; they are turned round")


def reorder(quantity: str, of: np.ndarray, evidence: Evidence, proposal: Proposal, why: str) -> None:
    """Give each joint the column of a family that physics says is its own."""
    entries, joints = proposal.options["columns"], evidence.robot.joints
    theirs = [their_column(quantity, joint, proposal) for joint in joints]
    for key in [key for key in entries if key.partition("/")[0] == quantity]:
        del entries[key]
    for joint, at in zip(joints, of, strict=True):
        entries[f"{quantity}/{joint}"] = theirs[at]
    evidence.values[quantity] = evidence.values[quantity][:, of]
    order = ", ".join(f"{theirs[at]} = {joint}" for joint, at in zip(joints, of, strict=True))
    proposal.say(SURE, f"{quantity} comes in another order than the positions ({why}): {order}")


def their_column(quantity: str, joint: str, proposal: Proposal) -> str:
    """The column that the map has for a quantity of a joint so far."""
    entries = proposal.options["columns"]
    if f"{quantity}/{joint}" in entries:
        return str(entries[f"{quantity}/{joint}"])
    names = {ours: theirs for theirs, ours in proposal.options.get("joint_names", {}).items()}
    return str(entries[f"{quantity}/*"]).replace("*", names.get(joint, joint))


def judge_set_points(evidence: Evidence, proposal: Proposal) -> None:
    """Unit and order of set points: a robot follows them."""
    for quantity, measured in (("cmd_pos", "joint_pos"), ("cmd_vel", "joint_vel")):
        if quantity not in evidence.values or measured not in evidence.values or evidence.time is None:
            continue
        _, actual, wanted = some_rows(evidence, measured, quantity)
        order = order_of(actual, wanted)
        if order is not None:
            reorder(quantity, order, evidence, proposal, "the measured ones follow it so")
            wanted = wanted[:, order]
        follows = np.abs(np.nan_to_num(np.diag(correlations(actual, wanted)))) > CLEAR
        if not follows.any():
            proposal.say(GUESSED, f"{quantity} is in SI: nothing measured follows it closely enough to tell")
            continue
        size = np.std(actual[:, follows], axis=0) / np.std(wanted[:, follows], axis=0)
        unit = named_factor(float(np.median(size)), "rad" if quantity == "cmd_pos" else "rad/s")
        if unit is None:
            proposal.say(
                GUESSED, f"{quantity} is in SI, though what is measured is {np.median(size):.3g} times as large"
            )
            continue
        scale(quantity, unit[0], np.ones(len(evidence.robot.joints)), evidence, proposal)
        proposal.say(evidence.certainty, f"{quantity} is in {unit[0]}: what is measured follows it")


def judge_torques(evidence: Evidence, proposal: Proposal) -> None:
    """Whether the measured torque is the one sent, or that of a joint PD, whose gains are then estimated."""
    measured, have = "tau" in evidence.values, evidence.values.keys()
    if not measured or evidence.time is None:
        return
    if "cmd_tau" in have:
        _, sent, torque = some_rows(evidence, "cmd_tau", "tau")
        slope = (sent * torque).sum(axis=0) / np.maximum((sent**2).sum(axis=0), 1e-300)
        found = np.nan_to_num(np.diag(correlations(sent, torque)))
        clear = np.abs(found) > CLEAR
        if clear.any():
            ratio = float(np.median(slope[clear]))
            kind = SURE if abs(ratio - 1) < SAME_TORQUE else MISSING
            advice = "" if kind == SURE else ": check unit and sign of one of them"
            proposal.say(kind, f"the measured torque is {ratio:.3g} times the one that was sent{advice}")
            moved = np.ptp(sent, axis=0) > 0
            if kind == SURE and clear[moved].all():
                evidence.torque_alone = True
                return
    if {"cmd_pos", "joint_pos", "joint_vel"} <= have and not {"cmd_kp", "cmd_kd"} <= have:
        estimate_gains(evidence, proposal)


def estimate_gains(evidence: Evidence, proposal: Proposal) -> None:
    """Gains of the joint PD from the measured torque."""
    quantities = [
        "tau",
        "cmd_pos",
        "joint_pos",
        "joint_vel",
        *(q for q in ("cmd_vel", "cmd_tau") if q in evidence.values),
    ]
    _, *arrays = some_rows(evidence, *quantities)
    at = dict(zip(quantities, arrays, strict=True))
    wanted_rate = at.get("cmd_vel", np.zeros_like(at["joint_vel"]))
    fits: list[Gains] = [
        fit_gains(
            at["tau"][:, i],
            at["cmd_pos"][:, i] - at["joint_pos"][:, i],
            wanted_rate[:, i] - at["joint_vel"][:, i],
            at["cmd_tau"][:, i] if "cmd_tau" in at else None,
        )
        for i in range(len(evidence.robot.joints))
    ]
    good = [one.explained > CLEAR and one.kp > 0 for one in fits]
    if not all(good):
        weak = ", ".join(joint for joint, one in zip(evidence.robot.joints, good, strict=True) if not one)
        proposal.say(
            MISSING, f"gains of the joint PD: the measured torque does not tell them for {weak}; state cmd_kp, cmd_kd"
        )
        return
    proposal.put("constants", "cmd_kp/*", [float(f"{one.kp:.3g}") for one in fits])
    proposal.put("constants", "cmd_kd/*", [float(f"{max(0.0, one.kd):.3g}") for one in fits])
    worst = min(one.explained for one in fits)
    proposal.say(
        GUESSED, f"gains of the joint PD by least squares: they explain {worst:.0%} or more of the measured torque"
    )


def fill_commands(evidence: Evidence, proposal: Proposal) -> None:
    """Commands that no column holds: zero where that is the only sense, else missing."""
    have = set(evidence.values)
    stated = {key.partition("/")[0] for key in proposal.options.get("constants", {})}
    if not have & {"cmd_pos", "cmd_vel", "cmd_tau"}:
        proposal.say(MISSING, "commands: no column looks like torques or set points that were sent")
        return
    if evidence.torque_alone:
        entries = proposal.options["columns"]
        for key in [key for key in entries if key.startswith(("cmd_pos/", "cmd_vel/"))]:
            del entries[key]  # references of a controller outside, which no motor follows
        for part in ("units", "factors"):
            for key in [key for key in proposal.options.get(part, {}) if key.startswith(("cmd_pos/", "cmd_vel/"))]:
                del proposal.options[part][key]
        have -= {"cmd_pos", "cmd_vel"}
        proposal.notes = [one for one in proposal.notes if not one[1].startswith(("cmd_pos is", "cmd_vel is"))]
        why = "the torque that was sent is the measured one: no joint PD acts beside it"
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, why)
        return
    if "cmd_pos" not in have:
        zero(("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"), have | stated, proposal, "torques alone are sent, no joint PD")
        return
    zero(("cmd_tau",), have | stated, proposal, "set points alone are sent, no feed-forward torque")
    zero(("cmd_vel",), have | stated, proposal, "the joint PD damps towards rest")
    lacking = [name for name in ("cmd_kp", "cmd_kd") if name not in have | stated]
    if lacking and not any("gains" in sentence for sentence in proposal.notes_of(MISSING)):
        proposal.say(MISSING, f"gains of the joint PD: state constants.{'/*, constants.'.join(lacking)}/*")


def find_base(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """Attitude, gyro and what else is known of the base; the gyro says in which order a quaternion is."""
    found = base_columns(columns)
    if "base_quat" in found and not {"w", "x"} <= {column[-1].lower() for column in found["base_quat"]}:
        last = None
        if "base_angvel" in found and evidence.time is not None:
            last = real_part_last(evidence.table, found["base_quat"], found["base_angvel"], evidence.time)
        if last:
            found["base_quat"] = [*found["base_quat"][3:], *found["base_quat"][:3]]
        kind, how = (GUESSED, "no gyro decides it") if last is None else (SURE, "so it turns as the gyro says")
        proposal.say(kind, f"the quaternion of the base is {'x y z w' if last else 'w x y z'}: {how}")
    for quantity, theirs in found.items():
        for ours, column in zip(COLUMNS[quantity], theirs, strict=True):
            proposal.put("columns", ours, column)
        proposal.say(GUESSED, f"{quantity} is {', '.join(theirs)}, by the names")
    lacking = ", ".join(name for name in COLUMNS if name not in found)
    if lacking:
        proposal.say(MISSING, f"{lacking} of the base: left out, as not measured")


def zero(quantities: Iterable[str], have: set[str], proposal: Proposal, why: str) -> None:
    """Zero constants for quantities that are not there."""
    added = [name for name in quantities if name not in have]
    for name in added:
        proposal.put("constants", f"{name}/*", 0.0)
    if added:
        proposal.say(GUESSED, f"{', '.join(added)}: 0, since {why}")
