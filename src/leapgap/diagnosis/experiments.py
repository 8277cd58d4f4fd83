"""Experiments that may tell causes apart: each states what to do in numbers, and plans the logs that it would give."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.diagnosis.experiment_plans import (
    Given,
    commands_of,
    from_rest,
    names_of,
    plan_of,
    planned,
    repeated,
    standing_commands,
    with_start,
)
from leapgap.effects.bodies import links_at
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns
from leapgap.simulation.open_loop import Course, MotionPlan, raise_front, with_block
from leapgap.simulation.rollout import LOAD

REPEATS = "repeats"  # Key of a proposal's settings: how many times each log is to be made
OTHER_GAINS, OTHER_GAINS_FLOATING = (0.5, 2.0), (0.7, 1.4)
"""Factors on kp and kd; less far from what was logged where a robot stands on its feet by them."""
OTHER_SPEEDS = (0.5, 2.0)
FINER_RATE, COARSE_S = 4, 0.004  # Rows of at least this length, s, may be logged and sent so many times as often
LOAD_SHARE = 0.6  # A known load, as a share of the mass of all that moves with the link that carries it
OTHER_BLOCKS_M, MOST_FURTHER_JUMPS = (0.02, 0.08), 8
LOG_S, ONSET_S = 2.0, 0.25
"""Least length of a log of sines, and the time in which their amplitude grows; a slow sine is logged for a period."""
WIDE_HZ, SLOW_HZ, FAST_HZ, RATIOS = 0.25, 0.7, 3.0, (0.8, 1.0, 1.25)
"""Frequencies of sines; each experiment has three logs, at these multiples."""
RANGE_SHARE, LARGEST_RAD, LARGEST_STANDING_RAD = 0.6, 1.2, 0.15
"""Amplitude of a sine: at most this share of what the joint can turn from its pose to its nearer end, and no more."""
FASTEST_SHARE = 1.5  # A sine is at most so many times faster than the fastest joint of the logs
LEAST_RAD, GENTLER = 0.02, 0.6
"""Smallest amplitude, and the factor on that of a sine that the motors or joints cannot follow."""
APART = 0.13  # Joints that move together differ in frequency by this share, so that each moves in its own way
AGAIN = "record the same motions again"


@dataclass(frozen=True, eq=False)
class Experiment:
    """Further logs, and what they need beside commands."""

    kind: str
    numbers: Mapping[str, Any]  # From which ``experiment_of`` restores it
    cost: int  # Order of the effort that it takes: of those that tell causes apart, the least is proposed
    words: str  # What to do, as an imperative with numbers
    short: str  # The experiment in a few words, after "at" or "with"
    make: Callable[[], list[Log]]  # Plans the logs, with commands and no measurements
    count: int | None = None  # How many logs to make, where these are more than are planned
    is_alike: bool = False
    """Whether its motions are nearly the logged ones, so that they tell causes apart in the same proportion."""
    sensors: tuple[str, ...] = ()  # Columns of sensors that are logged besides
    collect: tuple[str, ...] = ()  # Settings of ``stages.collect`` that make it on simulated hardware
    gentler: Callable[[], "Experiment"] | None = None
    """The same with a smaller motion, where the robot cannot make it; None where it has no size."""

    @cached_property
    def plans(self) -> list[Log]:
        """The logs to make."""
        return self.make()

    @property
    def number(self) -> int:
        """How many logs to make."""
        return len(self.plans) if self.count is None else self.count

    @property
    def settings(self) -> dict[str, Any]:
        """The experiment as data."""
        return {"kind": self.kind, **self.numbers}


def candidates_for(given: Given) -> list[Experiment]:
    """All experiments that are possible, the least effort first."""
    robot, joints = given.robot, given.joints
    held, planned_pd = not robot.has_free_base, given.has_gains and given.is_even
    found = []
    if given.has_gains:  # softer and stiffer
        found += [other_gains(given, factor) for factor in (OTHER_GAINS if held else OTHER_GAINS_FLOATING)]
    if given.is_jumps:
        found.append(other_jumps(given))
    if held:
        (link,) = links_at(robot, joints[-1])
        body, mass = robot.model.body(link).name, float(f"{LOAD_SHARE * robot.model.body_subtreemass[link]:.2g}")
        frequencies = [None, SLOW_HZ, FAST_HZ] if planned_pd else [None]
        found += [known_load(given, joints[-1], body, mass, hz) for hz in frequencies if mass > 0]
    if given.is_even and all(log.info.sample_period_s >= COARSE_S for log in given.logs):
        found.append(finer_rate(given, FINER_RATE))
    can = () if held else sensor_columns(robot)
    for columns in (IMU_ACCELERATION, tuple(FOOT_FORCE + foot for foot in robot.feet)):
        if columns and set(columns) <= set(can) and not all(name in log for name in columns for log in given.logs):
            found.append(further_sensor(given, columns))
    if planned_pd:  # a standing robot cannot move wide
        rates = [WIDE_HZ, SLOW_HZ, FAST_HZ] if held else [SLOW_HZ, FAST_HZ]
        every = (sines_of(given, some, rate) for some in given.sine_places for rate in rates)
        found += [one for one in every if max(one.numbers["amplitude"]) >= LEAST_RAD]
    if planned_pd and held:  # a robot on its feet would fall
        found += [other_speed(given, factor) for factor in OTHER_SPEEDS]
    if held and given.is_even and not given.has_gains:
        most = {joint: max(float(np.abs(log[f"cmd_tau/{joint}"]).max()) for log in given.logs) for joint in joints}
        moved = tuple(joint for joint in joints if most[joint] > 0)
        sizes = [tuple(share * most[joint] for joint in moved) for share in (0.5, 1.0)] if moved else []
        found += [torque_sines(given, moved, size, hz) for size in sizes for hz in (SLOW_HZ, FAST_HZ)]
    return sorted(found, key=lambda one: one.cost)


def repetition(given: Given) -> Experiment:
    """The same motions again; it tells what the logs tell today, and is never proposed."""
    return Experiment("repetition", {}, 0, AGAIN, "again", lambda: repeated(given))


def other_gains(given: Given, factor: float) -> Experiment:
    """The same motions with other gains of the joint PD."""

    def make() -> list[Log]:
        found = []
        for plan in repeated(given):
            gains = [name for name in plan.columns if name.startswith(("cmd_kp/", "cmd_kd/"))]
            found.append(replace(plan, columns=dict(plan.columns) | {name: factor * plan[name] for name in gains}))
        return found

    short, alike = f"with {factor:g} times the gains", given.robot.has_free_base  # whose gains change little
    words = f"{AGAIN} {short} ({given.gains(factor)})"
    return Experiment("gains", {"factor": factor}, 1, words, short, make, is_alike=alike)


def other_speed(given: Given, factor: float) -> Experiment:
    """The same motions slower or faster: velocities scale, feed-forward torque stays at its place."""
    short = f"{factor:g} times as fast"
    words, numbers = f"{AGAIN}, {short}", {"factor": factor}
    return Experiment(
        "speed", numbers, 1, words, short, lambda: [at_speed(plan, factor, given.robot) for plan in repeated(given)]
    )


def at_speed(log: Log, factor: float, robot: Robot) -> Log:
    """One log at another speed."""
    period = log.info.sample_period_s
    time = np.arange(max(2, round(len(log) / factor))) * period
    source = np.minimum(time * factor, (len(log) - 1) * period)
    columns = {name: np.interp(source, np.arange(len(log)) * period, log[name]) for name in commands_of(log)}
    columns |= {name: factor * values for name, values in columns.items() if name.startswith("cmd_vel/")}
    start = motion_of(log, robot, slice(1)).first_state
    start[robot.model.nq :] *= factor
    return planned(log.name, columns, start, log.info, robot)


def finer_rate(given: Given, factor: int) -> Experiment:
    """The same motions, commanded and logged more often: each command is held for several shorter rows."""

    def make() -> list[Log]:
        found = []
        for log in repeated(given):
            columns = {name: np.repeat(log[name], factor) for name in commands_of(log)}
            info = replace(log.info, sample_period_s=log.info.sample_period_s / factor)
            start = motion_of(log, given.robot, slice(1)).first_state
            found.append(planned(log.name, columns, start, info, given.robot))
        return found

    words = f"{AGAIN} at {factor / min(log.info.sample_period_s for log in given.logs):.0f} Hz"
    return Experiment("rate", {"factor": factor}, 2, words, f"logged {factor} times as often", make)


def further_sensor(given: Given, columns: tuple[str, ...]) -> Experiment:
    """The same motions with a further sensor."""
    sensor = "the accelerometer" if columns == IMU_ACCELERATION else "the forces at the feet"
    words, numbers = f"record {sensor} too", {"columns": columns}
    return Experiment("sensor", numbers, 4, words, f"with {sensor}", lambda: repeated(given), sensors=columns)


def known_load(given: Given, joint: str, body: str, mass_kg: float, frequency_hz: float | None = None) -> Experiment:
    """Motions with a known mass at the centre of mass of the link that a joint moves, which the logs' metadata state.

    In sines of all joints; at no frequency, in the motions of the logs.
    """
    motion = repetition(given) if frequency_hz is None else sines_of(given, given.joints, frequency_hz)
    extra = {LOAD: {joint: mass_kg}}

    def make() -> list[Log]:
        return [replace(plan, info=replace(plan.info, extra={**plan.info.extra, **extra})) for plan in motion.plans]

    words = (
        f"{motion.words}, with {mass_kg:g} kg fastened at the centre of mass of {body} "
        f'(metadata of these logs: "load": {{"{joint}": {mass_kg:g}}})'
    )
    short = f"with {mass_kg:g} kg at {body}" + ("" if frequency_hz is None else f", sines of {frequency_hz:g} Hz")
    numbers = {"joint": joint, "body": body, "mass_kg": mass_kg, "frequency_hz": frequency_hz}
    return Experiment("load", numbers, 3, words, short, make)


def other_jumps(given: Given) -> Experiment:
    """Jumps to the logged distances with the front feet on low and high blocks in turn.

    Twice as many as were logged, if that is not too many. Jumps to other distances need plans that nobody has simulated
    yet, of which the longest slip at take-off.
    """

    def make() -> list[Log]:
        robot, found = given.robot, []
        for k, log in enumerate(given.logs):
            height = OTHER_BLOCKS_M[k % len(OTHER_BLOCKS_M)]
            under = max((box.top_m for box in log.info.terrain), default=0.0)
            bare = replace(log, info=replace(log.info, terrain=()))
            block = with_block(bare, MotionPlan("", bare, height), robot, Course())
            state = raise_front(motion_of(log, robot, slice(1)).first_state, height - under, robot)
            found.append(with_start(plan_of(block, k, robot), state, robot))
        return found

    low, high = OTHER_BLOCKS_M
    distances = sorted({float(log.info.extra["target"]["x_m"]) for log in given.logs})
    number = max(len(distances), min(2 * len(given.logs), MOST_FURTHER_JUMPS))
    words = (
        f"record {number} further jumps, to {', '.join(f'{100 * x:g}' for x in distances)} cm, with the front feet on "
        f"blocks of {100 * low:g} to {100 * high:g} cm"
    )
    targets = ",".join(f"[{x:g},0.0]" for x in distances)
    collect = (f"targets=[{targets}]", f"jumps={number}", f"block_height_m=[{low:g},{high:g}]")
    settings = tuple(f"collect.{one}" for one in collect)
    return Experiment("jumps", {}, 1, words, "on other blocks", make, number, is_alike=True, collect=settings)


def sines_of(given: Given, joints: tuple[str, ...], frequency_hz: float) -> Experiment:
    """Sines at some joints, as large as these can make them."""
    return sines(given, joints, tuple(largest_amplitude(joint, frequency_hz, given) for joint in joints), frequency_hz)


def sines(given: Given, joints: tuple[str, ...], amplitude: tuple[float, ...], frequency_hz: float) -> Experiment:
    """Sines of some joints, rad (m for slides), about the pose of the logs, the others held; three logs.

    By the median gains and feed-forward torque of the logs.
    """
    length_s = max(LOG_S, 1 / frequency_hz)

    def make() -> list[Log]:
        return [sine_plan(given, k, joints, amplitude, frequency_hz * by, length_s) for k, by in enumerate(RATIOS)]

    least, most = min(amplitude), max(amplitude)
    size = f"{most:.2g}" if most - least < 0.05 * most else f"{least:.2g} to {most:.2g}"
    where = "all joints" if joints == given.joints else f"{names_of(joints, given.robot)} alone"
    words = (
        f"record {len(RATIOS)} sines of {length_s:g} s at {where}, {size} rad, {band(frequency_hz)}, {given.gains()}, "
        "about the pose of the logs"
    )
    short = f"with sines of {frequency_hz:g} Hz at {joints[0] if len(joints) == 1 else f'{len(joints)} joints'}"
    numbers = {"joints": joints, "amplitude": amplitude, "frequency_hz": frequency_hz}
    smaller = tuple(float(f"{GENTLER * size:.2g}") for size in amplitude)
    return Experiment(
        "sines", numbers, 2, words, short, make, gentler=lambda: sines(given, joints, smaller, frequency_hz)
    )


def sine_plan(
    given: Given, number: int, joints: Sequence[str], sizes: Sequence[float], frequency_hz: float, length_s: float
) -> Log:
    """The log of one frequency."""
    time = times(length_s, given)
    onset = np.clip(time / ONSET_S, 0, 1)
    growth, rate = onset**2 * (3 - 2 * onset), 6 * onset * (1 - onset) / ONSET_S
    columns = standing_commands(given, len(time))
    for k, (joint, size) in enumerate(zip(joints, sizes, strict=True)):
        turn = 2 * np.pi * frequency_hz * (1 + APART * k / max(1, len(joints) - 1))
        sine, slope = np.sin(turn * time), turn * np.cos(turn * time)
        columns[f"cmd_pos/{joint}"] = columns[f"cmd_pos/{joint}"] + size * growth * sine
        columns[f"cmd_vel/{joint}"] = size * (growth * slope + rate * sine)
    return from_rest(given, number, columns)


def torque_sines(
    given: Given, joints: tuple[str, ...], amplitude: tuple[float, ...], frequency_hz: float
) -> Experiment:
    """Sines of torque, N·m (N for slides), at some joints of a robot without joint PD; three logs of two seconds."""

    def make() -> list[Log]:
        time, found = times(LOG_S, given), []
        for number, ratio in enumerate(RATIOS):
            columns = standing_commands(given, len(time))
            for k, (joint, size) in enumerate(zip(joints, amplitude, strict=True)):
                turn = 2 * np.pi * frequency_hz * ratio * (1 + APART * k)
                columns[f"cmd_tau/{joint}"] = size * np.sin(turn * time)
            found.append(from_rest(given, number, columns))
        return found

    words = (
        f"record {len(RATIOS)} sines of torque of {LOG_S:g} s at {names_of(joints, given.robot)}, "
        f"{max(amplitude):.2g} N·m, {band(frequency_hz)}, from the pose of the logs"
    )
    short = f"with sines of {max(amplitude):.2g} N·m at {frequency_hz:g} Hz"
    numbers = {"joints": joints, "amplitude": amplitude, "frequency_hz": frequency_hz}
    return Experiment("torque_sines", numbers, 2, words, short, make)


def largest_amplitude(joint: str, frequency_hz: float, given: Given) -> float:
    """Amplitude of a sine at a joint, within its range and what it did in the logs, to two digits."""
    robot, which = given.robot, given.robot.joints.index(joint)
    number = robot.model.joint(joint).id
    most = LARGEST_STANDING_RAD if robot.has_free_base else LARGEST_RAD
    if robot.model.jnt_limited[number]:
        low, high = robot.model.jnt_range[number]
        at = float(given.pose[robot.joint_qpos[which]])
        most = min(most, RANGE_SHARE * max(0.0, min(at - float(low), float(high) - at)))
    speed = FASTEST_SHARE * given.fastest
    return float(f"{min(most, speed / (2 * np.pi * frequency_hz)):.2g}")


def times(seconds: float, given: Given) -> np.ndarray:
    """Times of the rows of a log of so many seconds, s."""
    period = given.logs[0].info.sample_period_s
    return np.asarray(np.arange(round(seconds / period) + 1) * period)


def band(frequency_hz: float) -> str:
    """The frequencies of an experiment's logs in words."""
    low, high = (frequency_hz * ratio for ratio in (RATIOS[0], RATIOS[-1]))
    return f"{low:.2g} to {high:.2g} Hz"


KINDS: dict[str, Callable[..., Experiment]] = {
    "gains": other_gains,
    "jumps": other_jumps,
    "load": known_load,
    "rate": finer_rate,
    "sensor": further_sensor,
    "sines": sines,
    "speed": other_speed,
    "torque_sines": torque_sines,
}


def experiment_of(settings: Mapping[str, Any], given: Given) -> Experiment:
    """The experiment that a report proposes, from its settings."""
    numbers = {
        key: tuple(v) if isinstance(v, list) else v for key, v in settings.items() if key not in ("kind", REPEATS)
    }
    return KINDS[settings["kind"]](given, **numbers)


def plans_of(settings: Mapping[str, Any], given: Given) -> list[Log]:
    """The logs that a report proposes to make: those of the experiment, as many times as it asks for."""
    plans = experiment_of(settings, given).plans * int(settings.get(REPEATS, 1))
    return [replace(plan, name=f"next_{k}") for k, plan in enumerate(plans)]
