"""Units, signs and order of the joints' columns, by physics."""

import numpy as np

from leapgap.logs.importers.column_map import UNITS
from leapgap.logs.map_proposal.evidence import (
    ABSENT,
    ASKED,
    GUESSED,
    MISSING,
    SURE,
    Draft,
    Match,
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


def some_rows(draft: Draft, *quantities: str) -> tuple[np.ndarray, ...]:
    """Clock and quantities in the rows that are looked at: those whose numbers are whole and whose time increases.

    The clock is in s where its unit is known, else in its own.
    """
    clock = draft.time if draft.time is not None else draft.instants
    assert clock is not None
    values = [draft.values[name] for name in quantities]
    rows = usable_rows(clock, np.concatenate(values, axis=1))
    return clock[rows], *(one[rows] for one in values)


def rows_in(clock: np.ndarray, seconds: float, unit: str = "s") -> int:
    """Rows that last so long, at most a quarter of all."""
    step = float(np.median(np.diff(clock))) * UNITS["s"][unit]
    return int(min(seconds / step, len(clock) // 4))


def judge_units(draft: Draft) -> UnitReading | None:
    """The units of clock, positions and velocities that go together; None without positions."""
    if "joint_pos" not in draft.values:
        if "joint_pos" not in draft.unplaced:
            draft.say(MISSING, "measured positions of the joints: map columns.joint_pos/*")
        return None
    beside = rates_beside(draft)
    if beside is not None:  # each joint gets the velocity that is the rate of its position
        if beside[0].moved:
            reorder("joint_vel", beside[0].of, draft, "each follows the rate of that joint's position")
        mirror("joint_vel", beside[0], draft, "their positions")
    numbers = numbers_of(draft)
    # Units that the names of the columns of positions speak of
    said = {word for joint in draft.robot.joints for word in words(their_column("joint_pos", joint, draft))}
    stated = {str(draft.stated.get("unit"))} & set(UNIT_WORDS.values())
    found = readings(
        numbers,
        draft.robot,
        draft.time_units,
        sorted({UNIT_WORDS[word] for word in said & UNIT_WORDS.keys()} | stated),
        "joint_pos" not in draft.named,
    )
    if not found:
        draft.say(MISSING, "units of clock and positions: the joints would be too fast, or leave their limits, in all")
        return None
    best, names = found[0], list(dict.fromkeys(one.position.name for one in found))
    draft.time_known = SURE if len({one.time for one in found}) == 1 else GUESSED
    asked = draft.stated.get("unit") == "normalised" and {NORMALISED, PERCENT} & set(names)
    if asked:
        ask_for_calibration(draft)
        return best
    tell_odd_rates(best, numbers, draft)
    turn_round(best, draft)
    scale("joint_pos", best.position, draft)
    unit = draft.position_unit = best.position.name
    draft.certainty = SURE if len(names) == 1 and unit in DISTINCT else GUESSED
    rivals = ", ".join(sorted(names[1:], key=LIKELY.__getitem__))
    if draft.certainty == SURE:
        draft.say(SURE, f"positions are in {unit}: limits and rates of the joints rule out all others")
    else:
        also = f"{rivals} {'fits' if len(names) == 2 else 'fit'} as well" if rivals else "no other unit known here fits"
        draft.say(GUESSED, f"positions are in {unit}: {also}; if another, state units.joint_pos/*")
    if draft.stated.get("unit") == unit:
        open_grippers(draft)
    if unit in (NORMALISED, PERCENT):
        draft.say(GUESSED, "range of each joint: that of the model; the robot's own calibration may have another")
    return best


def tell_odd_rates(reading: UnitReading, numbers: JointNumbers, draft: Draft) -> None:
    """Name the joints whose velocities are not the rates of their positions, while those of the others are."""
    if numbers.rate is None or reading.velocity is None:
        return
    unit = UNITS["s"][reading.time] * UNITS["rad/s"][reading.velocity]
    ratio = numbers.rate * reading.position.factor / unit
    for i in np.flatnonzero(np.isfinite(ratio) & (np.abs(np.log(np.where(ratio > 0, ratio, 1.0))) > ODD)):
        says = f"{draft.robot.joints[i]}'s position changes {ratio[i]:.3g} times as fast as its velocity says"
        draft.say(GUESSED, f"{says}, unlike the others': one of the two is of another scale; check it")


def open_grippers(draft: Draft) -> None:
    """Let grippers, which a calibration counts from their closed end, begin at the lower limit of the model."""
    limits, real = real_limits(draft.robot)
    for i, joint in enumerate(draft.robot.joints):
        if real[i] and GRIPPER in their_column("joint_pos", joint, draft):
            for quantity in ("joint_pos", "cmd_pos"):
                if quantity in draft.values:
                    draft.put("offsets", f"{quantity}/{joint}", float(f"{limits[i, 0]:.6g}"))
            draft.values["joint_pos"][:, i] += limits[i, 0]
            draft.say(GUESSED, f"{joint} is closed at the lower limit of the model, {limits[i, 0]:.3g} rad")


def ask_for_calibration(draft: Draft) -> None:
    """Leave the unit open where shares of each joint's range are what such a robot records."""
    draft.say(
        MISSING,
        "the unit of positions: −100…100 of each joint's range, as this kind of robot records by default, or degrees, "
        "unclear. If shares, state calibration: <LeRobot's calibration file of this robot>; then, or if degrees, "
        "units: {joint_pos/*: deg, cmd_pos/*: deg}. A gripper is 0…100 either way",
    )
    open_grippers(draft)
    for quantity in ("joint_pos", "cmd_pos"):
        if quantity in draft.values:
            draft.put("units", f"{quantity}/*", ASKED)
    draft.position_unit = ASKED


def rates_beside(draft: Draft) -> tuple[Match, np.ndarray, np.ndarray] | None:
    """How velocities go with rates of positions, and the means of both, (rows, joints), units of the file; or None."""
    if "joint_vel" not in draft.values or draft.instants is None:
        return None
    clock, position, velocity = some_rows(draft, "joint_pos", "joint_vel")
    if len(clock) < LEAST_ROWS:
        return None
    rows = rows_meant(rows_step(clock, draft))
    named = {"joint_pos", "joint_vel"} <= draft.named
    rate, mean = mean_rates(clock, position, rows), mean_values(clock, velocity, rows)
    return match(rate, mean, rows_in(clock, LATE_VELOCITY_S, draft.time_units[0]), named), rate, mean


def rows_step(clock: np.ndarray, draft: Draft) -> float:
    """The usual step of a clock whose unit is likely, s."""
    return float(np.median(np.diff(clock))) * UNITS["s"][draft.time_units[0]]


LEAST_ROWS = 40  # rows below which no rates are looked at


def numbers_of(draft: Draft) -> JointNumbers:
    """What the units are judged by, with velocities in the order of the positions."""
    position = draft.values["joint_pos"]
    whole = bool((position == np.round(position)).all())
    speed = rate = None
    exact = False
    if draft.instants is not None:
        clock, at = some_rows(draft, "joint_pos")
        if len(clock) >= LEAST_ROWS:
            speed = np.quantile(np.abs(mean_rates(clock, at, rows_meant(rows_step(clock, draft)))), 0.9, axis=0)
    beside = rates_beside(draft)
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


def turn_round(reading: UnitReading, draft: Draft) -> None:
    """Turn joints round that lie within their limits only so; name those that lie outside either way."""
    limits, real = real_limits(draft.robot)
    low, high = np.nanmin(draft.values["joint_pos"], axis=0), np.nanmax(draft.values["joint_pos"], axis=0)
    low, high = (end * reading.position.factor + reading.position.offset for end in (low, high))
    outside = real & ~inside(low, high, limits)
    flipped = outside & inside(-high, -low, limits) & (reading.position.offset == 0)
    if flipped.any():
        signs = np.where(flipped, -1.0, 1.0)
        for quantity in ("joint_pos", "joint_vel"):
            if quantity in draft.values:
                turn(quantity, signs, draft)
        which = names_of(flipped, draft)
        draft.say(GUESSED, f"sign of {which} turned round: only so they lie within their limits, or zero is elsewhere")
    for i in np.flatnonzero(outside & ~flipped):
        bounds = f"its limits are {limits[i, 0]:.3g} to {limits[i, 1]:.3g}"
        says = f"{draft.robot.joints[i]} moves from {low[i]:.3g} to {high[i]:.3g} rad, {bounds}"
        far = np.median(np.abs(draft.values["joint_pos"][:, i])) > 0 and not reading.is_inside
        middle, width = 0.5 * (low[i] + high[i]), np.ptp(limits[i])
        near = limits[i, 0] - 0.1 * width < middle < limits[i, 1] + 0.1 * width  # at times outside, by a little
        draft.say(MISSING if far and not near else GUESSED, f"{says}: check the order of joints, units and offsets")


def names_of(which: np.ndarray, draft: Draft) -> str:
    """Names of some joints."""
    return ", ".join(joint for joint, one in zip(draft.robot.joints, which, strict=True) if one)


def turn(quantity: str, signs: np.ndarray, draft: Draft) -> None:
    """Multiply a quantity of each joint by a sign, in the map and in the values."""
    former = draft.options.get("factors", {}).pop(f"{quantity}/*", 1.0)
    found = signs * former
    if (found < 0).any():
        draft.put("factors", f"{quantity}/*", -1.0 if (found < 0).all() else found.tolist())
    draft.values[quantity] = draft.values[quantity] * signs


def scale(quantity: str, unit: Scale, draft: Draft) -> None:
    """Put a unit of positions into the map, and the values into SI."""
    every, offset = f"{quantity}/*", unit.offset * signs_of(quantity, draft)
    if unit.name in UNITS["rad"]:
        put_unit(quantity, unit.name, draft)
    else:
        factor = unit.factor * signs_of(quantity, draft)
        draft.put("factors", every, [float(f"{one:.9g}") for one in factor])
        draft.values[quantity] = draft.values[quantity] * unit.factor
    if offset.any():
        draft.put("offsets", every, [float(f"{one:.9g}") for one in offset])
    draft.values[quantity] = draft.values[quantity] + offset


def signs_of(quantity: str, draft: Draft) -> np.ndarray | float:
    """The signs that the map has for a quantity so far, 1 or one a joint."""
    return np.sign(draft.options.get("factors", {}).get(f"{quantity}/*", 1.0))


def put_unit(quantity: str, unit: str, draft: Draft) -> None:
    """Put a unit of angles or their rates into the map, of the joints that turn, and the values into SI."""
    factor = next(UNITS[of][unit] for of in ("rad", "rad/s") if unit in UNITS[of])
    turns = draft.robot.turning
    draft.values[quantity] = draft.values[quantity] * np.where(turns, factor, 1.0)
    if factor == 1:
        return
    for ours in ["*"] if turns.all() else [j for j, one in zip(draft.robot.joints, turns, strict=True) if one]:
        draft.put("units", f"{quantity}/{ours}", unit)


def judge_velocities(reading: UnitReading | None, draft: Draft) -> None:
    """Unit of velocities by the rates of positions; they are left out where it does not show."""
    if "joint_vel" in draft.unplaced:
        return
    if "joint_vel" not in draft.values:
        draft.say(ABSENT, "measured velocities: left out; velocities: fit would add slopes of the positions")
        return
    if reading is None or reading.velocity is None or draft.position_unit == ASKED:
        why = "a time" if draft.instants is None else "positions whose unit is known, and whose rates they are"
        says = f"measured velocities: left out, their unit is unknown without {why}; state units.joint_vel/*"
        draft.leave_out("joint_vel", says)
        return
    put_unit("joint_vel", reading.velocity, draft)
    is_exact = reading.velocity in DISTINCT and reading.velocity_error < CLOSE
    known = draft.no_surer(draft.time_known) if is_exact else GUESSED
    draft.say(known, f"velocities are in {reading.velocity}: they are the rates of positions in {draft.position_unit}")


def reorder(quantity: str, of: np.ndarray, draft: Draft, why: str) -> None:
    """Give each joint the column of a family that physics says is its own."""
    entries, joints = draft.options["columns"], draft.robot.joints
    theirs = [their_column(quantity, joint, draft) for joint in joints]
    for key in [key for key in entries if key.partition("/")[0] == quantity]:
        del entries[key]
    for joint, at in zip(joints, of, strict=True):
        entries[f"{quantity}/{joint}"] = theirs[at]
    draft.values[quantity] = draft.values[quantity][:, of]
    order = ", ".join(f"{theirs[at]} = {joint}" for joint, at in zip(joints, of, strict=True))
    draft.say(GUESSED, f"{quantity} comes in another order than the positions ({why}): {order}")


def mirror(quantity: str, found: Match, draft: Draft, whom: str) -> None:
    """Turn mirror images round: columns that count against those that they go with.

    Where all that tell a sign do, the others are turned with them: one program wrote all of them.
    """
    turned = found.clear & (found.sign < 0)
    if not turned.any():
        return
    every = turned.sum() > 1 and bool((turned == found.clear).all())
    turn(quantity, np.where(turned | every, -1.0, 1.0), draft)
    what = {"joint_vel": "velocities", "cmd_pos": "set points", "cmd_vel": "set points of velocities"}[quantity]
    which, others = names_of(turned, draft), names_of(~turned, draft)
    too = f", and with them {others}, of unknown sign" if every and others else ""
    draft.say(
        GUESSED, f"{what} of {which} are mirror images of {whom}; they are turned round{too}, if not {whom} are to be"
    )


def their_column(quantity: str, joint: str, draft: Draft) -> str:
    """The column that the map has for a quantity of a joint so far."""
    entries = draft.options["columns"]
    if f"{quantity}/{joint}" in entries:
        return str(entries[f"{quantity}/{joint}"])
    names = {ours: theirs for theirs, ours in draft.options.get("joint_names", {}).items()}
    return str(entries[f"{quantity}/*"]).replace("*", names.get(joint, joint))


def judge_set_points(reading: UnitReading | None, draft: Draft) -> None:
    """Order, sign and unit of set points: a robot follows them, later. Rates that nothing tells the unit of go."""
    if draft.time is None or draft.position_unit == ASKED:
        return
    for quantity, measured in (("cmd_pos", "joint_pos"), ("cmd_vel", "joint_vel")):
        if quantity in draft.values and measured in draft.values and reading is not None:
            judge_set_point(quantity, measured, reading, draft)
        elif quantity == "cmd_vel" and quantity in draft.values and measured not in draft.values:
            says = "set points of velocities: left out, their unit is unknown without measured velocities"
            draft.leave_out("cmd_vel", says)


def judge_set_point(quantity: str, measured: str, reading: UnitReading, draft: Draft) -> None:
    """Order, sign and unit of one kind of set points."""
    clock, actual, wanted = some_rows(draft, measured, quantity)
    if len(clock) < 2:
        says = f"the unit of {quantity}: no two rows of increasing time have it beside what is measured"
        leave_open(quantity, says, draft)
        return
    found = match(actual, wanted, -rows_in(clock, LATE_ROBOT_S), {measured, quantity} <= draft.named)
    if found.moved:
        reorder(quantity, found.of, draft, "the measured ones follow it so")
    mirror(quantity, found, draft, "the measured ones")
    _, actual, wanted = some_rows(draft, measured, quantity)
    of_rates, clear = quantity == "cmd_vel", found.clear
    dimension, unit = ("rad/s", None) if of_rates else ("rad", reading.position)
    name = unit.name if unit else reading.velocity or dimension
    in_unit = wanted * UNITS[dimension][name] if unit is None else wanted * unit.factor
    in_unit = in_unit + (unit.offset * signs_of(quantity, draft) if unit else 0.0)
    size = spread_ratio(actual, in_unit, clear) if clear.any() else 1.0
    if abs(np.log(size)) < np.log1p(NEAR):  # the unit of the measured ones, which nothing is nearer to
        known = draft.no_surer(draft.time_known if of_rates else SURE)
    else:
        known, unit = GUESSED, None
        name = nearest(spread_ratio(actual, wanted, clear), dimension) or ASKED
        in_unit = wanted * UNITS[dimension].get(name, 1)
    # Offsets from a pose, as a policy's actions are, are followed from far away
    apart = np.abs(np.median(actual - in_unit, axis=0)) > np.maximum(FAR_RAD, np.ptp(actual, axis=0))
    if name == ASKED or (not of_rates and apart[clear].any()):
        says = (
            f"the scale of {quantity}: the joints follow it, {size:.3g} times as far or from another zero, as those of "
            f"a policy's actions do; state factors and offsets of {quantity}/*, and its unit"
        )
        leave_open(quantity, says, draft)
        return
    if unit is not None:
        scale(quantity, unit, draft)
    else:
        put_unit(quantity, name, draft)
    if not clear.all():
        which = "no joint follows" if not clear.any() else f"all joints but {names_of(~clear, draft)} follow"
        draft.say(GUESSED, f"{quantity} is in {name}, as what is measured: {which} it closely enough to be sure")
    elif not abs(np.log(size)) < np.log1p(0.15):
        draft.say(GUESSED, f"{quantity} is in {name}, the nearest unit: what is measured moves {size:.3g} times as far")
    else:
        draft.say(known, f"{quantity} is in {name}: what is measured follows it")


def spread_ratio(actual: np.ndarray, wanted: np.ndarray, clear: np.ndarray) -> float:
    """How many times as far joints move as they are told, the median of those that clearly follow."""
    return float(np.median(np.std(actual[:, clear], axis=0) / np.std(wanted[:, clear], axis=0)))


def leave_open(quantity: str, says: str, draft: Draft) -> None:
    """Ask for the unit of a quantity, which the map has without one."""
    draft.put("units", f"{quantity}/*", ASKED)
    draft.say(MISSING, says)
    draft.values.pop(quantity)
    draft.unplaced.add(quantity)
