"""Small files that unpack to gigabytes, whatever they state of that."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

MEGABYTE = 1 << 20


def zeros(megabytes: int, head: bytes = b"", wbits: int = 15) -> bytes:
    """Some bytes and then so many megabytes of zeros, deflated: a block that is written again and again."""
    packer = zlib.compressobj(9, zlib.DEFLATED, wbits)
    begin = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(MEGABYTE)) + packer.flush(zlib.Z_FULL_FLUSH)
    return begin + block * megabytes


def csv_gz(path: Path) -> None:
    """A packed text of 6 GB in 6 MB."""
    path.write_bytes(zeros(6000, b"time,joint_pos/hip\n0,1\n", 31))


def mat_small_head(path: Path) -> None:
    """A compressed variable that states 100 bytes and has 3 GB."""
    data = zeros(3000, struct.pack("<II", 14, 100))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    path.write_bytes(head + struct.pack("<II", 15, len(data)) + data)


def hdf5_piece(path: Path) -> None:
    """A piece of a dataset of 160 numbers that unpacks to 3 GB."""
    import h5py

    with h5py.File(path, "w") as file:
        item = file.create_dataset("time", shape=(160,), chunks=(160,), dtype="f8", compression="gzip")
        item.id.write_direct_chunk((0,), zeros(3000))


def zipped(path: Path, members: Mapping[str, tuple[bytes, int, bytes]]) -> None:
    """A zip of deflated members (name → raw deflate stream, size that is stated, what the checksum is of)."""
    body, index = b"", b""
    for name, (data, size, of) in members.items():
        about = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 0, zlib.crc32(of), len(data), size, len(name), 0)
        index += b"PK\1\2" + struct.pack("<H", 20) + about + struct.pack("<HHHII", 0, 0, 0, 0, len(body))
        index += name.encode()
        body += b"PK\3\4" + about + name.encode() + data
    count = len(members)
    path.write_bytes(body + index + b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, count, count, len(index), len(body), 0))


def npz_header(path: Path) -> None:
    """An array whose header, with its shape and type, has 3 GB."""
    head = b"\x93NUMPY\2\0" + struct.pack("<I", 3_000_000_000)
    zipped(path, {"time.npy": (zeros(3000, head, -15), 3000 * MEGABYTE, b"")})


def deflated(data: bytes) -> tuple[bytes, int, bytes]:
    """A member of a zip that states what it is."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush(), len(data), data


TENSOR = (
    b"ctorch._utils\n_rebuild_tensor_v2\n((S'storage'\nctorch\nDoubleStorage\nS'0'\nS'cpu'\nI2\ntQI0\n(I2\nt(I1\nttR"
)


def pt_storage(path: Path) -> None:
    """A tensor of two numbers whose bytes unpack to 3 GB."""
    pickle = b"(dS'time'\n" + TENSOR + b"s."
    zipped(path, {"a/data.pkl": deflated(pickle), "a/data/0": (zeros(3000, wbits=-15), 16, bytes(16))})


def pt_order(path: Path) -> None:
    """The word that says the order of bytes has 3 GB."""
    pickle = b"(d."
    order = (zeros(3000, wbits=-15), 3000 * MEGABYTE, b"")
    zipped(path, {"a/byteorder": order, "a/data.pkl": deflated(pickle)})


def varint(value: int) -> bytes:
    """A whole number as Thrift's compact protocol has it."""
    value, found = value << 1, b""
    while value > 0x7F:
        found, value = found + bytes([value & 0x7F | 0x80]), value >> 7
    return found + bytes([value])


def parquet_pages(path: Path) -> None:
    """A column whose pages unpack to 400 MB, while the file states kilobytes."""
    values = np.arange(50_000_000, dtype=np.int64) % 7
    table = pa.table({"time": values.astype(float), "leapgap": values})
    pq.write_table(table, path, compression="zstd", use_dictionary=False, row_group_size=len(values))
    column = pq.ParquetFile(path).metadata.row_group(0).column(0)
    data = path.read_bytes()
    stated = varint(column.total_uncompressed_size)
    small = bytes([one | 0x80 for one in (0, *[0] * (len(stated) - 2))]) + b"\x01"  # the same length, another number
    end = data.rindex(stated)
    path.write_bytes(data[:end].replace(stated, small) + small + data[end + len(stated) :])


BOMBS = {
    "mat_small_head": ("mat", mat_small_head),
    "hdf5_piece": ("hdf5", hdf5_piece),
    "npz_header": ("npz", npz_header),
    "pt_storage": ("pt", pt_storage),
    "pt_order": ("pt", pt_order),
    "parquet_pages": ("parquet", parquet_pages),
}
"""Bombs by the format that they pretend to be."""
