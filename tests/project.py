"""A copy of the project, for tests that run DVC in it."""

import fcntl
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from omegaconf import OmegaConf

from tests.code import ROOT

DVC = str(Path(sys.executable).with_name("dvc"))


def environment(folder: Path) -> dict[str, str]:
    """Variables with which commands use this interpreter and the library of a copy of the project in ``folder``."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("DVC_", "GIT_"))}
    path = f"{Path(sys.executable).parent}{os.pathsep}{kept['PATH']}"
    return kept | {"PATH": path, "PYTHONPATH": str(folder / "src"), "DVC_NO_ANALYTICS": "1"}


class Project:
    """A copy of the working tree as a git repository of its own, set to size tiny."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for name in listed:
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        self.change("conf/config.yaml", "size: default", "size: tiny")
        self.git("init", "-q", "-b", "main")
        self.commit("start")

    @classmethod
    def copy_of(cls, original: Path, folder: Path) -> "Project":
        """A copy of a project with its results and its DVC cache, as if it had been run in ``folder``."""
        shutil.copytree(original, folder, symlinks=True, dirs_exist_ok=True)
        project = cls.__new__(cls)
        project.folder = folder
        return project

    @property
    def environment(self) -> dict[str, str]:
        return environment(self.folder)

    def run(self, *command: str, code: int | None = 0) -> str:
        done = subprocess.run(
            command, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
        )
        said = done.stdout + done.stderr
        assert code is None or done.returncode == code, said[-6000:]
        return said

    def dvc(self, *arguments: str, code: int | None = 0) -> str:
        return self.run(DVC, *arguments, code=code)

    def git(self, *arguments: str) -> str:
        identity = ("-c", "user.name=tester", "-c", "user.email=tester@example.org", "-c", "commit.gpgsign=false")
        return self.run("git", *identity, *arguments)

    def commit(self, message: str) -> None:
        self.git("add", "-A")
        self.git("commit", "-q", "-m", message)

    def change(self, file: str, old: str, new: str) -> None:
        path = self.folder / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def after(self, stages: set[str]) -> set[str]:
        """Names of the stages that use what ``stages`` make, directly or through others."""
        uses = re.findall(r'"([^"]+)" -> "([^"]+)"', self.dvc("dag", "--dot"))
        found, known = set(stages), set()
        while found != known:
            known = set(found)
            found |= {user for maker, user in uses if maker in known}
        return found - stages

    def outputs(self) -> dict[str, str]:
        """Hash of every output, each of which must repeat byte for byte."""
        lock = OmegaConf.to_container(OmegaConf.load(self.folder / "dvc.lock"))
        return {
            out["path"]: out["md5"]
            for stage in lock["stages"].values()
            for out in stage.get("outs", [])  # type: ignore[index,call-overload]
        }


SAID = "said.txt"
"""File, beside a project that was run once for all tests, with what DVC said."""


def run_once(beside: Path) -> Path:
    """Folder of a project without a log of a real robot, in which the whole pipeline ran once.

    ``beside`` is a folder that all processes of this call of pytest share; the first that asks runs the pipeline, and
    others wait for it. Nobody changes this project: tests that do take a copy. Its stages have no workers: one test for
    each core runs beside it, and each worker would import all that its stage does.
    """
    folder = beside / "simulated_once" / "project"
    folder.parent.mkdir(exist_ok=True)
    with (folder.parent / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        said = folder.parent / SAID
        if not said.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            project = Project(folder)
            project.change("conf/config.yaml", "executor: joblib", "executor: local")
            project.change("conf/train/default.yaml", "processes: 2", "processes: 1")
            text = project.dvc("repro")
            project.commit("run")
            said.write_text(text)
    return folder


def ran(said: str) -> set[str]:
    """Names of the stages that DVC says it ran."""
    return set(re.findall(r"Running stage '([^']+)'", said))
