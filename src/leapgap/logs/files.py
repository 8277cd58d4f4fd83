"""Foreign files: what is opened at all, how much is taken into memory or unpacked, and what a broken one becomes."""

import io
import os
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow.parquet as pq

from leapgap.errors import InputError, check_utf8

MOST_BYTES = 4_000_000_000  # a file that would take more memory than this is refused before any of it is taken
VALUE_BYTES = 8
MOST_FILES = 100_000  # files in a folder that is one log or dataset
LONGEST_MESSAGE = 300  # characters of a decoder's own message that are repeated
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_file(path: Path, expected: str, do: str) -> None:
    """``InputError`` unless the path is an ordinary file, or a link to one; others might wait for ever or never end."""
    check_utf8(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(path, "no such file", expected, do) from None
    except (OSError, ValueError) as error:
        raise InputError(path, f"a path that cannot be opened ({error})", expected, do) from None
    if not stat.S_ISREG(mode):
        raise InputError(path, KINDS.get(stat.S_IFMT(mode), "no file"), expected, do)


def check_tree(path: Path, expected: str, do: str) -> None:
    """The same of a file, or of all files in a folder."""
    if not path.is_dir():
        check_file(path, expected, do)
        return
    check_folder(path)
    for number, one in enumerate(path.rglob("*")):
        if number >= MOST_FILES:
            raise InputError(path, f"more than {MOST_FILES} files", expected, do)
        if one.is_dir():
            check_folder(one)
        else:
            check_file(one, expected, do)


def check_folder(path: Path) -> None:
    """``InputError`` for a folder, or one in it, that may not be read: what looks for files would find none there."""
    check_utf8(path)
    folder = path
    try:
        with os.scandir(folder) as entries:
            inner = [Path(entry.path) for entry in entries if entry.is_dir() and not entry.name.startswith(".")]
        for folder in inner:
            with os.scandir(folder):
                pass
    except OSError as error:
        found = f"a folder that cannot be read ({error.strerror or error})"
        raise InputError(folder, found, "folders that you may read", "change its permissions, or copy it") from None


def check_values_fit(path: object, values: float, most_bytes: int = MOST_BYTES) -> None:
    """``InputError`` where a file states more values than are taken into memory."""
    if values * VALUE_BYTES > most_bytes:
        found = f"{values:.3g} values"
        raise InputError(path, found, f"at most {most_bytes // VALUE_BYTES:.3g}", "cut the file into several")


@contextmanager
def decoding(path: object, kind: str, do: str) -> Iterator[None]:
    """Stand around what decodes a foreign file: whatever a library raises there becomes an ``InputError``.

    A damaged file shows as errors of any type: of the archive, the decompressor, the text, the lists of a decoder.
    """
    try:
        yield
    except InputError:
        raise
    except MemoryError:
        found = "more than the memory of this machine holds"
        raise InputError(path, found, f"{kind} that fits", "cut it into several files") from None
    except Exception as error:
        says = " ".join(str(error).split())[:LONGEST_MESSAGE]
        raise InputError(path, f"no readable {kind} ({type(error).__name__}: {says})", "a whole file", do) from error


MOST_UNPACKED = 1_000_000_000  # bytes that a packed text or piece may have
PIECE_BYTES, READ_BYTES = 1 << 20, 1 << 16  # bytes that are unpacked, and read, at once


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


def unpack(data: bytes, start: Callable[[], Any], where: object, most: int = MOST_UNPACKED) -> bytes:
    """Unpack one piece of data, of one or several frames; ``InputError`` where more than ``most`` bytes come out.

    ``start`` makes what ``zlib``, ``bz2``, ``lz4.frame`` and ``zstd`` unpack a frame with, piece by piece.
    """
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


SMALL_BYTES = 1 << 15  # columns of flat values that take less in the file cannot unpack to much
HEADER_BYTES, DEEPEST_FIELD = 1 << 16, 8
UNPACKED, PACKED, VALUES = 2, 3, 1  # fields of a page's header, and of the header of its kind
PAGE_KINDS = (5, 8)  # fields with the header of a page of data, of either version
TRUE, FALSE, BYTE, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
WHOLE = (4, 5, 6)  # kinds of values that are whole numbers of variable length in a page's header


def check_pages(path: Path, file: pq.ParquetFile, columns: set[str] | None = None) -> None:
    """``InputError`` where pages state more bytes or values than the file does of their column."""
    metadata, schema = file.metadata, file.schema
    nested = [schema.column(i).max_repetition_level > 0 for i in range(metadata.num_columns)]
    with path.open("rb") as raw:
        for group in map(metadata.row_group, range(metadata.num_row_groups)):
            for i in range(metadata.num_columns):
                column = group.column(i)
                wanted = columns is None or column.path_in_schema.partition(".")[0] in columns
                if wanted and (nested[i] or column.total_compressed_size > SMALL_BYTES):
                    check_column(path, raw, column)


def check_column(path: Path, raw: BinaryIO, column: pq.ColumnChunkMetaData) -> None:
    """The same of one column of one group of rows."""
    starts = [column.data_page_offset, *([column.dictionary_page_offset] if column.has_dictionary_page else [])]
    at = min(start for start in starts if start is not None)
    end, unpacked, values = at + column.total_compressed_size, 0, 0
    where = f"{path}, column {column.path_in_schema}"
    while at < end:
        raw.seek(at)
        try:
            page = Header(raw.read(HEADER_BYTES))
            header, length = page.structure(), page.at
            packed = int(header[PACKED])
            unpacked += int(header[UNPACKED]) + length
            values += sum(int(header[kind][VALUES]) for kind in PAGE_KINDS if kind in header)
        except (IndexError, KeyError, TypeError, ValueError, RecursionError):
            raise InputError(where, "a page without a whole header", "a whole file", "export it again") from None
        if packed < 0 or header[UNPACKED] < 0 or unpacked > column.total_uncompressed_size:
            found = f"pages of {unpacked} bytes or more"
            raise InputError(where, found, f"{column.total_uncompressed_size}, as the file states", "export it again")
        at += length + packed
    if values > column.num_values:
        raise InputError(where, f"pages of {values} values", f"{column.num_values}", "export it again")


class Header:
    """Reads one structure of Thrift's compact protocol."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def byte(self) -> int:
        """The byte at the present place, which goes on by one."""
        self.at += 1
        return self.data[self.at - 1]

    def whole(self) -> int:
        """A number of seven bits a byte, the lowest first."""
        value, shift = 0, 0
        while True:
            one = self.byte()
            value |= (one & 0x7F) << shift
            shift += 7
            if one < 0x80:
                return value
            if shift > 70:
                raise ValueError("a number without end")

    def signed(self) -> int:
        """A number whose lowest bit is its sign."""
        value = self.whole()
        return (value >> 1) ^ -(value & 1)

    def structure(self, depth: int = 0) -> dict[int, Any]:
        """Fields by their numbers, until the one that ends the structure."""
        if depth > DEEPEST_FIELD:
            raise ValueError("too deep")
        fields: dict[int, Any] = {}
        number = 0
        while (head := self.byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self.signed()
            kind = head & 0x0F
            fields[number] = kind == TRUE if kind in (TRUE, FALSE) else self.value(kind, depth)
        return fields

    def value(self, kind: int, depth: int) -> Any:
        """A value of a kind; texts and lists are passed over."""
        if kind in (TRUE, FALSE, BYTE):
            return self.byte()
        if kind == DOUBLE:
            self.at += 8
        elif kind == BINARY:
            length = self.whole()
            self.at += length
        elif kind in (LIST, SET):
            head = self.byte()
            for _ in range(head >> 4 if head >> 4 < 15 else self.whole()):
                self.value(head & 0x0F, depth + 1)
        elif kind == STRUCT:
            return self.structure(depth + 1)
        elif kind in WHOLE:
            return self.signed()
        else:
            raise ValueError(f"kind {kind}")
        return None
