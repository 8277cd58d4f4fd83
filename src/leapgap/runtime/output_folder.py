"""Output folders: which may be written into, who is writing, and what of them may be removed.

A folder is taken only if it does not exist, is empty, or carries our marker: the file ``.leapgap.json``, which names
the command that wrote the folder and every file that it wrote. Only files on that list are ever removed. The marker
holds no time and no name of a machine, so that the same input gives the same bytes.
"""

import json
import os
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from leapgap.errors import InputError, check_utf8
from leapgap.runtime.atomic_io import TEMPORARY, is_partial, partial, write_json

try:
    import fcntl
except ImportError:  # Windows: two runs into one folder are not kept apart there
    fcntl = None  # type: ignore[assignment]

MARKER = ".leapgap.json"
MARKED = "leapgap_output"  # key of a marker by which it is recognised
FORMAT_VERSION = 1
REPLACED = ".replaced.partial"  # end of the name of an earlier output while it is being replaced
NAMES_SHOWN = 5
AS_IT_WAS = "is as it was"
ABSENT_EMPTY_OR_OURS = "a folder that does not exist, is empty, or was written by the same command"


@dataclass(frozen=True)
class Marker:
    """What the marker of a folder says."""

    by: str  # command that wrote the folder, such as ``stages.chunk``
    files: tuple[str, ...]  # every file that it wrote, relative to the folder, with ``/``; without the marker itself

    @staticmethod
    def read(folder: Path) -> "Marker | None":
        """The marker of a folder; None where there is none that we wrote."""
        path = folder / MARKER
        if path.is_symlink() or not path.is_file():
            return None
        try:
            value = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        if not isinstance(value, Mapping) or value.get(MARKED) != FORMAT_VERSION:
            return None
        by, files = value.get("by"), value.get("files")
        if not isinstance(by, str) or not isinstance(files, list) or not all(is_inside(name) for name in files):
            return None
        return Marker(by, tuple(files))

    def write(self, folder: Path) -> None:
        """Write the marker into a folder."""
        write_json(
            folder / MARKER,
            {MARKED: FORMAT_VERSION, "by": self.by, "version": package_version(), "files": list(self.files)},
        )


def is_inside(name: Any) -> bool:
    """Whether a value is a relative path that does not lead out of its folder."""
    return isinstance(name, str) and name != "" and not Path(name).is_absolute() and ".." not in Path(name).parts


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("leapgap")
    except PackageNotFoundError:
        return "unknown"


def files_in(folder: Path) -> list[str]:
    """All files below a folder but its marker, relative to it, and its empty folders, with a final ``/``.

    Links are files and are not followed.
    """
    found = []
    for top, folders, names in os.walk(folder):
        place = Path(top).relative_to(folder)
        links = [name for name in folders if (Path(top) / name).is_symlink()]
        found += [(place / name).as_posix() for name in [*names, *links]]
        if not folders and not names and Path(top) != folder:
            found.append(f"{place.as_posix()}/")
    return sorted(name for name in found if name != MARKER)


def check_output(folder: Path, by: str, inputs: Iterable[Path | str | None] = (), kept: bool = False) -> Path:
    """The absolute path of an output folder that may be written; ``InputError`` for any other.

    ``inputs`` are what the command reads, None where it does not. ``kept``: the command adds to the folder and keeps
    foreign files in it; otherwise it replaces the whole folder, and foreign files in it are refused.
    """
    path = real_path(folder)
    for one in inputs:
        if one is not None:
            # Refuse an output that is an input, lies in one, or has one in it
            source = Path(one)
            out, read = path.resolve(), source.resolve()
            do = "choose an output folder that lies apart from what is read"
            if out == read or out in read.parents:
                raise InputError(path, f"the input {source} in it", "an output apart from all inputs", do)
            if read in out.parents:
                raise InputError(path, f"an output inside the input {source}", "an output apart from all inputs", do)
    check_parents(path, folder)
    if not os.path.lexists(path):
        return path
    if not path.is_dir():
        raise refusal(path, "something that is no folder", "choose another output folder")
    check_contents(path, by, kept)
    return path


def real_path(folder: Path) -> Path:
    """The absolute path of an output folder; one that is itself a link is an ``InputError``."""
    check_utf8(folder.absolute())
    if folder.is_symlink():
        raise refusal(folder, f"a link to {folder.readlink()}", "name the folder itself, or another one")
    return folder.resolve()


def check_parents(path: Path, named: Path) -> None:
    """Refuse a folder that would lie in a file, or where nothing can be written, before any work is done for it."""
    parent = next(one for one in path.parents if os.path.lexists(one))
    if not parent.is_dir():
        raise refusal(named, f"{parent}, which is no folder, above it", "choose another output folder")
    for folder in (parent, path):
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise refusal(named, f"a place where nothing can be written ({folder})", "choose another output folder")


def check_contents(path: Path, by: str, kept: bool) -> None:
    """Refuse a folder with files that the command did not write."""
    names = sorted(entry.name for entry in path.iterdir())
    if all(is_partial(name) for name in names):
        return
    marker = Marker.read(path)
    if marker is None:
        if kept and "DVC_STAGE" in os.environ:
            return  # a declared output that DVC keeps, of a version without markers: the cache knows its own files
        do = "choose another output folder; if an older leapgap wrote this one, remove it yourself"
        raise refusal(path, f"{shown(names)} in it, which leapgap did not write there", do)
    if marker.by != by:
        do = "choose another output folder, or remove this one yourself"
        raise refusal(path, f"a folder that {marker.by} wrote", do)
    known = set(marker.files)  # and not those of killed runs
    foreign = [name for name in files_in(path) if name not in known and not is_partial(Path(name).name)]
    if foreign and not kept:
        do = "move them elsewhere, or choose another output folder"
        raise refusal(path, f"{shown(foreign)} in it, which leapgap did not write there", do)


def refusal(path: Path, found: str, do: str) -> InputError:
    """The refusal of an output folder."""
    return InputError(path, found, ABSENT_EMPTY_OR_OURS, do)


def shown(names: list[str]) -> str:
    """The first of some names, and how many more there are."""
    more = len(names) - NAMES_SHOWN
    return ", ".join(names[:NAMES_SHOWN]) + (f" and {more} more" if more > 0 else "")


@contextmanager
def whole_folder(folder: Path, by: str) -> Iterator[Path]:
    """Yield an empty folder that takes the place of ``folder`` when the block ends without an error.

    The folder is checked before the block and again before it is replaced; until then it stays as it was.
    """
    path = check_output(folder, by)
    STATES.setdefault(path, AS_IT_WAS)
    with folder_lock(path), staging_folder(path, by) as beside:
        yield beside
        Marker(by, tuple(files_in(beside))).write(beside)
        if os.path.lexists(path):
            check_output(path, by)
            old = path.with_name(beside.name.removesuffix(".partial") + REPLACED)
            path.rename(old)
            beside.rename(path)
            remove_listed(old)
        else:
            beside.rename(path)
        STATES[path] = "is complete"


@contextmanager
def staging_folder(path: Path, by: str) -> Iterator[Path]:
    """Yield a new marked folder beside a locked one, which is removed at the end if it is still there."""
    restore(path)
    beside = partial(path)
    TEMPORARY.add(beside)
    try:
        beside.mkdir()
        Marker(by, ()).write(beside)
        yield beside
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        TEMPORARY.discard(beside)


def remove_listed(folder: Path) -> None:
    """Remove the files that the marker of a folder lists, files of killed runs, and what is empty then."""
    marker = Marker.read(folder)
    listed = () if marker is None else marker.files
    partials = [name for name in files_in(folder) if is_partial(Path(name).name)]
    for name in (*listed, *partials, MARKER):
        if not name.endswith("/"):
            (folder / name).unlink(missing_ok=True)
    for top in sorted((Path(top) for top, _, _ in os.walk(folder)), reverse=True):
        if not any(top.iterdir()):
            top.rmdir()


def restore(path: Path) -> None:
    """Clear what a killed run left beside a locked folder, and put an earlier output back that it had moved away."""
    if not path.parent.is_dir():
        return
    left = [one for one in path.parent.iterdir() if is_partial(one.name, path.name) and one.is_dir()]
    for one in left:
        if Marker.read(one) is None:
            continue
        if not one.name.endswith(REPLACED):
            shutil.rmtree(one)
        elif not os.path.lexists(path):
            one.rename(path)
        else:
            remove_listed(one)


@contextmanager
def merged_folder(folder: Path, by: str, replaced: Iterable[str] = ()) -> Iterator[Path]:
    """Yield an empty folder whose files are moved into ``folder`` when the block ends without an error.

    Foreign files in ``folder`` stay. One that has the name of a file to be written is an ``InputError``, and nothing is
    moved then. In the folders ``replaced`` within it, files of an earlier run that this one does not write are
    removed.
    """
    path = real_path(folder)
    check_parents(path, folder)
    STATES.setdefault(path, AS_IT_WAS)
    with folder_lock(path), staging_folder(path, by) as beside:
        yield beside
        marker = Marker.read(path)
        if marker is not None and marker.by != by:
            raise refusal(path, f"a folder that {marker.by} wrote", "choose another output folder")
        new, known = files_in(beside), set() if marker is None else set(marker.files)
        foreign = [name for name in new if name not in known and os.path.lexists(path / name)]
        if foreign:
            found = f"{shown(foreign)} in it, which leapgap did not write there"
            raise refusal(path, found, "move them elsewhere, or choose another output folder")
        old = {name for name in known - {*new} if name.startswith(tuple(f"{one}/" for one in replaced))}
        path.mkdir(exist_ok=True)
        Marker(by, tuple(sorted({*known, *new} - old))).write(path)
        for name in sorted(old, reverse=True):
            (path / name).rmdir() if name.endswith("/") else (path / name).unlink(missing_ok=True)
        for top in sorted({above for name in old for above in (path / name).parents if path in above.parents}):
            if top.is_dir() and not any(top.rglob("*")):
                shutil.rmtree(top)
        for name in new:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (beside / name).replace(path / name)
        STATES[path] = "is complete"


def claim_folder(folder: Path, by: str) -> Path:
    """Take a folder that a command adds to, and mark it; what earlier runs finished in it stays.

    The marker lists nothing: the records of the cache in it do (``cache.ResultCache``). The folder must be locked.
    """
    path = check_output(folder, by, kept=True)
    path.mkdir(parents=True, exist_ok=True)
    for name in files_in(path):
        if is_partial(Path(name).name):
            (path / name).unlink()
    if Marker.read(path) is None:
        Marker(by, ()).write(path)
    STATES[path] = "keeps what is finished: run again to go on"
    return path


STATES: dict[Path, str] = {}  # what became of each output folder of this run, for a message when it ends early


def what_is_kept() -> str:
    """The states of all output folders of this run, as one text."""
    return "; ".join(f"{path} {state}" for path, state in STATES.items()) or "nothing was written"


def system_error(error: OSError) -> InputError:
    """An error of the operating system (disk full, folder not writable) as a message that says what was kept."""
    reason = error.strerror or " ".join(str(error).split())
    places = ", ".join(str(path) for path in STATES) or "the command"
    where = error.filename if isinstance(error.filename, str | Path) else places
    do = f"free space, or choose a folder that you may write to; {what_is_kept()}"
    return InputError(where, reason, "files that can be read and written", do)


@dataclass
class HeldLock:
    """The lock of a folder that this process holds."""

    descriptor: int
    blocks: int = 0  # how many blocks hold the folder; the last to end frees it, whichever began first


LOCKS: dict[Path, HeldLock] = {}  # locks that this process holds, by their folders
CHANGING = threading.RLock()  # for the thread that takes or frees one; it may collect a forgotten block meanwhile


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; ``InputError`` says who holds it where another one does.

    The lock is one of the file ``.<name>.lock`` beside the folder, which the operating system frees when its process
    ends. Several blocks of one process may hold the same folder, inside each other or in threads.
    """
    path = real_path(folder)
    beside = path.with_name(f".{path.name}.lock")
    with CHANGING:
        if path not in LOCKS:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                LOCKS[path] = HeldLock(locked_file(beside, path))
            except OSError as error:
                found = f"a place where nothing can be written ({error.strerror})"
                raise refusal(folder, found, "choose another output folder") from None
            TEMPORARY.add(beside)
        held = LOCKS[path]
        held.blocks += 1
    try:
        yield
    finally:
        with CHANGING:
            held.blocks -= 1
            if held.blocks == 0:
                LOCKS.pop(path, None)  # the interpreter empties it before it ends a block that nobody ended
                TEMPORARY.discard(beside)
                if fcntl is None:
                    os.close(held.descriptor)  # Windows removes no open file
                beside.unlink(missing_ok=True)
                if fcntl is not None:
                    os.close(held.descriptor)


def locked_file(beside: Path, path: Path) -> int:
    """Descriptor of a lock file that is locked by this process."""
    while True:
        descriptor = os.open(beside, os.O_RDWR | os.O_CREAT, 0o644)
        if fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                holder = os.read(descriptor, 1000).decode(errors="replace").strip()
                os.close(descriptor)
                found = f"another run that writes here: {holder or 'it did not say which'}"
                do = "wait for it, or choose another output folder"
                raise InputError(path, found, "one run at a time", do) from None
        if beside.exists() and os.path.samestat(os.fstat(descriptor), beside.stat()):
            break
        os.close(descriptor)  # the run that held it has just ended and removed it
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"process {os.getpid()} ({Path(sys.argv[0]).name}), since {now} UTC\n".encode(), 0)
    return descriptor
