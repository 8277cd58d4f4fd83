"""Fetch the published logs into data/raw from the public repository, at the commit that imports/ names.

An import file of imports/ is copied to data/raw, and `dvc update` fetches what it names. Logs that are there stay as
they are. It needs a network; without one nothing changes, and the exit code is 2.

Examples:

    python -m stages.fetch
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from omegaconf import OmegaConf

from leapgap.errors import InputError
from stages.common import answered_at_once, refuse

IMPORTS, RAW = Path("imports"), Path("data/raw")
PATIENCE_S = 20
"""An address that has not answered by then is taken for one that no network reaches."""
WITHOUT = "without them everything runs on simulated hardware and says so"


def fetch(imports: Path = IMPORTS, raw: Path = RAW) -> list[Path]:
    """Fetch what every import file of a folder names, where it is not there yet; the folders that are there now.

    ``InputError`` where a repository does not answer, or does not have what the import file names.
    """
    files = sorted(imports.glob("*.dvc"))
    if not files:
        raise InputError(imports, "no import file", "<name>.dvc", "restore it with git checkout")
    return [fetch_one(file, raw) for file in files]


def fetch_one(file: Path, raw: Path) -> Path:
    """Fetch what one import file names into ``raw/<its name>``; that folder. After a failure ``raw`` is as it was."""
    logs, pointer = raw / file.stem, raw / file.name
    if logs.is_dir() and any(logs.iterdir()):
        print(f"{logs}: there already, left as it is")
        return logs
    (dependency,) = OmegaConf.load(file).deps
    url, revision = dependency.repo.url, dependency.repo.rev
    check_answer(url, logs)
    print(f"{logs}: {dependency.path} of {url} at {revision[:7]}", flush=True)
    existed = pointer.exists()
    shutil.copyfile(file, pointer)
    done = subprocess.run(["dvc", "update", "-q", str(pointer)], capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return logs
    if not existed:
        pointer.unlink(missing_ok=True)
    message = " ".join((done.stderr or done.stdout).split())[:300]
    do = f"look whether the repository moved, or copy its folder {dependency.path} to {logs}"
    raise InputError(url, f"no such data at {revision[:7]} ({message})", dependency.path, do)


def check_answer(url: str, logs: Path) -> None:
    """Raise ``InputError`` where the repository at an address does not answer, which git asks in a moment."""
    silent = os.environ | {"GIT_TERMINAL_PROMPT": "0"}
    command = ["git", "ls-remote", "--quiet", url, "HEAD"]
    try:
        done = subprocess.run(command, env=silent, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        why = " ".join(done.stderr.split()) if done.returncode else ""
    except subprocess.TimeoutExpired:
        why = f"nothing within {PATIENCE_S} s"
    if why:
        do = f"run it where there is a network, or copy the logs to {logs}; {WITHOUT}"
        raise InputError(url, f"no answer ({why})", "a repository that a network reaches", do)


if __name__ == "__main__":
    if answer := answered_at_once("fetch", sys.argv[1:]):
        print(answer, end="")
        sys.exit()
    try:
        for folder in fetch():
            print(f"{folder}: {sum(1 for path in folder.rglob('*') if path.is_file())} files")
        print("now: make run, or dvc repro")
    except (InputError, OSError) as error:
        refuse("fetch", error)
