"""Atomic writing: files and folders are written under a temporary name beside their place and then renamed."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from leapgap.errors import InputError


def partial(path: Path) -> Path:
    """Temporary path beside ``path``; its name is fixed, so that killed runs leave at most one file or folder."""
    return path.with_name(f".{path.name}.partial")


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder that takes the place of ``folder`` when the block ends without an error."""
    beside = partial(folder)
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir(parents=True)
    try:
        yield beside
        if folder.exists():
            shutil.rmtree(folder)
        beside.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path beside ``path`` that is renamed to it when the block ends without an error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = partial(path)
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file atomically."""
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_json(path: Path, value: object) -> None:
    """Write JSON with a final newline; keys keep their order, NaN and infinity raise ``ValueError``."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_json(path: Path | str) -> Mapping:
    """Read a JSON object; an absent or broken file is an ``InputError``."""
    path = Path(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "no such file", "a JSON file", "run the stage that writes it") from None
    except ValueError as error:
        raise InputError(path, f"no valid JSON ({error})", "a JSON file", "write it again") from None
    if not isinstance(value, Mapping):
        raise InputError(path, type(value).__name__, "a JSON object", "write it again")
    return value


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
