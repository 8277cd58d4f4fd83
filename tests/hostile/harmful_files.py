"""Files that are made to harm whoever reads them, by the format that they pretend to be."""

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.hostile.metadata_harms import DEEP
from tests.hostile.packed_bombs import BOMBS


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
    **BOMBS,
}
"""Files that are made to harm, by the format they pretend to be."""
