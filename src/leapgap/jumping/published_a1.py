"""The layout of the published A1 jumps (DRCL-USC/Learning_MPC_Jumping): a folder of text files a jump.

What is known of the layout, gains and clock comes with that data set's description; each column is placed here once.
Angles rad, forces N, torques N·m, positions m, world x forward, y left, z up; pitch positive nose-down.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.importers.base import LogFormat
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, PAIR_FORCE_AXES
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box

LEGS = ("FR", "FL", "RR", "RL")
GROUPS = ("hip", "thigh", "calf")
JOINT_COLUMNS = tuple(f"{leg}_{group}" for group in GROUPS for leg in LEGS)
"""Joint by joint, each in the order of the legs: the column order of the joint files."""

COLUMNS_OF_FILE = {
    "pos": (46, None),
    "joint_act": (24, None),
    "joint_des": (24, None),
    "torque": (40, None),
    "data_f": (15, None),
    "data_pd": (4, None),
    "data_fmpc_pd": (15, ","),
}
"""Least number of columns of each file that is read, and what separates them (None: white space)."""

FRONT_THIGH_AT_ROW_790 = {  # commanded, rad; grows with the distance: tells the target, which was not logged
    0.70: 0.0053,
    0.60: 0.5552,
    0.50: 1.0729,
    0.40: 1.1258,
    0.30: 1.2679,
}


@dataclass(frozen=True)
class PublishedOptions:
    """What the published files do not say themselves."""

    sample_period_s: float = 0.001  # Claimed by the source; whether it is true is for the diagnosis to say
    kp: float = 300.0
    kd: float = 3.0
    landing_row: int = 1100  # First row of the landing sequence, which has other gains on the front legs
    landing_front_kp: float = 80.0
    landing_front_kd: float = 1.0
    block_length_m: float = 0.2
    block_width_m: float = 0.5
    least_block_height_m: float = 0.005  # Front feet this much above the rear ones at the start stand on a block


class PublishedA1(LogFormat):
    """The published jumps, a folder of text files each."""

    name = "published"
    Options = PublishedOptions

    def find(self, source: Path) -> dict[str, Path]:
        """Folders below ``source`` that hold a jump, by name: ``jump_07`` for ``…/7``."""
        folders = sorted(
            {path.parent for path in source.rglob("joint_act.txt")} | {path.parent for path in source.rglob("pos.txt")}
        )
        named: dict[str, Path] = {}
        for folder in folders:
            number = folder.name
            name = f"jump_{int(number):02d}" if number.isdecimal() else f"jump_{number}"
            if name in named:
                raise InputError(source, f"two folders named {number}", "one folder a jump", "rename or remove one")
            named[name] = folder
        return dict(sorted(named.items()))

    def read(self, path: Path, name: str, robot: Robot, options: PublishedOptions) -> Log:
        """One published jump as a log; ``InputError`` names the file and what is wrong with it."""
        from scipy.spatial.transform import Rotation  # many processes know this format and read no file of it

        files = read_tables(path)
        body, forces = files["pos"], files["data_f"]
        rotation = Rotation.from_euler("ZYX", body[:, [8, 7, 6]])
        columns = {"time": np.arange(len(body)) * options.sample_period_s}
        columns |= named(BASE_POSITION, body[:, 3:6])
        columns |= named(BASE_QUATERNION, rotation.as_quat(canonical=False, scalar_first=True))
        columns |= named(BASE_VELOCITY, body[:, 0:3])
        columns["base_angvel_y"] = forces[:, 5]  # the only component of the gyro that was logged
        columns |= joint_columns(files, options)
        in_contact = body[:, 37:41] > 0  # an estimate: 0 or 0.5
        columns |= named([f"contact/{leg}" for leg in LEGS], in_contact.astype(float))
        columns |= named([f"foot_force/{leg}" for leg in LEGS], body[:, 41:45])
        columns |= named([f"mpc_force/{axis}" for axis in PAIR_FORCE_AXES], forces[:, 11:15])
        columns |= named([f"pd_force/{axis}" for axis in PAIR_FORCE_AXES], files["data_pd"][:, :4])
        columns |= named([f"train_force/{axis}" for axis in PAIR_FORCE_AXES], files["data_fmpc_pd"][:, 11:15])
        return Log(
            name,
            {key: np.ascontiguousarray(value) for key, value in columns.items()},
            jump_info(
                robot=robot.name,
                sample_period_s=options.sample_period_s,
                schedule=ContactSchedule(double_contact_s=0.5, rear_contact_s=0.3, flight_s=0.4),
                target=Target(x_m=commanded_distance(files["joint_des"])),
                source=f"published A1 jump {path.name}",
                terrain=block_under_higher_feet(columns, robot, options),
            ),
        )


def read_tables(folder: Path) -> dict[str, np.ndarray]:
    """The tables of one jump by the stem of their files, all with as many rows."""
    tables = {stem: read_table(folder / f"{stem}.txt", *shape) for stem, shape in COLUMNS_OF_FILE.items()}
    rows = len(tables["pos"])
    for stem, table in tables.items():
        if len(table) != rows:
            where = folder / f"{stem}.txt"
            raise InputError(where, f"{len(table)} rows", f"{rows}, as in pos.txt", "copy the jump again")
    return tables


def named(names: list[str] | tuple[str, ...], values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a table under their names."""
    return {name: values[:, i] for i, name in enumerate(names)}


def joint_columns(files: dict[str, np.ndarray], options: PublishedOptions) -> dict[str, np.ndarray]:
    """Measured and commanded joint columns, in the order of the legs, with the gains of every row."""
    rows = len(files["joint_act"])
    landing = np.arange(rows) >= options.landing_row
    columns: dict[str, np.ndarray] = {}
    for leg in LEGS:
        for group in GROUPS:
            joint = f"{leg}_{group}"
            at = JOINT_COLUMNS.index(joint)
            soft = landing & leg.startswith("F")
            columns[f"joint_pos/{joint}"] = files["joint_act"][:, at]
            columns[f"joint_vel/{joint}"] = files["joint_act"][:, 12 + at]
            columns[f"cmd_tau/{joint}"] = files["torque"][:, 20 + at]
            columns[f"cmd_pos/{joint}"] = files["joint_des"][:, at]
            columns[f"cmd_vel/{joint}"] = files["joint_des"][:, 12 + at]
            columns[f"cmd_kp/{joint}"] = np.where(soft, options.landing_front_kp, options.kp)
            columns[f"cmd_kd/{joint}"] = np.where(soft, options.landing_front_kd, options.kd)
    return columns


def commanded_distance(joint_commands: np.ndarray) -> float:
    """Distance of the jump, m to the centimetre, from the commanded front thigh shortly before take-off."""
    distances = np.array(list(FRONT_THIGH_AT_ROW_790))
    angles = np.array(list(FRONT_THIGH_AT_ROW_790.values()))
    row = min(790, len(joint_commands) - 1)
    return round(float(np.interp(joint_commands[row, JOINT_COLUMNS.index("FR_thigh")], angles, distances)), 2)


def block_under_higher_feet(columns: dict[str, np.ndarray], robot: Robot, options: PublishedOptions) -> tuple[Box, ...]:
    """The block that the front or the rear feet stand on at the start, by the pose; empty on flat ground.

    Its upper face is as much higher as these feet are than the others, which stand on the floor.
    """
    position = np.stack([columns[key][:1] for key in BASE_POSITION], axis=-1)
    quaternion = np.stack([columns[key][:1] for key in BASE_QUATERNION], axis=-1)
    joints = np.stack([columns[f"joint_pos/{joint}"][:1] for joint in robot.joints], axis=-1)
    feet = feet_in_world(robot, position, quaternion, joints)[0]
    soles = feet[:, 2] - robot.foot_radius
    front, rear = ([robot.feet.index(foot) for foot in robot.feet_of_pair(pair)] for pair in ("front", "rear"))
    height = float(soles[front].mean() - soles[rear].mean())
    if abs(height) < options.least_block_height_m:
        return ()
    x, y = feet[front if height > 0 else rear, :2].mean(axis=0)
    top = round(abs(height), 4)
    size = (options.block_length_m, options.block_width_m, top)
    return (Box(round(float(x), 4), round(float(y), 4), size, top, estimated=True),)


def read_table(path: Path, columns: int, separator: str | None) -> np.ndarray:
    """A whole text table with at least ``columns`` columns, shape (rows, ≥ columns)."""
    if not path.is_file():
        raise InputError(path, "no such file", "a table of the published layout", "copy the jump's folder whole")
    try:
        table = np.loadtxt(path, delimiter=separator, ndmin=2)
    except ValueError as error:
        raise InputError(path, f"no whole table ({error})", "numbers, as many in every row", "copy it again") from None
    if table.shape[1] < columns or not len(table):
        found = f"{table.shape[0]} rows × {table.shape[1]} columns"
        raise InputError(path, found, f"{columns} columns or more", "check that it is the file of the published layout")
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        says = f"{len(bad)} values that are no number, first in row {bad[0][0]}, column {bad[0][1]}"
        raise InputError(path, says, "finite numbers", "repair the log, or leave this jump out")
    return table
