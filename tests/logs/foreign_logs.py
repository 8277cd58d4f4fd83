"""Logs as strangers write them, with the truth beside them: units, rates, orders, signs, names and formats are drawn.

Plain numpy, and nothing of the importers: a robot follows sums of sines late and softly, as its servos let it.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ARM = ("panning", "lifting", "flexing", "rolling")
ARM_LIMITS = np.array([[-1.9, 1.9], [-1.7, 1.6], [-1.5, 1.7], [-2.7, 2.8]])
LEGS = ("FL", "FR", "RL", "RR")
QUADRUPED = tuple(f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "calf"))
QUADRUPED_LIMITS = np.tile([[-1.0, 1.0], [-1.5, 3.4], [-2.7, -0.84]], (4, 1))
BREADTH_FIRST = tuple(f"{leg}_{part}" for part in ("hip", "thigh", "calf") for leg in LEGS)
DEGREE, TICK, RPM = np.pi / 180, 2 * np.pi / 4096, 2 * np.pi / 60
POSITION_UNITS = {"rad": 1.0, "deg": DEGREE, "rev": 2 * np.pi, "mrad": 1e-3, "decideg": 0.1 * DEGREE}
VELOCITY_UNITS = {"rad/s": 1.0, "deg/s": DEGREE, "rpm": RPM, "register": 0.229 * RPM}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
RATES = (10.0, 30.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 5000.0)
NAMES = (
    ("time", "joint_pos_{}", "joint_vel_{}", "joint_pos_target_{}"),
    ("t", "q{}", "dq{}", "q_des{}"),
    ("stamp", "state.q[{}]", "state.dq[{}]", "cmd.q[{}]"),
    ("timestamp", "observation.{}.pos", "observation.{}.vel", "action.{}.pos"),
    ("t", "present_position_{}", "present_velocity_{}", "goal_position_{}"),
)
FORMATS = ("csv", "npz", "json", "parquet", "hdf5")


def arm_xml() -> str:
    """Four joints in a row with position servos."""
    bodies = "".join(
        f'<body pos="0 0 0.1"><joint name="{name}" axis="0 {i % 2} {1 - i % 2}" range="{low} {high}"/>'
        '<geom size="0.03" mass="0.1"/>'
        for i, (name, (low, high)) in enumerate(zip(ARM, ARM_LIMITS, strict=True))
    )
    servos = "".join(f'<position joint="{name}" kp="20"/>' for name in ARM)
    head = '<mujoco model="arm"><compiler angle="radian"/><worldbody>'
    return f"{head}{bodies}{'</body>' * 4}</worldbody><actuator>{servos}</actuator></mujoco>"


def quadruped_xml() -> str:
    """A floating trunk with four legs of three joints."""

    def leg(name: str) -> str:
        joints = zip(("hip", "thigh", "calf"), QUADRUPED_LIMITS[:3], strict=True)
        return "".join(
            f'<body pos="0 0 -0.1"><joint name="{name}_{part}" axis="0 1 0" range="{low} {high}"/>'
            '<geom size="0.03" mass="0.5"/>'
            for part, (low, high) in joints
        )

    legs = "".join(f"{leg(name)}</body></body></body>" for name in LEGS)
    motors = "".join(f'<motor joint="{name}"/>' for name in QUADRUPED)
    head = '<mujoco model="quadruped"><compiler angle="radian"/><worldbody><geom type="plane" size="1 1 1"/>'
    trunk = '<body pos="0 0 0.5"><freejoint/><geom size="0.1" mass="5"/>'
    return f"{head}{trunk}{legs}</body></worldbody><actuator>{motors}</actuator></mujoco>"


@dataclass
class Foreign:
    """Columns of a log in units of their own, and what is true of them."""

    columns: dict[str, np.ndarray]
    truth: dict[str, str] = field(default_factory=dict)
    """``time``, ``positions``, ``velocities``, ``cmd_pos``, ``quaternion``, ``gyro`` → unit or order."""


def motion(
    rng: np.random.Generator, limits: np.ndarray, rate_hz: float, share: float = 0.7, seconds: float = 6.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, s, set points, positions, rad, and velocities of joints that follow sums of sines as damped oscillators."""
    fine = 20 if rate_hz < 1000 else 4
    rows = int(min(6000, seconds * rate_hz))
    step = 1 / (rate_hz * fine)
    time = step * np.arange(rows * fine)
    size = share * 0.5 * np.ptp(limits, axis=1)
    frequency = rng.uniform(0.3, 1.2, (3, len(limits)))
    phase = rng.uniform(0, 2 * np.pi, (3, len(limits)))
    if rows / rate_hz < 3:  # a short log of a fast loop
        frequency *= 3
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase).mean(axis=1)
    wanted = limits.mean(axis=1) + size * waves
    wanted = np.repeat(wanted[::fine], fine, axis=0)  # held from row to row
    stiff = 2 * np.pi * 6.0
    position, velocity = np.empty_like(wanted), np.empty_like(wanted)
    at, speed = wanted[0].copy(), np.zeros(len(limits))
    for row in range(len(time)):
        position[row], velocity[row] = at, speed
        speed = speed + step * (stiff**2 * (wanted[row] - at) - 1.6 * stiff * speed)
        at = at + step * speed
    return time[::fine], wanted[::fine], position[::fine], velocity[::fine]


def drawn(number: int) -> tuple[str, Foreign, str]:
    """A robot, a log of it, and a format, all drawn by a number."""
    rng = np.random.default_rng([44, number])
    is_arm = bool(rng.random() < 0.6)
    joints, limits = (ARM, ARM_LIMITS) if is_arm else (QUADRUPED, QUADRUPED_LIMITS)
    rate = float(rng.choice(RATES))
    share = float(rng.choice([0.03, 0.5, 0.9]))
    time, wanted, position, velocity = motion(rng, limits, rate, share)
    units = ["rad", "deg", "rev", "mrad", "decideg", "normalised", "percent", "ticks"]
    unit = str(rng.choice(units, p=[0.35, 0.2, 0.05, 0.05, 0.05, 0.12, 0.08, 0.1]))
    time_unit = str(rng.choice(list(TIME_UNITS)))
    speed_unit = str(rng.choice([*VELOCITY_UNITS, "none"]))
    order = joints if is_arm or rng.random() < 0.5 else BREADTH_FIRST
    named = bool(rng.random() < 0.4)
    names = NAMES[int(rng.integers(len(NAMES)))]
    first = int(rng.integers(2))
    spelt = {"ticks": "tick4096"}.get(unit, unit)
    truth = {"time": time_unit, "positions": spelt, "cmd_pos": spelt}
    start = float(rng.choice([0.0, 1.7e9])) if time_unit != "s" else 0.0
    clock = (time + start) / TIME_UNITS[time_unit]
    columns = {names[0]: np.round(clock).astype(np.int64) if time_unit in ("us", "ns") else clock}
    signs = np.where(rng.random(len(joints)) < 0.15, -1.0, 1.0)
    of_speed = signs * (1.0 if rng.random() < 0.7 else -1.0)
    for i, joint in enumerate(order):
        at = joints.index(joint)
        key = joint if named else str(first + i)
        for template, values in ((names[1], position), (names[3], wanted)):
            columns[template.format(key)] = in_unit(signs[at] * values[:, at], unit, limits[at])
        if speed_unit != "none":
            columns[names[2].format(key)] = of_speed[at] * velocity[:, at] / VELOCITY_UNITS[speed_unit]
    if speed_unit != "none":
        truth["velocities"] = speed_unit
    if not is_arm:
        columns |= base_columns(rng, time, truth)
    return ("arm" if is_arm else "quadruped"), Foreign(columns, truth), str(rng.choice(FORMATS))


def in_unit(values: np.ndarray, unit: str, limits: np.ndarray) -> np.ndarray:
    """Positions, rad, in a unit of a stranger."""
    share = (values - limits[0]) / np.ptp(limits)
    others = {"normalised": 200 * share - 100, "percent": 100 * share, "ticks": np.round(values / TICK + 2048)}
    return others[unit] if unit in others else values / POSITION_UNITS[unit]


def base_columns(rng: np.random.Generator, time: np.ndarray, truth: dict[str, str]) -> dict[str, np.ndarray]:
    """A quaternion in some order, and a gyro in some unit and axes, of a trunk that rocks about all axes or one."""
    size = np.where(rng.random(3) < 0.7, rng.uniform(0.05, 0.5, 3), 0.0)
    frequency, phase = rng.uniform(0.5, 1.5, 3), rng.uniform(0, 6, 3)
    roll, pitch, yaw = (size * np.sin(2 * np.pi * frequency * time[:, None] + phase)).T
    d_roll, d_pitch, d_yaw = (size * 2 * np.pi * frequency * np.cos(2 * np.pi * frequency * time[:, None] + phase)).T
    cr, sr, cp, sp, cy, sy = (f(0.5 * a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    rate = np.stack(
        [
            d_roll - np.sin(pitch) * d_yaw,
            np.cos(roll) * d_pitch + np.sin(roll) * np.cos(pitch) * d_yaw,
            -np.sin(roll) * d_pitch + np.cos(roll) * np.cos(pitch) * d_yaw,
        ]
    )
    gravity = np.stack([np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)])
    order = str(rng.choice(["w x y z", "x y z w"]))
    parts = (w, x, y, z) if order == "w x y z" else (x, y, z, w)
    columns = {f"root_quat_{i}": part for i, part in enumerate(parts)}
    truth["quaternion"] = order
    if rng.random() < 0.7:
        unit = str(rng.choice(["rad/s", "deg/s"]))
        name = str(rng.choice(["base_ang_vel", "gyro", "root_ang_vel_b"]))
        columns |= {f"{name}_{i}": one / VELOCITY_UNITS[unit] for i, one in enumerate(rate)}
        truth["gyro"] = unit
    if rng.random() < 0.4:
        columns |= {f"projected_gravity_{i}": one for i, one in enumerate(gravity)}
    return columns


def write(folder: Path, foreign: Foreign, format: str) -> Path:
    """The log as a file of some format."""
    path = folder / f"log.{ {'hdf5': 'h5'}.get(format, format) }"
    columns = foreign.columns
    if format == "csv":
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join(repr(value) for value in row) for row in rows)]
        path.write_text("\n".join(lines))
    elif format == "npz":
        np.savez(path, **columns)
    elif format == "json":
        path.write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))
    elif format == "parquet":
        pq.write_table(pa.table(columns), path)
    else:
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values
    return path
