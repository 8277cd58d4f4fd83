"""Small whole logs made by hand, in every format that is read: what the hostile cases corrupt.

Motions are sums of sines, so that velocities, attitudes and torques are known exactly. Nothing here is written or
computed by the code under test.
"""

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

Columns = dict[str, np.ndarray]
ROWS, PERIOD_S = 160, 0.01
JOINTS = ("hip", "knee")
KP, KD = 40.0, 1.5
LEGS, GROUPS = ("FR", "FL", "RR", "RL"), ("hip", "thigh", "calf")
A1_JOINTS = tuple(f"{leg}_{group}" for leg in LEGS for group in GROUPS)
ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="hip" axis="0 1 0" range="-3 3" limited="true"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>
<body name="lower" pos="0 0 -.3"><joint name="knee" axis="0 1 0" range="-3 3" limited="true"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/></body></body></worldbody>
<actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>"""
HOPPER = """<mujoco model="hopper"><compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 .6"><freejoint/><geom type="box" size=".15 .1 .05" mass="5"/>
<body name="thigh"><joint name="hip" axis="0 1 0"/><geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/>
<body name="shank" pos="0 0 -.3"><joint name="knee" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.28"/><geom name="foot" type="sphere" size=".02" pos="0 0 -.3"/>
</body></body></body></worldbody><actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>"""


class Sines:
    """A sum of two sines of one number and time, with its derivative; slow enough for ten rows to a swing."""

    def __init__(self, rng: np.random.Generator, size: float, middle: float = 0.0, hertz: float = 1.0) -> None:
        self.size, self.middle = size * rng.uniform(0.5, 1.0, 2), middle
        self.rate, self.phase = 2 * np.pi * hertz * rng.uniform(0.6, 1.8, 2), rng.uniform(0, 6, 2)

    def value(self, time: np.ndarray) -> np.ndarray:
        """The sum at some times."""
        return self.middle + (self.size * np.sin(np.outer(time, self.rate) + self.phase)).sum(axis=1)

    def slope(self, time: np.ndarray) -> np.ndarray:
        """The derivative of the sum by time, at some times."""
        return (self.size * self.rate * np.cos(np.outer(time, self.rate) + self.phase)).sum(axis=1)


def joint_columns(rng: np.random.Generator, time: np.ndarray, joints: tuple[str, ...], hertz: float = 1.0) -> Columns:
    """Measured and commanded columns of joints whose PD is a little behind, with the torque that it sends."""
    columns: Columns = {}
    for joint in joints:
        motion, sent = Sines(rng, 0.4, rng.uniform(-0.5, 0.5), hertz), Sines(rng, 2.0, 0.0, hertz)
        position, velocity = motion.value(time), motion.slope(time)
        measured = position + 1e-4 * rng.standard_normal(len(time))
        speed = velocity + 5e-3 * rng.standard_normal(len(time))
        wanted, rate = motion.value(time + 0.02), motion.slope(time + 0.02)
        torque = sent.value(time) + KP * (wanted - measured) + KD * (rate - speed)
        columns |= {
            f"joint_pos/{joint}": measured,
            f"joint_vel/{joint}": speed,
            f"tau/{joint}": torque + 0.02 * rng.standard_normal(len(time)),
            f"cmd_tau/{joint}": sent.value(time),
            f"cmd_pos/{joint}": wanted,
            f"cmd_vel/{joint}": rate,
            f"cmd_kp/{joint}": np.full(len(time), KP),
            f"cmd_kd/{joint}": np.full(len(time), KD),
        }
    return columns


def base_columns(rng: np.random.Generator, time: np.ndarray, hertz: float = 1.0) -> tuple[Columns, np.ndarray]:
    """Position, attitude and velocities of a trunk that walks ahead and sways; and its roll, pitch, yaw (rows, 3)."""
    place = [Sines(rng, size, middle, hertz) for size, middle in ((0.1, 0.0), (0.1, 0.0), (0.05, 0.6))]
    angle = [Sines(rng, size, 0.0, hertz) for size in (0.25, 0.25, 0.3)]
    ahead = 0.5 * time
    roll, pitch, yaw = (one.value(time) for one in angle)
    rolls, pitches, yaws = (one.slope(time) for one in angle)
    cr, sr, cp, sp, cy, sy = (f(0.5 * one) for one in (roll, pitch, yaw) for f in (np.cos, np.sin))
    axes = tuple(zip("xyz", place, strict=True))
    columns = {f"base_pos_{axis}": one.value(time) + (ahead if axis == "x" else 0) for axis, one in axes}
    columns |= {
        "base_quat_w": cr * cp * cy + sr * sp * sy,
        "base_quat_x": sr * cp * cy - cr * sp * sy,
        "base_quat_y": cr * sp * cy + sr * cp * sy,
        "base_quat_z": cr * cp * sy - sr * sp * cy,
    }
    columns |= {f"base_linvel_{axis}": one.slope(time) + (0.5 if axis == "x" else 0) for axis, one in axes}
    columns |= {
        "base_angvel_x": rolls - yaws * np.sin(pitch),
        "base_angvel_y": pitches * np.cos(roll) + yaws * np.sin(roll) * np.cos(pitch),
        "base_angvel_z": -pitches * np.sin(roll) + yaws * np.cos(roll) * np.cos(pitch),
    }
    return columns, np.stack([roll, pitch, yaw], axis=1)


def arm_log(seed: int) -> Columns:
    """A log of the arm."""
    time = PERIOD_S * np.arange(ROWS)
    return {"time": time} | joint_columns(np.random.default_rng([1, seed]), time, JOINTS)


def hopper_log(seed: int) -> Columns:
    """A log of the hopper, with the state of its base."""
    rng, time = np.random.default_rng([2, seed]), PERIOD_S * np.arange(ROWS)
    return {"time": time} | base_columns(rng, time)[0] | joint_columns(rng, time, JOINTS)


def published_log(seed: int) -> Columns:
    """What a folder of the published layout holds: the columns of the log, and those that only the files have."""
    rng, time = np.random.default_rng([3, seed]), 0.001 * np.arange(300)
    base, angles = base_columns(rng, time, 4.0)
    joints = joint_columns(rng, time, A1_JOINTS, 4.0)
    extra = {f"angle_{i}": angles[:, i] for i in range(3)}
    columns = {"time": time} | base | joints | extra
    for name in [name for name in columns if name.startswith(("cmd_kp", "cmd_kd", "tau/", "base_angvel_x"))]:
        del columns[name]
    return {name: values for name, values in columns.items() if name != "base_angvel_z"}


def header_checksum(text: bytes, names: list[str], rows: int) -> bytes:
    """CRC-32 of the header, as docs/reference/log_format.md defines it."""
    return b"%08x" % zlib.crc32("\0".join(names).encode(), zlib.crc32(str(rows).encode(), zlib.crc32(text)))


def write_own(columns: Columns, path: Path, about: Any = None, checksum: bool = True) -> None:
    """A log of ours by pyarrow alone; ``about`` stands in place of its metadata, as text or as changes to them."""
    robot = "hopper" if "base_pos_x" in columns else "arm"
    stated: dict[str, Any] = {
        "format_version": 2,
        "robot": robot,
        "sample_period_s": PERIOD_S,
        "source": "by hand",
        "terrain": [{"x_m": 1.0, "y_m": 0.0, "size_m": [0.2, 0.5, 0.1], "top_m": 0.1, "estimated": False}],
    }
    text = (about if isinstance(about, str) else json.dumps(stated | (about or {}))).encode()
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    keys = {b"leapgap": text}
    if checksum:
        keys[b"leapgap_crc32"] = header_checksum(text, table.column_names, table.num_rows)
    pq.write_table(table.replace_schema_metadata(keys), path, compression="zstd", write_page_checksum=checksum)


def write_unchecked(columns: Columns, path: Path) -> None:
    """A log of ours as older versions wrote it, without checksums."""
    write_own(columns, path, checksum=False)


def write_csv(columns: Columns, path: Path) -> None:
    """A table of text."""
    pa.csv.write_csv(pa.table({name: pa.array(values) for name, values in columns.items()}), path)


def write_parquet(columns: Columns, path: Path) -> None:
    """A foreign Parquet file."""
    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path, compression="none")


def write_npz(columns: Columns, path: Path) -> None:
    """A NumPy archive."""
    np.savez(path, **columns)


def write_hdf5(columns: Columns, path: Path) -> None:
    """An HDF5 file with a group a quantity."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            if values.dtype.kind not in "OUM":
                file[name] = values
            else:
                file[name] = [str(one) for one in values]


def write_mat(columns: Columns, path: Path) -> None:
    """A MATLAB file of version 5; names have no slash there."""
    from scipy.io import savemat

    savemat(path, {name.replace("/", "_"): values for name, values in columns.items()})


def write_pt(columns: Columns, path: Path) -> None:
    """A file of ``torch.save``."""
    import torch

    numeric = {name: values for name, values in columns.items() if values.dtype.kind in "biuf"}
    texts = {name: list(values) for name, values in columns.items() if values.dtype.kind not in "biuf"}
    torch.save({name: torch.from_numpy(values.copy()) for name, values in numeric.items()} | texts, path)


def write_lerobot(columns: Columns, path: Path) -> None:
    """A dataset of LeRobot with one episode."""
    (path / "meta").mkdir(parents=True)
    (path / "data" / "chunk-000").mkdir(parents=True)
    info = {"codebase_version": "v3.0", "fps": 100, "features": {name: {"names": None} for name in columns}}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    named = {"timestamp" if name == "time" else name: values for name, values in columns.items()}
    if named:
        named["episode_index"] = np.zeros(len(next(iter(named.values()))), dtype=int)
    write_parquet(named, path / "data" / "chunk-000" / "file-000.parquet")


def write_ros(storage: str | None = None) -> Callable[[Columns, Path], None]:
    """A writer of bags of ROS 1, or of recordings of ROS 2 as SQLite or MCAP: joint states, and commands alike."""

    def write(columns: Columns, path: Path) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
        kinds = store.types
        joint_state, stamps = kinds["sensor_msgs/msg/JointState"], kinds["builtin_interfaces/msg/Time"]
        serialize = store.serialize_ros1 if storage is None else store.serialize_cdr
        topics = {"/joint_states": ("joint_pos", "joint_vel", "tau"), "/commands": ("cmd_pos", "cmd_vel", "cmd_tau")}
        whole: Any = rosbag1.Writer(path)
        if storage is not None:
            whole = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
        with whole as bag:
            lanes = {topic: bag.add_connection(topic, joint_state.__msgtype__, typestore=store) for topic in topics}
            for row in range(len(columns["time"])):
                now = float(columns["time"][row])
                stamp = round(now * 1e9) if np.isfinite(now) and abs(now) < 1e9 else 0
                number = [row] if storage is None else []
                header = kinds["std_msgs/msg/Header"](
                    *number, stamps(max(0, stamp) // 10**9, max(0, stamp) % 10**9), ""
                )
                for topic, quantities in topics.items():
                    values = ([float(columns[f"{one}/{joint}"][row]) for joint in JOINTS] for one in quantities)
                    message = joint_state(header, list(JOINTS), *map(np.array, values))
                    bag.write(lanes[topic], 10**18 + stamp, serialize(message, joint_state.__msgtype__))

    return write


def write_published(columns: Columns, path: Path) -> None:
    """A folder of the published layout."""
    path.mkdir(parents=True)
    rows = len(columns["time"])
    order = [f"{leg}_{group}" for group in GROUPS for leg in LEGS]

    def of_joints(quantity: str) -> np.ndarray:
        return np.stack([columns[f"{quantity}/{joint}"] for joint in order], axis=1)

    def of_base(quantity: str) -> np.ndarray:
        return np.stack([columns[f"{quantity}_{axis}"] for axis in "xyz"], axis=1)

    pos, torque, force = np.zeros((rows, 46)), np.zeros((rows, 40)), np.zeros((rows, 15))
    pos[:, 0:3], pos[:, 3:6] = of_base("base_linvel"), of_base("base_pos")
    pos[:, 6:9] = np.stack([columns[f"angle_{i}"] for i in range(3)], axis=1)
    torque[:, 20:32], force[:, 5] = of_joints("cmd_tau"), columns["base_angvel_y"]
    tables = {
        "pos": pos,
        "joint_act": np.hstack([of_joints("joint_pos"), of_joints("joint_vel")]),
        "joint_des": np.hstack([of_joints("cmd_pos"), of_joints("cmd_vel")]),
        "torque": torque,
        "data_f": force,
        "data_pd": np.zeros((rows, 4)),
    }
    for stem, table in tables.items():
        np.savetxt(path / f"{stem}.txt", table, fmt="%.8g")
    np.savetxt(path / "data_fmpc_pd.txt", force, fmt="%.8g", delimiter=",")


@dataclass(frozen=True)
class Format:
    """One format: how a whole log of it is written, and what the importer is told."""

    name: str
    suffix: str
    """Ending of its files; empty where a log is a folder."""
    write: Callable[[Columns, Path], None]
    log: Callable[[int], Columns] = arm_log
    importer: str | None = None
    """Name of the importer; None: a log of ours."""
    options: Mapping[str, Any] = field(default_factory=dict)
    model: str = ARM
    """The model file's text; empty: the A1 that comes with the package."""
    checked: bool = False
    """Whether the file itself carries checksums of all of its data."""


QUANTITIES = ("joint_pos", "joint_vel", "tau", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
ROS_COLUMNS = {
    "joint_pos/*": "/joint_states/position[*]",
    "joint_vel/*": "/joint_states/velocity[*]",
    "tau/*": "/joint_states/effort[*]",
    "cmd_pos/*": "/commands/position[*]",
    "cmd_vel/*": "/commands/velocity[*]",
    "cmd_tau/*": "/commands/effort[*]",
}
ROS_OPTIONS = {"columns": ROS_COLUMNS, "constants": {"cmd_kp/*": KP, "cmd_kd/*": KD}}
FORMATS = (
    Format("own", ".parquet", write_own, hopper_log, model=HOPPER, checked=True),
    Format("own_unchecked", ".parquet", write_unchecked, hopper_log, model=HOPPER),
    Format("csv", ".csv", write_csv, importer="csv"),
    Format("csv_base", ".csv", write_csv, hopper_log, importer="csv", model=HOPPER),
    Format("parquet", ".parquet", write_parquet, importer="parquet"),
    Format("npz", ".npz", write_npz, hopper_log, importer="npz", model=HOPPER, checked=True),
    Format("hdf5", ".h5", write_hdf5, hopper_log, importer="hdf5", model=HOPPER),
    Format("mat", ".mat", write_mat, importer="mat", options={"columns": {f"{q}/*": f"{q}_*" for q in QUANTITIES}}),
    Format("pt", ".pt", write_pt, importer="pt", checked=True),
    *(
        Format(name, suffix, write_ros(storage), importer="ros", options=ROS_OPTIONS)
        for name, suffix, storage in (("ros", ".bag", None), ("mcap", "", "MCAP"), ("sqlite3", "", "SQLITE3"))
    ),
    Format("lerobot", "", write_lerobot, importer="lerobot"),
    Format("published", "", write_published, published_log, importer="published", model=""),
)
"""Every reader, some with two kinds of robot."""
