"""Units, signs and order of the joints' columns, by physics."""

import numpy as np

from leapgap.logs.importers.column_map import UNITS
from leapgap.logs.map_proposal.evidence import (
    ABSENT,
    ASKED,
    GUESSED,
    MISSING,
    SURE,
    Evidence,
    Match,
    Proposal,
    factors,
    match,
    mean_rates,
    mean_values,
    rows_meant,
    shifted,
    usable_rows,
)
from leapgap.logs.map_proposal.joint_columns import words
from leapgap.logs.map_proposal.unit_readings import (
    CLOSE,
    DISTINCT,
    LIKELY,
    NORMALISED,
    PERCENT,
    TICKS,
    JointNumbers,
    Scale,
    UnitReading,
    inside,
    nearest,
    readings,
    real_limits,
)

GRIPPER = "gripper"
ODD = 0.3  # logarithm of a ratio that is no longer noise
LATE_VELOCITY_S, LATE_ROBOT_S = 0.15, 0.3  # how late velocities may come after motion, and a robot after set points
EXACT = 0.95  # correlation of velocities with rates of positions from which on a factor between them is believed
NEAR = 1.0  # a factor this near to that of a unit, relatively, is nearer to it than to another
FAR_RAD = 0.35  # set points further away, rad, and by more than the joints move, count from another zero
UNIT_WORDS = {"deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
UNIT_WORDS |= {"mrad": "mrad", "rev": "rev", "turns": "rev", "tick": TICKS, "ticks": TICKS}


def some_rows(evidence: Evidence, *quantities: str) -> tuple[np.ndarray, ...]:
    """Clock and quantities in the rows that are looked at: those whose numbers are whole and whose time increases.

    The clock is in s where its unit is known, else in its own.
    """
    clock = evidence.time if evidence.time is not None else evidence.instants
    assert clock is not None
    values = [evidence.values[name] for name in quantities]
    rows = usable_rows(clock, np.concatenate(values, axis=1))
    return clock[rows], *(one[rows] for one in values)


def rows_in(clock: np.ndarray, seconds: float, unit: str = "s") -> int:
    """Rows that last so long, at most a quarter of all."""
    step = float(np.median(np.diff(clock))) * UNITS["s"][unit]
    return int(min(seconds / step, len(clock) // 4))


def judge_units(evidence: Evidence, proposal: Proposal) -> UnitReading | None:
    """The units of clock, positions and velocities that go together; None without positions."""
    if "joint_pos" not in evidence.values:
        if "joint_pos" not in evidence.unplaced:
            proposal.say(MISSING, "measured positions of the joints: map columns.joint_pos/*")
        return None
    order_velocities(evidence, proposal)
    numbers = numbers_of(evidence)
    # Units that the names of the columns of positions speak of
    said = {word for joint in evidence.robot.joints for word in words(their_column("joint_pos", joint, proposal))}
    stated = {str(evidence.stated.get("unit"))} & set(UNIT_WORDS.values())
    found = readings(
        numbers,
        evidence.robot,
        evidence.time_units,
        sorted({UNIT_WORDS[word] for word in said & UNIT_WORDS.keys()} | stated),
        "joint_pos" not in evidence.named,
    )
    if not found:
        proposal.say(
            MISSING, "units of clock and positions: the joints would be too fast, or leave their limits, in all"
        )
        return None
    best, names = found[0], list(dict.fromkeys(one.position.name for one in found))
    evidence.time_known = SURE if len({one.time for one in found}) == 1 else GUESSED
    asked = evidence.stated.get("unit") == "normalised" and {NORMALISED, PERCENT} & set(names)
    if asked:
        ask_for_calibration(evidence, proposal)
        return best
    tell_odd_rates(best, numbers, evidence, proposal)
    turn_round(best, evidence, proposal)
    scale("joint_pos", best.position, evidence, proposal)
    evidence.position_unit, evidence.certainty = (
        best.position.name,
        SURE if len(names) == 1 and best.position.name in DISTINCT else GUESSED,
    )
    rivals = ", ".join(sorted(names[1:], key=LIKELY.__getitem__))
    if evidence.certainty == SURE:
        proposal.say(SURE, f"positions are in {best.position.name}: limits and rates of the joints rule out all others")
    else:
        also = f"{rivals} {'fits' if len(names) == 2 else 'fit'} as well" if rivals else "no other unit known here fits"
        proposal.say(GUESSED, f"positions are in {best.position.name}: {also}; if another, state units.joint_pos/*")
    if evidence.stated.get("unit") == best.position.name:
        open_grippers(evidence, proposal)
    if best.position.name in (NORMALISED, PERCENT):
        proposal.say(GUESSED, "range of each joint: that of the model; the robot's own calibration may have another")
    return best


def tell_odd_rates(reading: UnitReading, numbers: JointNumbers, evidence: Evidence, proposal: Proposal) -> None:
    """Name the joints whose velocities are not the rates of their positions, while those of the others are."""
    if numbers.rate is None or reading.velocity is None:
        return
    unit = UNITS["s"][reading.time] * UNITS["rad/s"][reading.velocity]
    ratio = numbers.rate * reading.position.factor / unit
    for i in np.flatnonzero(np.isfinite(ratio) & (np.abs(np.log(np.where(ratio > 0, ratio, 1.0))) > ODD)):
        says = f"{evidence.robot.joints[i]}'s position changes {ratio[i]:.3g} times as fast as its velocity says"
        proposal.say(GUESSED, f"{says}, unlike the others': one of the two is of another scale; check it")


def open_grippers(evidence: Evidence, proposal: Proposal) -> None:
    """Let grippers, which a calibration counts from their closed end, begin at the lower limit of the model."""
    limits, real = real_limits(evidence.robot)
    for i, joint in enumerate(evidence.robot.joints):
        if real[i] and GRIPPER in their_column("joint_pos", joint, proposal):
            for quantity in ("joint_pos", "cmd_pos"):
                if quantity in evidence.values:
                    proposal.put("offsets", f"{quantity}/{joint}", float(f"{limits[i, 0]:.6g}"))
            evidence.values["joint_pos"][:, i] += limits[i, 0]
            proposal.say(GUESSED, f"{joint} is closed at the lower limit of the model, {limits[i, 0]:.3g} rad")


def ask_for_calibration(evidence: Evidence, proposal: Proposal) -> None:
    """Leave the unit open where shares of each joint's range are what such a robot records."""
    proposal.say(
        MISSING,
        "the unit of positions: −100…100 of each joint's range, as this kind of robot records by default, or degrees, "
        "unclear. If shares, state calibration: <LeRobot's calibration file of this robot>; then, or if degrees, "
        "units: {joint_pos/*: deg, cmd_pos/*: deg}. A gripper is 0…100 either way",
    )
    open_grippers(evidence, proposal)
    for quantity in ("joint_pos", "cmd_pos"):
        if quantity in evidence.values:
            proposal.put("units", f"{quantity}/*", ASKED)
    evidence.position_unit = ASKED


def order_velocities(evidence: Evidence, proposal: Proposal) -> None:
    """Give each joint the velocity that is the rate of its position, turned round where it counts against it."""
    found = rates_beside(evidence)
    if found is None:
        return
    if found[0].moved:
        reorder("joint_vel", found[0].of, evidence, proposal, "each follows the rate of that joint's position")
    mirror("joint_vel", found[0], evidence, proposal, "their positions")


def rates_beside(evidence: Evidence) -> tuple[Match, np.ndarray, np.ndarray] | None:
    """How velocities go with rates of positions, and the means of both, (rows, joints), units of the file; or None."""
    if "joint_vel" not in evidence.values or evidence.instants is None:
        return None
    clock, position, velocity = some_rows(evidence, "joint_pos", "joint_vel")
    if len(clock) < LEAST_ROWS:
        return None
    rows = rows_meant(rows_step(clock, evidence))
    named = {"joint_pos", "joint_vel"} <= evidence.named
    rate, mean = mean_rates(clock, position, rows), mean_values(clock, velocity, rows)
    return match(rate, mean, rows_in(clock, LATE_VELOCITY_S, evidence.time_units[0]), named), rate, mean


def rows_step(clock: np.ndarray, evidence: Evidence) -> float:
    """The usual step of a clock whose unit is likely, s."""
    return float(np.median(np.diff(clock))) * UNITS["s"][evidence.time_units[0]]


LEAST_ROWS = 40  # rows below which no rates are looked at


def numbers_of(evidence: Evidence) -> JointNumbers:
    """What the units are judged by, with velocities in the order of the positions."""
    position = evidence.values["joint_pos"]
    whole = bool((position == np.round(position)).all())
    speed = rate = None
    exact = False
    if evidence.instants is not None:
        clock, at = some_rows(evidence, "joint_pos")
        if len(clock) >= LEAST_ROWS:
            speed = np.quantile(np.abs(mean_rates(clock, at, rows_meant(rows_step(clock, evidence)))), 0.9, axis=0)
    beside = rates_beside(evidence)
    if beside is not None:
        found, slope, velocity = beside
        size = np.concatenate(
            [factors(*shifted(slope[:, [i]], velocity[:, [i]], int(lag))) for i, lag in enumerate(found.lag)]
        )
        good = found.clear & (found.of == np.arange(len(size))) & (size > 0)
        rate = np.where(good, size, np.nan)
        exact = bool(good.any() and (found.correlation[good] > EXACT).all())
    low, high = np.nanquantile(position, [0.001, 0.999], axis=0)
    return JointNumbers(low, high, whole, speed, rate, exact)


def turn_round(reading: UnitReading, evidence: Evidence, proposal: Proposal) -> None:
    """Turn joints round that lie within their limits only so; name those that lie outside either way."""
    limits, real = real_limits(evidence.robot)
    low, high = np.nanmin(evidence.values["joint_pos"], axis=0), np.nanmax(evidence.values["joint_pos"], axis=0)
    low, high = (end * reading.position.factor + reading.position.offset for end in (low, high))
    outside = real & ~inside(low, high, limits)
    flipped = outside & inside(-high, -low, limits) & (reading.position.offset == 0)
    if flipped.any():
        signs = np.where(flipped, -1.0, 1.0)
        for quantity in ("joint_pos", "joint_vel"):
            if quantity in evidence.values:
                turn(quantity, signs, evidence, proposal)
        which = names_of(flipped, evidence)
        proposal.say(
            GUESSED, f"sign of {which} turned round: only so they lie within their limits, or zero is elsewhere"
        )
    for i in np.flatnonzero(outside & ~flipped):
        bounds = f"its limits are {limits[i, 0]:.3g} to {limits[i, 1]:.3g}"
        says = f"{evidence.robot.joints[i]} moves from {low[i]:.3g} to {high[i]:.3g} rad, {bounds}"
        far = np.median(np.abs(evidence.values["joint_pos"][:, i])) > 0 and not reading.is_inside
        kind = MISSING if far and beyond(low[i], high[i], limits[i]) else GUESSED
        proposal.say(kind, f"{says}: check the order of joints, units and offsets")


def beyond(low: float, high: float, limits: np.ndarray) -> bool:
    """Whether positions lie outside the limits for good, not at times by a little."""
    middle, width = 0.5 * (low + high), float(np.ptp(limits))
    return not limits[0] - 0.1 * width < middle < limits[1] + 0.1 * width


def names_of(which: np.ndarray, evidence: Evidence) -> str:
    """Names of some joints."""
    return ", ".join(joint for joint, one in zip(evidence.robot.joints, which, strict=True) if one)


def turn(quantity: str, signs: np.ndarray, evidence: Evidence, proposal: Proposal) -> None:
    """Multiply a quantity of each joint by a sign, in the map and in the values."""
    former = proposal.options.get("factors", {}).pop(f"{quantity}/*", 1.0)
    found = signs * former
    if (found < 0).any():
        proposal.put("factors", f"{quantity}/*", -1.0 if (found < 0).all() else found.tolist())
    evidence.values[quantity] = evidence.values[quantity] * signs


def scale(quantity: str, unit: Scale, evidence: Evidence, proposal: Proposal) -> None:
    """Put a unit of positions into the map, and the values into SI."""
    every, offset = f"{quantity}/*", unit.offset * signs_of(quantity, proposal)
    if unit.name in UNITS["rad"]:
        put_unit(quantity, unit.name, evidence, proposal)
    else:
        factor = unit.factor * signs_of(quantity, proposal)
        proposal.put("factors", every, [float(f"{one:.9g}") for one in factor])
    if offset.any():
        proposal.put("offsets", every, [float(f"{one:.9g}") for one in offset])
    evidence.values[quantity] = evidence.values[quantity] * unit.factor + offset


def signs_of(quantity: str, proposal: Proposal) -> np.ndarray | float:
    """The signs that the map has for a quantity so far, 1 or one a joint."""
    return np.sign(proposal.options.get("factors", {}).get(f"{quantity}/*", 1.0))


def put_unit(quantity: str, unit: str, evidence: Evidence, proposal: Proposal) -> None:
    """Put a unit of angles into the map, of the joints that turn."""
    dimension = next(of for of in ("rad", "rad/s", "N·m") if unit in UNITS[of])
    turns = evidence.robot.turning
    if UNITS[dimension][unit] == 1:
        return
    for ours in ["*"] if turns.all() else [j for j, one in zip(evidence.robot.joints, turns, strict=True) if one]:
        proposal.put("units", f"{quantity}/{ours}", unit)


def judge_velocities(reading: UnitReading | None, evidence: Evidence, proposal: Proposal) -> None:
    """Unit of velocities by the rates of positions; they are left out where it does not show."""
    if "joint_vel" in evidence.unplaced:
        return
    if "joint_vel" not in evidence.values:
        proposal.say(ABSENT, "measured velocities: left out; velocities: fit would add slopes of the positions")
        return
    if reading is None or reading.velocity is None or evidence.position_unit == ASKED:
        why = "a time" if evidence.instants is None else "positions whose unit is known, and whose rates they are"
        proposal.drop("joint_vel")
        del evidence.values["joint_vel"]
        proposal.say(
            ABSENT, f"measured velocities: left out, their unit is unknown without {why}; state units.joint_vel/*"
        )
        return
    put_unit("joint_vel", reading.velocity, evidence, proposal)
    evidence.values["joint_vel"] = evidence.values["joint_vel"] * np.where(
        evidence.robot.turning, UNITS["rad/s"][reading.velocity], 1.0
    )
    rests = f"they are the rates of positions in {evidence.position_unit}"
    is_exact = reading.velocity in DISTINCT and reading.velocity_error < CLOSE
    known = evidence.no_surer(evidence.time_known) if is_exact else GUESSED
    proposal.say(known, f"velocities are in {reading.velocity}: {rests}")


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
    proposal.say(GUESSED, f"{quantity} comes in another order than the positions ({why}): {order}")


def mirror(quantity: str, found: Match, evidence: Evidence, proposal: Proposal, whom: str) -> None:
    """Turn mirror images round: columns that count against those that they go with.

    Where all that tell a sign do, the others are turned with them: one program wrote all of them.
    """
    turned = found.clear & (found.sign < 0)
    if not turned.any():
        return
    every = turned.sum() > 1 and bool((turned == found.clear).all())
    turn(quantity, np.where(turned | every, -1.0, 1.0), evidence, proposal)
    what = {"joint_vel": "velocities", "cmd_pos": "set points", "cmd_vel": "set points of velocities"}[quantity]
    which, others = names_of(turned, evidence), names_of(~turned, evidence)
    too = f", and with them {others}, of unknown sign" if every and others else ""
    proposal.say(
        GUESSED, f"{what} of {which} are mirror images of {whom}; they are turned round{too}, if not {whom} are to be"
    )


def their_column(quantity: str, joint: str, proposal: Proposal) -> str:
    """The column that the map has for a quantity of a joint so far."""
    entries = proposal.options["columns"]
    if f"{quantity}/{joint}" in entries:
        return str(entries[f"{quantity}/{joint}"])
    names = {ours: theirs for theirs, ours in proposal.options.get("joint_names", {}).items()}
    return str(entries[f"{quantity}/*"]).replace("*", names.get(joint, joint))


def judge_set_points(reading: UnitReading | None, evidence: Evidence, proposal: Proposal) -> None:
    """Order, sign and unit of set points: a robot follows them, later. Rates that nothing tells the unit of go."""
    if evidence.time is None or evidence.position_unit == ASKED:
        return
    for quantity, measured in (("cmd_pos", "joint_pos"), ("cmd_vel", "joint_vel")):
        if quantity in evidence.values and measured in evidence.values and reading is not None:
            judge_set_point(quantity, measured, reading, evidence, proposal)
        elif quantity == "cmd_vel" and quantity in evidence.values and measured not in evidence.values:
            proposal.drop("cmd_vel")
            del evidence.values["cmd_vel"]
            says = "set points of velocities: left out, their unit is unknown without measured velocities"
            proposal.say(ABSENT, says)


def judge_set_point(quantity: str, measured: str, reading: UnitReading, evidence: Evidence, proposal: Proposal) -> None:
    """Order, sign and unit of one kind of set points."""
    clock, actual, wanted = some_rows(evidence, measured, quantity)
    if len(clock) < 2:
        says = f"the unit of {quantity}: no two rows of increasing time have it beside what is measured"
        leave_open(quantity, says, evidence, proposal)
        return
    found = match(actual, wanted, -rows_in(clock, LATE_ROBOT_S), {measured, quantity} <= evidence.named)
    if found.moved:
        reorder(quantity, found.of, evidence, proposal, "the measured ones follow it so")
    mirror(quantity, found, evidence, proposal, "the measured ones")
    _, actual, wanted = some_rows(evidence, measured, quantity)
    of_rates, clear = quantity == "cmd_vel", found.clear
    dimension, unit = ("rad/s", None) if of_rates else ("rad", reading.position)
    name = unit.name if unit else reading.velocity or dimension
    in_unit = wanted * UNITS[dimension][name] if unit is None else wanted * unit.factor
    in_unit = in_unit + (unit.offset * signs_of(quantity, proposal) if unit else 0.0)
    size = spread_ratio(actual, in_unit, clear) if clear.any() else 1.0
    if abs(np.log(size)) < np.log1p(NEAR):  # the unit of the measured ones, which nothing is nearer to
        known = evidence.no_surer(evidence.time_known if of_rates else SURE)
    else:
        known, other = GUESSED, nearest(spread_ratio(actual, wanted, clear), dimension)
        if other is None:
            ask_for_scale(quantity, size, evidence, proposal)
            return
        name, unit = other, None
        in_unit = wanted * UNITS[dimension][other]
    if not of_rates and clear.any() and from_another_zero(actual[:, clear], in_unit[:, clear]):
        ask_for_scale(quantity, size, evidence, proposal)
        return
    if unit is not None:
        scale(quantity, unit, evidence, proposal)
    else:
        put_unit(quantity, name, evidence, proposal)
        turning = np.where(evidence.robot.turning, UNITS[dimension][name], 1.0)
        evidence.values[quantity] = evidence.values[quantity] * turning
    if not clear.all():
        which = "no joint follows" if not clear.any() else f"all joints but {names_of(~clear, evidence)} follow"
        proposal.say(GUESSED, f"{quantity} is in {name}, as what is measured: {which} it closely enough to be sure")
    elif not abs(np.log(size)) < np.log1p(0.15):
        proposal.say(
            GUESSED, f"{quantity} is in {name}, the nearest unit: what is measured moves {size:.3g} times as far"
        )
    else:
        proposal.say(known, f"{quantity} is in {name}: what is measured follows it")


def spread_ratio(actual: np.ndarray, wanted: np.ndarray, clear: np.ndarray) -> float:
    """How many times as far joints move as they are told, the median of those that clearly follow."""
    return float(np.median(np.std(actual[:, clear], axis=0) / np.std(wanted[:, clear], axis=0)))


def from_another_zero(actual: np.ndarray, wanted: np.ndarray) -> bool:
    """Whether set points are followed from far away: offsets from a pose, as a policy's actions are."""
    apart = np.abs(np.median(actual - wanted, axis=0))
    return bool((apart > np.maximum(FAR_RAD, np.ptp(actual, axis=0))).any())


def ask_for_scale(quantity: str, size: float, evidence: Evidence, proposal: Proposal) -> None:
    """Leave open what set points are that are followed, but in no unit or from another zero."""
    says = (
        f"the scale of {quantity}: the joints follow it, {size:.3g} times as far or from another zero, as those of a "
        f"policy's actions do; state factors and offsets of {quantity}/*, and its unit"
    )
    leave_open(quantity, says, evidence, proposal)


def leave_open(quantity: str, says: str, evidence: Evidence, proposal: Proposal) -> None:
    """Ask for the unit of a quantity, which the map has without one."""
    proposal.put("units", f"{quantity}/*", ASKED)
    proposal.say(MISSING, says)
    evidence.values.pop(quantity)
    evidence.unplaced.add(quantity)
