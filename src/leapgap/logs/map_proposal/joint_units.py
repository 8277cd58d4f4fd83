"""Units, signs and order of the joints' columns, by physics."""

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.physics import (
    CLEAR,
    MOST_ROWS,
    NEAR,
    correlations,
    named_factor,
    order_of,
    rates,
    unit_of_positions,
)
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, SURE, Evidence, Proposal
from leapgap.robot.model import Robot


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
        if "joint_pos" not in evidence.unplaced:
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
    if "joint_vel" in evidence.unplaced:
        return
    if "joint_vel" not in evidence.values:
        proposal.say(
            MISSING, "measured velocities: they are left out; velocities: fit would add slopes of the positions"
        )
        return
    if evidence.time is None or "joint_pos" not in evidence.values:
        lacking = "a time" if evidence.time is None else "positions"
        proposal.say(MISSING, f"the unit of velocities: it shows beside {lacking}, else state units.joint_vel/*")
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
        size = float(np.median(np.std(actual[:, follows], axis=0) / np.std(wanted[:, follows], axis=0)))
        dimension = "rad" if quantity == "cmd_pos" else "rad/s"
        unit, roughly = named_factor(size, dimension), named_factor(size, dimension, NEAR)
        if roughly is None:
            proposal.say(GUESSED, f"{quantity} is in SI, though what is measured is {size:.3g} times as large")
            continue
        scale(quantity, roughly[0], np.ones(len(evidence.robot.joints)), evidence, proposal)
        if unit is None:
            moves = f"what is measured moves {size / UNITS[dimension][roughly[0]]:.3g} times as far"
            proposal.say(GUESSED, f"{quantity} is in {roughly[0]}, the nearest unit: {moves}")
        else:
            proposal.say(evidence.certainty, f"{quantity} is in {unit[0]}: what is measured follows it")
