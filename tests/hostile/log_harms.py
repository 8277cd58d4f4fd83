"""What may be wrong with a log: small functions that harm its columns, its file, or its metadata."""

import io
import json
import os
import shutil
import socket
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.hostile.base_logs import Columns, Format, write_own

Harm = Callable[[Columns, np.random.Generator], Columns]
FileHarm = Callable[[Path, np.random.Generator], None]
DEGREES = 180 / np.pi


def chosen(columns: Columns, rng: np.random.Generator, *starts: str) -> str:
    """One column whose name begins so; any but the time where no name begins so."""
    names = [name for name in columns if name.startswith(starts or ("",)) and name != "time"]
    return str(rng.choice(names or [name for name in columns if name != "time"]))


def with_value(columns: Columns, name: str, row: int, value: float) -> Columns:
    """The columns with another value in one row."""
    values = columns[name].copy()
    values[row] = value
    return columns | {name: values}


def one_value(*values: float) -> Harm:
    """One value of one column is one of these."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng)
        return with_value(columns, name, int(rng.integers(len(columns[name]))), float(rng.choice(values)))

    return harm


def whole_column(change: Callable[[np.ndarray], np.ndarray], *starts: str) -> Harm:
    """One column is changed in all rows."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng, *starts)
        return columns | {name: change(columns[name])}

    return harm


def all_columns(change: Callable[[np.ndarray], np.ndarray], *starts: str) -> Harm:
    """All columns whose names begin so are changed in all rows."""

    def harm(columns: Columns, _: np.random.Generator) -> Columns:
        return {name: change(values) if name.startswith(starts) else values for name, values in columns.items()}

    return harm


def rows_taken(choose: Callable[[int, np.random.Generator], np.ndarray], renumber: bool = False) -> Harm:
    """Some rows in some order; with ``renumber`` the time is as if nothing had happened."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        rows = choose(len(columns["time"]), rng)
        taken = {name: values[rows] for name, values in columns.items()}
        step = columns["time"][1] - columns["time"][0]
        return taken | ({"time": step * np.arange(len(rows))} if renumber else {})

    return harm


def lost_block(rows: int, rng: np.random.Generator) -> np.ndarray:
    """All rows but a block of an eighth."""
    begin = int(rng.integers(rows // 4, rows // 2))
    return np.delete(np.arange(rows), slice(begin, begin + rows // 8))


def lost_rows(rows: int, rng: np.random.Generator) -> np.ndarray:
    """Nine of ten rows, in order."""
    return np.sort(rng.permutation(rows)[: 9 * rows // 10])


def spike(size: float, *starts: str) -> Harm:
    """One row of one column leaves its course by a multiple of the column's range."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        name = chosen(columns, rng, *starts)
        row = int(rng.integers(5, len(columns[name]) - 5))
        high = size * max(float(np.ptp(columns[name])), 1.0)
        return with_value(columns, name, row, columns[name][row] + float(rng.choice([-1, 1])) * high)

    return harm


def exchanged(*places: tuple[str, int]) -> Harm:
    """Two columns, each by its quantity and the number of its joint, stand in each other's place."""

    def harm(columns: Columns, _: np.random.Generator) -> Columns:
        first, second = ([c for c in columns if c.startswith(f"{name}/")][number] for name, number in places)
        return columns | {first: columns[second], second: columns[first]}

    return harm


def without(columns: Columns, *starts: str) -> Columns:
    """The columns but those whose names begin so."""
    return {name: values for name, values in columns.items() if not name.startswith(starts)}


def removed(*starts: str) -> Harm:
    """Columns are missing."""
    return lambda columns, _: without(columns, *starts)


def quaternion(order: str) -> Harm:
    """The components of the attitude stand in another order; without a base the joints do."""

    def harm(columns: Columns, rng: np.random.Generator) -> Columns:
        if "base_quat_w" not in columns:
            return exchanged(("joint_pos", 0), ("joint_pos", 1))(columns, rng)
        return columns | {f"base_quat_{a}": columns[f"base_quat_{b}"] for a, b in zip("wxyz", order, strict=True)}

    return harm


def stuck(columns: Columns, rng: np.random.Generator) -> Columns:
    """A sensor of position and velocity of a joint repeats its first value."""
    name = chosen(columns, rng, "joint_pos/")
    of = name.removeprefix("joint_pos/")
    return columns | {
        name: np.full_like(columns[name], columns[name][0]),
        f"joint_vel/{of}": np.zeros(len(columns[name])),
    }


def extra(name: str) -> Harm:
    """A column more, of any name."""
    return lambda columns, rng: columns | {name: rng.standard_normal(len(columns["time"]))}


def extra_text(columns: Columns, _: np.random.Generator) -> Columns:
    """A column of texts more."""
    return columns | {"remark": np.array(["so"] * len(columns["time"]), dtype=object)}


def renamed(columns: Columns, _: np.random.Generator) -> Columns:
    """The first joint has a name in another script."""
    name = next(one for one in columns if one.startswith("joint_pos/")).removeprefix("joint_pos/")
    return {key.replace(f"/{name}", "/колено\u202e"): values for key, values in columns.items()}


def as_texts(columns: Columns, rng: np.random.Generator) -> Columns:
    """Numbers of one column are texts."""
    name = chosen(columns, rng, "joint_pos/")
    return columns | {name: np.array([f"{value:.17g}" for value in columns[name]], dtype=object)}


def words(columns: Columns, rng: np.random.Generator) -> Columns:
    """One column has a word in one row."""
    name = chosen(columns, rng, "joint_pos/")
    texts = np.array([f"{value:.9g}" for value in columns[name]], dtype=object)
    texts[int(rng.integers(len(texts)))] = "broken"
    return columns | {name: texts}


def time_of(change: Callable[[np.ndarray], np.ndarray]) -> Harm:
    """The time is another."""
    return lambda columns, _: columns | {"time": change(columns["time"])}


def backwards(time: np.ndarray) -> np.ndarray:
    """Time that runs back."""
    return time[::-1].copy()


def leap_back(time: np.ndarray) -> np.ndarray:
    """Time that leaps back in the middle."""
    return np.where(np.arange(len(time)) > len(time) // 2, time - time[len(time) // 2], time)


HARMS: Mapping[str, Harm] = {
    "nan": one_value(np.nan),
    "inf": one_value(np.inf, -np.inf),
    "huge": one_value(1e9, -1e9, 1e12, 1e38, 1e300, -1e300),
    "nan_column": whole_column(lambda values: np.full_like(values, np.nan)),
    "huge_column": whole_column(lambda values: values * 1e9 + 1e9),
    "negative_gain": all_columns(np.negative, "cmd_kp", "cmd_kd", "joint_vel/"),
    "degrees_positions": all_columns(lambda values: values * DEGREES, "joint_pos/"),
    "degrees_velocities": all_columns(lambda values: values * DEGREES, "joint_vel/"),
    "degrees_set_points": all_columns(lambda values: values * DEGREES, "cmd_pos/"),
    "degrees_one_joint": whole_column(lambda values: values * DEGREES, "joint_pos/"),
    "degrees_all": all_columns(lambda values: values * DEGREES, "joint_pos/", "joint_vel/", "cmd_pos/", "cmd_vel/"),
    "turns": all_columns(lambda values: values / (2 * np.pi), "joint_pos/"),
    "millimetres": all_columns(lambda values: values * 1e3, "base_pos", "joint_pos"),
    "gyro_degrees": all_columns(lambda values: values * DEGREES, "base_angvel", "joint_vel"),
    "torque_units": all_columns(lambda values: values * 1e3, "tau/", "cmd_tau/"),
    "xyzw": quaternion("xyzw"),
    "zyxw": quaternion("zyxw"),
    "quaternion_doubled": all_columns(lambda values: values * 2, "base_quat", "joint_vel"),
    "quaternion_zero": all_columns(np.zeros_like, "base_quat", "joint_vel"),
    "other_sign": all_columns(np.negative, "joint_vel/"),
    "rows_twice": rows_taken(lambda rows, _: np.repeat(np.arange(rows), 2)),
    "rows_twice_renumbered": rows_taken(lambda rows, _: np.repeat(np.arange(rows), 2), renumber=True),
    "rows_lost": rows_taken(lost_block),
    "rows_lost_here_and_there": rows_taken(lost_rows),
    "rows_lost_renumbered": rows_taken(lost_block, renumber=True),
    "every_third_row_renumbered": rows_taken(lambda rows, _: np.arange(0, rows, 3), renumber=True),
    "rows_shuffled": rows_taken(lambda rows, rng: rng.permutation(rows)),
    "rows_shuffled_renumbered": rows_taken(lambda rows, rng: rng.permutation(rows), renumber=True),
    "rows_reversed_renumbered": rows_taken(lambda rows, _: np.arange(rows)[::-1], renumber=True),
    "one_row": rows_taken(lambda rows, _: np.arange(1)),
    "no_row": rows_taken(lambda rows, _: np.arange(0)),
    "milliseconds": time_of(lambda time: time * 1e3),
    "nanoseconds": time_of(lambda time: time * 1e9),
    "kiloseconds": time_of(lambda time: time * 1e-3),
    "time_back": time_of(backwards),
    "time_leaps_back": time_of(leap_back),
    "time_stands": time_of(np.zeros_like),
    "time_nan": time_of(lambda time: np.where(time > 0.5, np.nan, time)),
    "half_speed": time_of(lambda time: time * 2),
    "spike": spike(3.0, "joint_pos/", "joint_vel/", "base_"),
    "small_spike": spike(0.3, "joint_pos/"),
    "spike_sent": spike(3.0, "cmd_"),
    "joints_exchanged": exchanged(("joint_pos", 0), ("joint_pos", 1)),
    "position_is_velocity": exchanged(("joint_pos", 0), ("joint_vel", 0)),
    "stuck": stuck,
    "positions_stand": all_columns(lambda values: np.full_like(values, values[0]), "joint_pos/"),
    "whole_numbers": all_columns(np.round, "joint_pos/"),
    "int8": all_columns(lambda values: values.astype(np.int8), "joint_"),
    "float32": all_columns(lambda values: values.astype(np.float32), "joint_", "cmd_", "base_"),
    "truth_values": all_columns(lambda values: values > 0, "joint_pos/"),
    "other_byte_order": whole_column(lambda values: values.byteswap(), "joint_", "base_"),
    "no_time": removed("time"),
    "no_gains": removed("cmd_kp"),
    "no_commands": removed("cmd_"),
    "no_positions": removed("joint_pos"),
    "no_velocities": removed("joint_vel"),
    "one_joint": removed("joint_pos/hip", "cmd_kp/hip", "joint_pos/FR_hip"),
    "part_of_a_quaternion": removed("base_quat_x", "cmd_vel/knee"),
    "more_columns": extra("temperature"),
    "unicode_column": extra("\u202eтемпература/\N{PILE OF POO}\n"),
    "html_column": extra("<script>alert(1)</script>"),
    "long_name": extra("x" * 5000),
    "text_column": extra_text,
    "unicode_joint": renamed,
    "texts": as_texts,
    "words": words,
    "complex": whole_column(lambda values: values + 1j, "joint_pos/"),
    "dates": whole_column(lambda values: (values * 1e9).astype("M8[ns]"), "joint_pos/"),
}
"""Harms to the columns, before the file is written."""


def main_file(path: Path, rng: np.random.Generator) -> Path:
    """The file itself, or one of the files of a log that is a folder."""
    files = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
    return files[int(rng.integers(len(files)))]


def truncated(path: Path, rng: np.random.Generator) -> None:
    """The file ends early."""
    data = path.read_bytes()
    path.write_bytes(data[: int(rng.integers(1, max(2, len(data))))])


def bits_flipped(number: int) -> FileHarm:
    """Some bits of the file are others."""

    def harm(path: Path, rng: np.random.Generator) -> None:
        data = bytearray(path.read_bytes())
        for _ in range(number):
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(data))

    return harm


def block(fill: bytes | None) -> FileHarm:
    """A block of the file is filled with a byte, or with random ones."""

    def harm(path: Path, rng: np.random.Generator) -> None:
        data = bytearray(path.read_bytes())
        length = int(rng.integers(1, max(2, len(data) // 8)))
        begin = int(rng.integers(max(1, len(data) - length)))
        data[begin : begin + length] = fill * length if fill else rng.bytes(length)
        path.write_bytes(bytes(data))

    return harm


def replaced_by(make: Callable[[Path], Any]) -> FileHarm:
    """Something else stands in the file's place."""

    def harm(path: Path, _: np.random.Generator) -> None:
        path.unlink()
        make(path)

    return harm


def bind_socket(path: Path) -> None:
    """A socket."""
    there, short = Path.cwd(), path.name
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(short)
    finally:
        os.chdir(there)


FILE_HARMS: Mapping[str, FileHarm] = {
    "truncated": truncated,
    "one_bit": bits_flipped(1),
    "ten_bits": bits_flipped(10),
    "thousand_bits": bits_flipped(1000),
    "zeros": block(b"\0"),
    "noise": block(None),
    "empty": lambda path, _: path.write_bytes(b"") and None,
    "garbage": lambda path, rng: path.write_bytes(rng.bytes(5000)) and None,
    "text": lambda path, _: path.write_text("nothing of the kind\n") and None,
    "longer": lambda path, rng: path.write_bytes(path.read_bytes() + rng.bytes(300)) and None,
    "twice": lambda path, _: path.write_bytes(path.read_bytes() * 2) and None,
    "folder": replaced_by(lambda path: path.mkdir()),
    "pipe": replaced_by(os.mkfifo),
    "socket": replaced_by(bind_socket),
    "endless_device": replaced_by(lambda path: path.symlink_to("/dev/zero")),
    "dangling_link": replaced_by(lambda path: path.symlink_to("/nowhere/at/all")),
    "link_to_itself": replaced_by(lambda path: path.symlink_to(path.name)),
}
"""Harms to a file after it was written."""

DEEP = '{"robot": ' + "[" * 100_000 + "]" * 100_000 + "}"
JUMP = {"format_version": 1, "terrain": [], "target": {"x_m": 0.6, "z_m": 0.0}}
METADATA: Mapping[str, Any] = {
    "deep": DEEP,
    "no_json": "{",
    "a_list": "[1, 2]",
    "a_number": "7",
    "huge_text": json.dumps({"source": "x" * 2_000_000}),
    "period_true": {"sample_period_s": True},
    "period_text": {"sample_period_s": "0.01"},
    "period_negative": {"sample_period_s": -0.01},
    "period_zero": {"sample_period_s": 0},
    "period_huge": {"sample_period_s": 1e300},
    "period_nan": {"sample_period_s": float("nan")},
    "period_list": {"sample_period_s": [0.01]},
    "period_digits": '{"format_version": 2, "robot": "hopper", "sample_period_s": ' + "9" * 5000 + "}",
    "robot_other": {"robot": "go1"},
    "robot_number": {"robot": 5},
    "robot_null": {"robot": None},
    "robot_long": {"robot": "a" * 100_000},
    "source_object": {"source": {"a": 1}},
    "version_new": {"format_version": 99},
    "version_text": {"format_version": "two"},
    "terrain_nan": {"terrain": [{"x_m": float("nan"), "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}]},
    "terrain_text": {"terrain": "stairs"},
    "terrain_far": {"terrain": [{"x_m": 1e300, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}]},
    "terrain_negative": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [-1, 1, 1], "top_m": 0}]},
    "terrain_flat_size": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": 3, "top_m": 0}]},
    "terrain_many": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}] * 100_000},
    "terrain_estimated": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0, "estimated": "maybe"}]},
    "target_text": JUMP
    | {"schedule": {"double_contact_s": 0.4, "rear_contact_s": 0.3, "flight_s": 0.4}, "target": "far"},
    "target_nan": {"target": {"x_m": float("nan"), "z_m": 0}},
    "schedule_text": {"schedule": "soon", "target": {"x_m": 0.6, "z_m": 0}},
    "schedule_texts": {"schedule": {"double_contact_s": "0.4", "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_nan": {"schedule": {"double_contact_s": float("nan"), "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_negative": {"schedule": {"double_contact_s": -3, "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_part": {"schedule": {"double_contact_s": 0.4}},
    "segments_text": {"segments": "all"},
    "segments_backwards": {"segments": [{"name": "a", "begin_s": 1.0, "end_s": 0.5}]},
    "segments_nan": {"segments": [{"name": "a", "begin_s": float("nan"), "end_s": 0.5}]},
    "segments_nameless": {"segments": [{"begin_s": 0, "end_s": 0.5}]},
    "segments_true": {"segments": [{"name": True, "begin_s": 0, "end_s": 0.5}]},
    "derived_list": {"derived": ["all"]},
    "derived_number": {"derived": {"time": 3}},
}
"""Changes to the metadata of a log of ours, or their whole text."""


def write_with_metadata(name: str, columns: Columns, path: Path) -> None:
    """A log of ours with other metadata."""
    write_own(columns, path, METADATA[name])


def npz_claims(path: Path, shape: tuple[int, ...], dtype: str = "<f8") -> None:
    """An archive one of whose arrays states a shape that its bytes do not have."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as folder:
        folder.writestr("time.npy", header.getvalue() + bytes(1000))


def npz_zeros(path: Path) -> None:
    """A megabyte that unpacks to six gigabytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as folder:
        for name in ("time", "joint_pos/hip", "joint_pos/knee"):
            header = io.BytesIO()
            shape = {"descr": "<f8", "fortran_order": False, "shape": (250_000_000,)}
            np.lib.format.write_array_header_1_0(header, shape)
            with folder.open(f"{name}.npy", "w", force_zip64=True) as member:
                member.write(header.getvalue())
                member.write(bytes(10_000_000))


def npz_objects(path: Path) -> None:
    """An archive with a pickle in it."""
    np.savez(path, time=np.array([print, 1], dtype=object))


def hdf5_empty_giant(path: Path) -> None:
    """A small file that states a data set of 8 TB."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("time", shape=(10**12,), chunks=(10**6,), dtype="f8", fillvalue=1.0)


def hdf5_deep(path: Path) -> None:
    """Two thousand groups in each other."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file
        for _ in range(2000):
            group = group.create_group("g")
        group["time"] = np.arange(5.0)


def hdf5_loop(path: Path) -> None:
    """A group that holds itself, and links to other files."""
    import h5py

    with h5py.File(path, "w") as file:
        file["a/b"] = np.arange(5.0)
        file["a/again"] = file["a"]
        file["time"] = h5py.ExternalLink("/etc/passwd", "x")
        file["soft"] = h5py.SoftLink("/nowhere")


def parquet_giant(path: Path) -> None:
    """A file of some kilobytes that states 10⁹ values in its columns."""
    column = pa.chunked_array([pa.array(np.zeros(1_000_000))] * 20)
    names = ["time", *(f"cmd_tau/{i}" for i in range(29))]
    schema = pa.schema([(name, pa.float64()) for name in names], metadata={b"leapgap": b"{}"})
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        writer.write_table(pa.table([column] * 30, schema=schema))


def parquet_lists(path: Path) -> None:
    """Columns of lists, structures and dictionaries where numbers belong."""
    table = pa.table({"time": [[1.0], [2.0]], "joint_pos/hip": [{"a": 1}, {"a": 2}]})
    pq.write_table(table.replace_schema_metadata({b"leapgap": b"{}"}), path)


def parquet_columns(path: Path) -> None:
    """Write a log with the commands of five thousand joints, each as short as can be."""
    table = pa.table({"time": [0.0, 1.0]} | {f"cmd_tau/{i}": [0.0, 0.0] for i in range(5000)})
    pq.write_table(table.replace_schema_metadata({b"leapgap": b"{}"}), path)


def csv_wide(path: Path) -> None:
    """A header of a hundred thousand names."""
    names = ",".join(f"c{i}" for i in range(100_000))
    path.write_text(f"{names}\n1\n")


def csv_quotes(path: Path) -> None:
    """A quote that never ends."""
    path.write_text('time,joint_pos/hip\n0,"' + "1\n" * 200_000)


def csv_mixed(path: Path) -> None:
    """Rows of other lengths, NUL bytes and another encoding."""
    path.write_bytes(b"time,a\n0,1,2\n\0\0,3\n\xff\xfe,\xe9\n")


def csv_numbers(path: Path) -> None:
    """Numbers beyond all floats, and words that Python takes for numbers."""
    path.write_text("time,cmd_tau/hip\n0,1e999\n0.1,infinity\n0.2,1_000\n")


def mat_claims(path: Path) -> None:
    """A MATLAB file whose only variable states 4 GB."""
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + (14).to_bytes(4, "little") + b"\xff" * 4)


def mat_zip_bomb(path: Path) -> None:
    """A compressed variable that states a gigabyte in a few bytes."""
    import zlib

    inner = (14).to_bytes(4, "little") + (1 << 30).to_bytes(4, "little") + bytes(1_000_000)
    data = zlib.compress(inner)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    path.write_bytes(head + (15).to_bytes(4, "little") + len(data).to_bytes(4, "little") + data)


def mat_old(path: Path) -> None:
    """A file of version 4 that states more columns than it holds."""
    numbers = np.array([0, 1_000_000, 100_000, 0, 5], dtype="<i4")
    path.write_bytes(numbers.tobytes() + b"time\0" + bytes(100))


def zip_with_pickle(pickle: bytes) -> Callable[[Path], None]:
    """A file of ``torch.save`` with another pickle."""

    def make(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as folder:
            folder.writestr("archive/data.pkl", pickle)
            folder.writestr("archive/data/0", bytes(16))

    return make


TENSOR = b"ctorch._utils\n_rebuild_tensor_v2\n((S'storage'\nctorch\nDoubleStorage\nS'0'\nS'cpu'\nI2\ntQ"
PICKLES: Mapping[str, bytes] = {
    "system": b"cos\nsystem\n(S'touch /tmp/leapgap_was_here'\ntR.",
    "eval": b"cbuiltins\neval\n(S'1+1'\ntR.",
    "giant_view": b"(dS'time'\n" + TENSOR + b"I0\n(I1000000\nI1000000\nt(I0\nI0\nttRs.",
    "endless_frames": b"\x80\x04" + b"(" * 2_000_000 + b".",
    "deep_lists": b"(" * 5000 + b"l" * 5000 + b".",
    "memo_bomb": b"(lp0\n" + b"".join(b"(g%d\ng%d\nlp%d\n" % (i, i, i + 1) for i in range(60)) + b".",
    "huge_string": b"\x8d" + (1 << 40).to_bytes(8, "little") + b"x.",
    "wrong_state": b"ccollections\nOrderedDict\n(tRI5\nb.",
    "nothing": b"",
}


def ros_garbage(path: Path) -> None:
    """A bag whose header is right and whose rest is not."""
    path.write_bytes(b"#ROSBAG V2.0\n" + b"\xff" * 5000)


def ros_claims(path: Path) -> None:
    """A bag whose first record states four gigabytes."""
    path.write_bytes(b"#ROSBAG V2.0\n" + b"\xff\xff\xff\xff" + b"op=\x03" + bytes(50))


def lerobot_info(text: str) -> Callable[[Path], None]:
    """A dataset with other information about itself."""

    def make(path: Path) -> None:
        (path / "meta").mkdir(parents=True)
        (path / "meta" / "info.json").write_text(text)

    return make


def published_missing(path: Path) -> None:
    """A folder of the published layout with most files missing."""
    path.mkdir()
    (path / "pos.txt").write_text("1 2 3\n")


def published_wide(path: Path) -> None:
    """A table with one row of a hundred thousand columns beside rows of one."""
    path.mkdir()
    (path / "pos.txt").write_text("1 " * 100_000 + "\n1\n")


SPECIALS: Mapping[str, tuple[str, Callable[[Path], None]]] = {
    "npz_10e12": ("npz", lambda path: npz_claims(path, (10**12,))),
    "npz_negative": ("npz", lambda path: npz_claims(path, (-5,))),
    "npz_product": ("npz", lambda path: npz_claims(path, (10**6, 10**6, 10**6))),
    "npz_strings": ("npz", lambda path: npz_claims(path, (100,), "|S2000000000")),
    "npz_zeros": ("npz", npz_zeros),
    "npz_objects": ("npz", npz_objects),
    "hdf5_empty_giant": ("hdf5", hdf5_empty_giant),
    "hdf5_deep": ("hdf5", hdf5_deep),
    "hdf5_loop": ("hdf5", hdf5_loop),
    "own_giant": ("own", parquet_giant),
    "own_lists": ("own", parquet_lists),
    "own_columns": ("own", parquet_columns),
    "parquet_giant": ("parquet", parquet_giant),
    "parquet_lists": ("parquet", parquet_lists),
    "csv_wide": ("csv", csv_wide),
    "csv_quotes": ("csv", csv_quotes),
    "csv_mixed": ("csv", csv_mixed),
    "csv_numbers": ("csv", csv_numbers),
    "mat_claims": ("mat", mat_claims),
    "mat_zip_bomb": ("mat", mat_zip_bomb),
    "mat_old": ("mat", mat_old),
    **{f"pt_{name}": ("pt", zip_with_pickle(pickle)) for name, pickle in PICKLES.items()},
    "ros_garbage": ("ros", ros_garbage),
    "ros_claims": ("ros", ros_claims),
    "lerobot_deep": ("lerobot", lerobot_info(DEEP)),
    "lerobot_list": ("lerobot", lerobot_info("[]")),
    "lerobot_no_data": ("lerobot", lerobot_info('{"codebase_version": "v3.0", "features": {}}')),
    "lerobot_null": ("lerobot", lerobot_info('{"codebase_version": null, "features": null}')),
    "published_missing": ("published", published_missing),
    "published_wide": ("published", published_wide),
}
"""Files that are made to harm, by the format they pretend to be."""


def write_case(layout: Format, harm: str, name: str, path: Path, rng: np.random.Generator, log: int) -> Columns:
    """Write one harmed log; the columns that it would have had."""
    columns = layout.log(log)
    if harm == "special":
        SPECIALS[name][1](path)
    elif harm == "metadata":
        write_with_metadata(name, columns, path)
    elif harm == "columns":
        layout.write(HARMS[name](columns, rng), path)
    else:
        layout.write(columns, path)
        FILE_HARMS[name](main_file(path, rng), rng)
    return columns


def clear(path: Path) -> None:
    """Remove what a case left, whatever it is."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.is_symlink() or path.exists():
        path.unlink()
