"""Withheld cases diagnosed, each in an empty folder that holds its logs and the robot and nothing else."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import plotly.offline
from omegaconf import DictConfig, OmegaConf

from leapgap.diagnosis.diagnose import Settings as Diagnosing
from leapgap.errors import InputError
from leapgap.executor import Executor
from leapgap.files import whole_folder, write_json, write_text
from leapgap.keys import KEY, code_hash, has_key, key_of
from leapgap.robot.model import Robot
from stages.common import output_folder, read_config, run_stage
from stages.diagnose import diagnose

SCRIPT = "plotly.js"
"""What all reports of a run share, so that a page of thousands of cases stays small."""
REAL = "real"


@dataclass(frozen=True)
class Settings:
    """Section ``diagnose_withheld``."""

    logs: str
    out: str | None
    settings: dict[str, Any]
    """Laid over ``diagnose.settings``."""
    only: list[str] = field(default_factory=list)
    """Names of the cases; empty: all."""
    real: bool = False


@dataclass(frozen=True)
class Job:
    """One diagnosis: a folder of logs, and what they are judged with."""

    logs: Path
    out: Path
    robot: Path
    diagnose: Mapping[str, Any]
    """Section ``diagnose`` without paths."""
    code: str
    threads: int | None = None
    """Of one diagnosis; None: as many as cores. No part of the key: they change no result."""

    @property
    def key(self) -> str:
        """Hash of all inputs."""
        return key_of(self.logs, self.robot, self.diagnose, self.code)


def diagnose_withheld(config: DictConfig) -> None:
    """Diagnose what is not diagnosed yet; remove verdicts of cases that are no more."""
    settings = read_config(Settings, config.diagnose_withheld, "diagnose_withheld")
    executor = read_config(Executor, config.executor, "executor")
    logs, out = Path(settings.logs).resolve(), output_folder(settings.out).resolve()
    if not logs.is_dir():
        raise InputError(logs, "no such folder", "withheld logs, one folder a case", "run stages.withhold first")
    cases = [path.name for path in sorted(logs.iterdir()) if path.is_dir() and (settings.real or path.name != REAL)]
    unknown = set(settings.only) - set(cases)
    if unknown:
        raise InputError("diagnose_withheld.only", ", ".join(sorted(unknown)), "names of cases", "correct them")
    remove_unknown(out, set(cases))
    section, code = diagnose_section(config, settings.settings), code_hash()
    robot = Robot.load(config.robot.model).path.resolve()
    jobs = [Job(logs / name, out / name, robot, section, code) for name in settings.only or cases]
    run_jobs(jobs, executor)


def diagnose_section(config: DictConfig, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Section ``diagnose`` with settings laid over, and no paths in it."""
    read_config(Diagnosing, OmegaConf.merge(config.diagnose.settings, overrides), "diagnose_withheld.settings")
    section = OmegaConf.merge(config.diagnose, {"settings": overrides})
    own = {"logs": None, "robot": None, "out": None, "replays": None, "metrics": None, "recordings": False}
    return {**OmegaConf.to_container(section), **own}


def run_jobs(jobs: list[Job], executor: Executor) -> None:
    """Run the jobs without a finished verdict, and say how it goes."""
    if jobs:
        jobs[0].out.parent.mkdir(parents=True, exist_ok=True)
        write_text(jobs[0].out.parent / SCRIPT, plotly.offline.get_plotlyjs())
    todo = [job for job in jobs if not has_key(job.out, job.key)]
    if executor.workers > 1:
        todo = [replace(job, threads=1) for job in todo]
    print(f"{len(jobs)} cases, {len(jobs) - len(todo)} of them diagnosed already", flush=True)
    failed = {}
    for number, (name, sentence, error) in enumerate(executor.map(judge, todo), start=1):
        print(f"{number}/{len(todo)} {name}: {error or sentence}", flush=True)
        if error:
            failed[name] = error
    if failed:
        raise InputError(
            ", ".join(failed),
            "; ".join(sorted(set(failed.values()))),
            "a verdict for every case",
            "mend the diagnosis and run again: the other cases are kept",
        )


def judge(job: Job) -> tuple[str, str, str]:
    """Name, conclusion and error of one case; an error leaves no verdict and stops no other case."""
    try:
        return job.out.name, verdict_of(job), ""
    except Exception as error:
        return job.out.name, "", f"{type(error).__name__}: {error}"


def verdict_of(job: Job) -> str:
    """Diagnose one case by the very stage a user calls, in a folder of its own; its conclusion."""
    with tempfile.TemporaryDirectory() as name, whole_folder(job.out) as out:
        folder = Path(name)
        shutil.copytree(job.logs, folder / "logs")
        shutil.copyfile(job.robot, folder / "robot.xml")
        said = run_in(folder, {**job.diagnose, "threads": job.threads})
        verdict = folder / "verdict"
        page = (verdict / "report.html").read_text(encoding="utf-8")
        inline = f"<script>{plotly.offline.get_plotlyjs()}</script>"
        write_text(verdict / "report.html", page.replace(inline, f'<script src="../{SCRIPT}"></script>'))
        shutil.copytree(verdict, out, dirs_exist_ok=True, ignore=shutil.ignore_patterns("replays"))
        write_json(out / KEY, {"key": job.key})
    return said


def run_in(folder: Path, section: Mapping[str, Any]) -> str:
    """Run stage ``diagnose`` with a folder as its working folder, silently; its conclusion."""
    paths = {"logs": "logs", "robot": "robot.xml", "out": "verdict"}
    config = OmegaConf.create({"diagnose": {**section, **paths}, "robot": {"model": "robot.xml"}})
    lines: list[str] = []
    before = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(Tee(lines)):
            diagnose(config)
    finally:
        os.chdir(before)
    return lines[-2] if len(lines) > 1 else ""


class Tee:
    """Keeps what is printed, line by line."""

    def __init__(self, lines: list[str]) -> None:
        self.lines = lines

    def write(self, text: str) -> int:
        """Keep a line."""
        if text.strip():
            self.lines.append(text.strip())
        return len(text)

    def flush(self) -> None:
        """There is nothing to flush."""


def remove_unknown(out: Path, cases: set[str]) -> None:
    """Remove verdicts of cases that are no more."""
    for path in out.iterdir() if out.is_dir() else ():
        if path.is_dir() and path.name not in cases:
            shutil.rmtree(path)


if __name__ == "__main__":
    run_stage(diagnose_withheld)
