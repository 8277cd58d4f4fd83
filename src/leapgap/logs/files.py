"""Foreign files: what is opened at all, how much of it is taken into memory, and what a broken one becomes."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from leapgap.errors import InputError, check_utf8

MOST_BYTES = 4_000_000_000
"""A file that would take more memory than this is refused before any of it is taken."""
VALUE_BYTES = 8
MOST_FILES = 100_000
"""Files in a folder that is one log or dataset."""
LONGEST_MESSAGE = 300
"""Characters of a decoder's own message that are repeated."""
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
