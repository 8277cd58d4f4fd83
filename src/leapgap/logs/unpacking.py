"""Unpacking with limits on what comes out: what a packed file says of that need not be so."""

import io
import zipfile
import zlib
from collections.abc import Callable
from typing import Any, BinaryIO, Protocol

from leapgap.errors import InputError

MOST_UNPACKED = 1_000_000_000
"""Bytes that a packed text or piece may have."""
PIECE_BYTES, READ_BYTES = 1 << 20, 1 << 16
"""Bytes that are unpacked, and read, at once."""


class Unpacker(Protocol):
    """What ``zlib``, ``bz2``, ``lz4.frame`` and ``zstd`` unpack with, piece by piece."""

    @property
    def eof(self) -> bool:
        """Whether the frame is over."""
        ...

    def decompress(self, data: bytes, max_length: int, /) -> bytes:
        """At most so many further bytes."""
        ...


class Bounded(io.RawIOBase):
    """A stream that is read from its begin and refuses to give more than ``most`` bytes."""

    def __init__(self, stream: Any, where: object, most: int = MOST_UNPACKED) -> None:
        self.stream, self.where, self.most, self.left = stream, where, most, most

    def readable(self) -> bool:
        """It is read, and nothing else."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer as far as there are bytes; ``InputError`` beyond the limit."""
        data = self.stream.read(min(len(buffer), self.left + 1))
        self.left -= len(data)
        if self.left < 0:
            raise too_much(self.where, self.most)
        buffer[: len(data)] = data
        return len(data)


def too_much(where: object, most: int) -> InputError:
    """The refusal of what unpacks to more than it may."""
    return InputError(where, f"more than {most} bytes when unpacked", f"{most} at most", "cut it into several files")


def unpack(data: bytes, start: Callable[[], Unpacker], where: object, most: int = MOST_UNPACKED) -> bytes:
    """Unpack one piece of data, of one or several frames; ``InputError`` where more than ``most`` bytes come out."""
    parts, left = [], most
    while data:
        unpacker = start()
        parts.append(unpacker.decompress(data, left + 1))
        left -= len(parts[-1])
        if left < 0:
            raise too_much(where, most)
        if not unpacker.eof:
            raise ValueError("packed data that end too early")
        data = getattr(unpacker, "unused_data", b"") or b""
    return b"".join(parts)


def inflated_size(file: BinaryIO, length: int, where: object, most: int) -> int:
    """Bytes that so many bytes of a file inflate to, of which none is kept; ``InputError`` beyond ``most``."""
    inflater, size, left = zlib.decompressobj(), 0, length
    while not inflater.eof and left > 0 and (data := file.read(min(left, READ_BYTES))):
        left -= len(data)
        while data and not inflater.eof:
            size += len(inflater.decompress(data, PIECE_BYTES))
            data = inflater.unconsumed_tail
            if size > most:
                raise too_much(where, most)
    return size


def member(folder: zipfile.ZipFile, name: str, where: object, most: int = MOST_UNPACKED) -> bytes:
    """A file of a zip, of which no more is unpacked than it states; ``InputError`` where that is above ``most``."""
    size = folder.getinfo(name).file_size
    if size > most:
        raise too_much(f"{where}, {name}", most)
    with folder.open(name) as file:
        return file.read(size) if size else b""
