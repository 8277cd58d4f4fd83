"""Cache of results, each identified by a hash of its inputs, its settings and its code.

A result is one or more files, or a folder, at a *place* below the cache's folder: ``worn/joint_pd/jump_60_0`` may be
``jump_60_0.json`` with ``jump_60_0.parquet`` in the folder ``worn/joint_pd``. Beside them lies ``jump_60_0.key``, the
record: the key, and the names of the files. Only files that a record names are removed.
"""

import json
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from leapgap.runtime.atomic_io import sha256, write_json
from leapgap.runtime.content_hash import digest, modules_within
from leapgap.runtime.import_closure import PACKAGE, code_hash, distributions, library
from leapgap.runtime.output_folder import Marker

RECORD = ".key"
MARKER = "leapgap_result"  # key of a record by which the cache recognises its own
FORMAT_VERSION = 1
UNFINISHED = "unfinished"  # stem of the record in the folder of a result that is being computed


def result_key(make: Callable[..., Any], inputs: Any) -> str:
    """Hash of everything a result depends on: its inputs, and the code that computes it.

    The code is the import closure of the module of ``make`` and of the modules of all classes among the inputs. No list
    is written by hand, so no file can be forgotten. Choose ``make`` from a module that imports little else.
    """
    modules = {make.__module__, *modules_within(inputs)}
    ours = sorted(name for name in modules if name in library(PACKAGE).modules)
    return digest((code_hash(*ours), [foreign_code(name) for name in sorted(modules - set(ours))], inputs))


def foreign_code(module: str) -> str:
    """SHA-256 of a module of neither this nor an installed library; empty for modules of those."""
    first = module.split(".")[0]
    path = getattr(sys.modules.get(module), "__file__", None)
    known = first in sys.stdlib_module_names or first in distributions() or first == PACKAGE.name
    return "" if known or path is None else sha256(Path(path))


@dataclass(frozen=True)
class ResultCache:
    """A folder of results. Places use ``/``; their last part contains no dot, so that results share no files."""

    folder: Path
    used_keys: dict[str, str | None] = field(default_factory=dict)
    """Place → key of the results that this run uses; ``sweep`` removes all others."""

    def expect(self, place: str, key: str | None = None) -> None:
        """Keep the result at a place when sweeping; without a key, whatever its key is."""
        self.used_keys[place] = key

    def get(self, place: str, key: str) -> Path | None:
        """Path of the result with this key, without the endings of its files; None where it must be computed."""
        self.expect(place, key)
        record = read_record(self._record(place))
        if record is None or record["key"] != key:
            return None
        path = self.folder / place
        return path if all((path.parent / name).is_file() for name in record["files"]) else None

    @contextmanager
    def store(self, place: str, key: str) -> Iterator[Path]:
        """Yield an empty folder; when the block ends without an error, what was written there becomes the result.

        Names in it are the last part of the place, alone (a folder) or with endings. A kill before the end leaves
        the place without this key, and what it leaves is removed by the next ``store`` or ``sweep``.
        """
        self.expect(place, key)
        target = self.folder / place
        staging = self._unfinished(place, key)
        staged = staging / "result"
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir()
        try:
            yield staged
        except BaseException:
            shutil.rmtree(staged)
            if [path.suffix for path in staging.iterdir()] == [RECORD]:  # no scratch to go on from
                shutil.rmtree(staging)
                remove_empty(staging.parent, self.folder)
            raise
        files = sorted(path.relative_to(staged).as_posix() for path in staged.rglob("*") if path.is_file())
        wrong = [name for name in files if name.split("/")[0].split(".")[0] != target.name]
        if wrong:
            raise ValueError(f"{target}: {', '.join(wrong)} in its result; names begin with {target.name}")
        before = read_record(self._record(place))
        old = set(before["files"]) if before else set()
        self._write_record(place, None, sorted(old | set(files)))
        remove_files([target.parent / name for name in sorted(old - set(files))], target.parent)
        for name in files:
            (target.parent / name).parent.mkdir(parents=True, exist_ok=True)
            (staged / name).replace(target.parent / name)
        self._write_record(place, key, files)
        shutil.rmtree(staging)

    def scratch(self, place: str, key: str) -> Path:
        """Folder for checkpoints that a killed run resumes from; it is removed when the result is stored."""
        return self._unfinished(place, key) / "scratch"

    def sweep(self) -> None:
        """Remove the results, finished or not, that this run did not use; files that no record names stay."""
        for path in sorted(self.folder.rglob(f"*{RECORD}")):
            record = read_record(path)
            if record is None or self._is_of_another_output(path):
                continue
            if path.stem == UNFINISHED:
                if self.used_keys.get(record["place"]) != record["key"]:
                    shutil.rmtree(path.parent)
                    remove_empty(path.parent.parent, self.folder)
            elif self._place(path) not in self.used_keys:
                remove_files([path.parent / name for name in record["files"]] + [path], self.folder)

    def _is_of_another_output(self, path: Path) -> bool:
        """Whether a file lies in a further output folder below this one, which is not to be swept."""
        above = path.relative_to(self.folder).parents
        return any(Marker.read(self.folder / one) is not None for one in above if one != Path())

    def _record(self, place: str) -> Path:
        path = self.folder / place
        if "." in path.name:
            raise ValueError(f"{place}: the last part of a place has no dot")
        return path.with_name(path.name + RECORD)

    def _place(self, record: Path) -> str:
        return record.relative_to(self.folder).with_suffix("").as_posix()

    def _write_record(self, place: str, key: str | None, files: list[str]) -> None:
        write_json(self._record(place), {MARKER: FORMAT_VERSION, "key": key, "files": files})

    def _unfinished(self, place: str, key: str) -> Path:
        """The folder in which a result is computed, with its own record."""
        target = self.folder / place
        folder = target.with_name(f".{target.name}-{key[:12]}")
        record = folder / f"{UNFINISHED}{RECORD}"
        if read_record(record) is None:
            write_json(record, {MARKER: FORMAT_VERSION, "key": key, "files": [], "place": place})
        return folder


def read_record(path: Path) -> Mapping[str, Any] | None:
    """Read a record of the cache; None where the file is absent or no record."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get(MARKER) == FORMAT_VERSION else None


def remove_files(files: list[Path], top: Path) -> None:
    """Remove those of the files that exist, then the folders below ``top`` that became empty."""
    for path in files:
        if path.is_file() and path.resolve().is_relative_to(top.resolve()):
            path.unlink()
            remove_empty(path.parent, top)


def remove_empty(folder: Path, top: Path) -> None:
    """Remove a folder below ``top`` and its parents as far as they are empty."""
    while folder != top and folder.is_relative_to(top) and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent
