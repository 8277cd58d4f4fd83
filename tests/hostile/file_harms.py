"""What may be wrong with a file: small functions that harm it after it was written, whatever its format."""

import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

FileHarm = Callable[[Path, np.random.Generator], None]


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
    """Make a socket at a path, which may be longer than names of sockets can be."""
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


def repeated(seeds: int) -> list[str]:
    """Names of the harms, those at random places with several seeds."""
    random = ("truncated", "noise", "zeros")
    return [name for name in FILE_HARMS for _ in range(seeds if "bit" in name or name in random else 1)]
