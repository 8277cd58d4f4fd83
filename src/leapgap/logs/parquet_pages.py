"""What the pages of a Parquet file state, before they are unpacked: each may state up to 2 GiB, whatever the file does.

A column is read page by page, and each page begins with a header in Thrift's compact protocol.
"""

from pathlib import Path
from typing import Any, BinaryIO

import pyarrow.parquet as pq

from leapgap.errors import InputError

SMALL_BYTES = 1 << 15
"""Columns of flat values that take less in the file cannot unpack to much."""
HEADER_BYTES, DEEPEST = 1 << 16, 8
UNPACKED, PACKED, VALUES = 2, 3, 1
"""Fields of a page's header, and of the header of its kind."""
KINDS = (5, 8)
"""Fields with the header of a page of data, of either version."""
TRUE, FALSE, BYTE, DOUBLE, BINARY, LIST, SET, STRUCT = 1, 2, 3, 7, 8, 9, 10, 12
WHOLE = (4, 5, 6)
"""Kinds of values."""


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
            header, length = Header(raw.read(HEADER_BYTES)).read()
            packed = int(header[PACKED])
            unpacked += int(header[UNPACKED]) + length
            values += sum(int(header[kind][VALUES]) for kind in KINDS if kind in header)
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

    def read(self) -> tuple[dict[int, Any], int]:
        """The fields of the structure by their numbers, and its length."""
        return self.structure(0), self.at

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

    def structure(self, depth: int) -> dict[int, Any]:
        """Fields until the one that ends the structure."""
        if depth > DEEPEST:
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
