"""Fetch public logs into data/raw from the repositories of their owners, at the commits that imports/ names.

The import files of a source are copied to data/raw, and `dvc update` fetches what they name. Files that are there
stay as they are. It needs a network; without one nothing changes, and the exit code is 2. Sources: a1_hardware (the
published jumps, the default), and for `make robots` acrobot, go2_in_air, ricmonk, so101_sage, cube_tosses,
cassie_landings.

Examples:

    python -m stages.fetch
    python -m stages.fetch acrobot ricmonk
"""

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from leapgap.errors import InputError, did_you_mean
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.output_folder import folder_lock, is_inside
from stages.common import program, run_command

IMPORTS, RAW = Path("imports"), Path("data/raw")
JUMPS = "a1_hardware"  # the source that is fetched where none is named
PATIENCE_S = 20  # an address that has not answered by then is taken for one that no network reaches
WITHOUT = "everything runs on simulated hardware and says so"
WITHOUT_ROBOT = "make robots leaves its cases out and says so"
"""What happens without the jumps, and without the logs of a real robot."""
UNFINISHED = ".fetching.json"
"""File in data/raw while files come: their names, so that a fetch that was killed leaves no half of them."""


@dataclass(frozen=True)
class Import:
    """One import file: a file or folder of a public repository at a commit, and where it goes."""

    file: Path
    url: str
    revision: str
    path: str  # in the repository
    out: str  # below data/raw; its first folder is the source's name
    md5: str | None  # of the content, where it is known

    @staticmethod
    def read(file: Path) -> "Import":
        """The import that a .dvc file states; ``InputError`` for a file that states none."""
        try:
            stated = OmegaConf.load(file)
            (dependency,), (out,) = stated.deps, stated.outs
            names = dependency.repo.url, dependency.repo.rev, dependency.path, out.path
            if not all(isinstance(one, str) for one in names) or not is_inside(out.path):
                raise ValueError(f"its names are {names}")
            return Import(file, *names, out.get("md5"))
        except (yaml.YAMLError, OmegaConfBaseException, AttributeError, TypeError, ValueError) as error:
            says = " ".join(str(error).split())[:200]
            do = "restore it with git checkout"
            raise InputError(file, f"no import of DVC ({says})", "one dependency and one output", do) from None

    @property
    def source(self) -> str:
        """Name of the source that it is a part of."""
        return Path(self.out).parts[0]

    def is_in(self, raw: Path) -> bool:
        """Whether the file is there, or the folder and something in it."""
        out = raw / self.out
        return out.is_file() or (out.is_dir() and any(out.iterdir()))


def fetch(names: Sequence[str] = (JUMPS,), imports: Path = IMPORTS, raw: Path = RAW) -> list[Path]:
    """Fetch what the import files of some sources name, where it is not there yet; the folders that are there now.

    ``InputError`` where a repository does not answer, or does not have what an import file names.
    """
    known = [Import.read(file) for file in sorted(imports.glob("*.dvc"))]
    if not known:
        do = "run it in the project's folder, or restore them with git checkout"
        raise InputError(imports, "no import file", "<name>.dvc", do)
    sources = list(dict.fromkeys(one.source for one in known))
    for name in names:
        if name not in sources:
            do = did_you_mean(name, sources) or "choose one"
            raise InputError("source", name, f"one of {', '.join(sources)}", do)
    return [fetch_source([one for one in known if one.source == name], raw) for name in names]


def fetch_source(parts: Sequence[Import], raw: Path) -> Path:
    """Fetch the parts of one source that are not there; its folder. After a failure ``raw`` is as it was."""
    logs, unfinished = raw / parts[0].source, raw / UNFINISHED
    if not unfinished.exists() and all(part.is_in(raw) for part in parts):
        print(f"{logs}: there already, left as it is")
        return logs
    with folder_lock(raw / "fetch"):
        remove_unfinished(raw)
        missing = [part for part in parts if not part.is_in(raw)]
        for url in dict.fromkeys(part.url for part in missing):
            check_answer(url, logs)
        for part in missing:
            print(f"{raw / part.out}: {part.path} of {part.url} at {part.revision[:7]}", flush=True)
        pointers = [part.file.name for part in missing if not (raw / part.file.name).exists()]
        coming = [part.out for part in missing] if logs.exists() else [logs.name]
        write_json(unfinished, {"files": [*pointers, *coming]})
        try:
            fetch_parts(missing, raw)
        except BaseException:
            remove_unfinished(raw)
            raise
        unfinished.unlink()
    return logs


def remove_unfinished(raw: Path) -> None:
    """Remove what a fetch that did not end had begun to bring, and the folders that are empty then."""
    if not (raw / UNFINISHED).exists():
        return
    for name in filter(is_inside, read_json(raw / UNFINISHED).get("files", ())):
        path = raw / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        for folder in path.parents:
            if folder == raw or not folder.is_dir() or any(folder.iterdir()):
                break
            folder.rmdir()
    (raw / UNFINISHED).unlink()


def fetch_parts(parts: Sequence[Import], raw: Path) -> None:
    """Let DVC fetch parts of one source in one call, which reads each repository once."""
    pointers = [raw / part.file.name for part in parts]
    for part, pointer in zip(parts, pointers, strict=True):
        (raw / part.out).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(part.file, pointer)
    command = [program("dvc"), "update", "-q", *map(str, pointers)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        message, first = " ".join((done.stderr or done.stdout).split())[:300], parts[0]
        do = f"look whether the repository moved, or copy {first.path} of it to {raw / first.out}"
        raise InputError(first.url, f"no such data at {first.revision[:7]} ({message})", first.path, do)
    for part, pointer in zip(parts, pointers, strict=True):
        found = Import.read(pointer).md5
        if part.md5 is not None and found != part.md5:
            do = f"look what changed there; {part.file} says which content is meant"
            raise InputError(f"{part.url}, {part.path}", f"other content (md5 {found})", f"md5 {part.md5}", do)


def check_answer(url: str, logs: Path) -> None:
    """Raise ``InputError`` where the repository at an address does not answer, which git asks in a moment."""
    silent = os.environ | {"GIT_TERMINAL_PROMPT": "0"}
    command = [program("git"), "ls-remote", "--quiet", url, "HEAD"]
    try:
        done = subprocess.run(command, env=silent, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        why = " ".join(done.stderr.split()) if done.returncode else ""
    except subprocess.TimeoutExpired:
        why = f"nothing within {PATIENCE_S} s"
    if why:
        without = WITHOUT if logs.name == JUMPS else WITHOUT_ROBOT
        do = f"run it where there is a network, or copy the logs to {logs}; without them {without}"
        raise InputError(url, f"no answer ({why})", "a repository that a network reaches", do)


def fetch_and_say(names: Sequence[str]) -> None:
    """Fetch sources, the jumps where none is named, and say what to run now."""
    for folder in fetch(names or (JUMPS,)):
        do = "make run, or dvc repro" if folder.name == JUMPS else "make robots"
        print(f"{folder}: {sum(1 for path in folder.rglob('*') if path.is_file())} files; now: {do}")


if __name__ == "__main__":
    run_command("fetch", fetch_and_say)
