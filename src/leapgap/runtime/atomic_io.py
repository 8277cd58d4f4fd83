"""Atomic writing of files: each is written under a temporary name beside its place and then renamed."""

import hashlib
import json
import os
import re
import secrets
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from leapgap.errors import InputError

HOST = re.sub(r"[^A-Za-z0-9]", "", socket.gethostname())[:20] or "host"
PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>[A-Za-z0-9]{1,20})-(?P<pid>\d+)-[0-9a-f]{8}(\.replaced)?\.partial")
"""Names of temporary files and folders."""
LARGEST_JSON = 256 << 20  # bytes of a JSON file that is read
METRIC_DIGITS = 4  # significant digits of figures that are committed
LONGEST_NAME = 150  # characters of a name that its temporary name repeats, so that it stays a valid one
TEMPORARY: set[Path] = set()  # temporary files and folders of this process; what ends it at once removes them


def partial(path: Path) -> Path:
    """New temporary path beside ``path``, which no other process or thread uses."""
    token = f"{HOST}-{os.getpid()}-{secrets.token_hex(4)}"
    return path.with_name(f".{path.name[:LONGEST_NAME]}.{token}.partial")


def is_partial(name: str, of: str | None = None) -> bool:
    """Whether a name is one of ``partial``: of any path, or of one whose name is ``of``."""
    found = PARTIAL.fullmatch(name)
    return found is not None and (of is None or found["name"] == of[:LONGEST_NAME])


def is_running(pid: int) -> bool:
    """Whether a process of this machine exists; True where that cannot be asked."""
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        pass
    return True


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a path beside ``path`` that is renamed to it when the block ends without an error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Remove temporary files for ``path`` that killed processes of this machine left behind
    for left in path.parent.iterdir():
        found = PARTIAL.fullmatch(left.name)
        if found is None or found["name"] != path.name[:LONGEST_NAME] or found["host"] != HOST:
            continue
        if not is_running(int(found["pid"])) and left.is_file():
            left.unlink(missing_ok=True)
    beside = partial(path)
    TEMPORARY.add(beside)
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
        TEMPORARY.discard(beside)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file atomically; what is no text, as in names of files, becomes its code, ``\\udcff``."""
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8", errors="backslashreplace")


def write_json(path: Path, value: object) -> None:
    """Write JSON with a final newline; keys keep their order, NaN and infinity raise ``ValueError``."""
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_metrics(path: Path, figures: Mapping) -> None:
    """Write committed figures, floats at ``METRIC_DIGITS``: further digits differ from one processor to the next."""
    write_json(path, rounded(figures))


def rounded(value: Any) -> Any:
    """The same structure with floats at ``METRIC_DIGITS`` significant digits."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    return float(f"{value:.{METRIC_DIGITS}g}") if isinstance(value, float) else value


def read_json(path: Path | str) -> Mapping:
    """Read a JSON object; an absent or broken file is an ``InputError``."""
    path = Path(path)
    if path.exists() and not path.is_file():  # a pipe would wait for ever
        raise InputError(path, "no plain file", "a JSON file", "name a file")
    if path.exists() and path.stat().st_size > LARGEST_JSON:
        raise InputError(
            path, f"{path.stat().st_size >> 20} MiB", f"{LARGEST_JSON >> 20} MiB at most", "write it again"
        )
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "no such file", "a JSON file", "run the stage that writes it") from None
    except OSError as error:  # links in a circle, no permission
        raise InputError(path, f"a file that cannot be read ({error.strerror})", "a JSON file", "name a file") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"no valid JSON ({error})", "a JSON file", "write it again") from None
    if not isinstance(value, Mapping):
        raise InputError(path, type(value).__name__, "a JSON object", "write it again")
    return value


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
