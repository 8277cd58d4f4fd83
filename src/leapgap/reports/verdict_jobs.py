"""Diagnoses of withheld cases, each in a folder that holds only copies of its logs and of the robot."""

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from leapgap.diagnosis.settings import Settings as Diagnosing
from leapgap.errors import InputError
from leapgap.reports.diagnosis import diagnose_folder
from leapgap.reports.kept import keep
from leapgap.robot.mjcf import own_model
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import sha256
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.content_hash import file_digests
from leapgap.runtime.executor import Executor

PUBLISHED = "published"
"""Name of the case of published jumps, as in the seals, whose code verdicts must not depend on; it may be known, since
their columns differ anyway."""


@dataclass(frozen=True)
class Job:
    """One diagnosis: a folder of logs, the robot and the settings."""

    place: str  # place of the verdict in the cache; its last part is the name of the case
    logs: Path
    robot: Path
    settings: Diagnosing
    threads: int | None = None  # threads of one diagnosis, which change no result and no key; None: one per core
    pages: bool = True  # whether the page is written too, or data to make it from

    @property
    def name(self) -> str:
        """Name of the case, the last part of the place of its verdict."""
        return Path(self.place).name

    @property
    def key(self) -> str:
        """Hash of all inputs and of the code, but for recordings, of which a verdict has none."""
        return result_key(diagnose_folder, [file_digests(self.logs), sha256(self.robot), self.settings, self.pages])


@dataclass(frozen=True)
class DiagnoseWithheldSettings:
    """Section ``diagnose_withheld`` of the configuration."""

    logs: str
    out: str | None
    settings: dict[str, Any]  # overrides of ``diagnose.settings``
    only: list[str] = field(default_factory=list)  # names of the cases; empty: all
    published: bool = False
    pages: bool = True


def cases_of(settings: DiagnoseWithheldSettings) -> list[str]:
    """Names of all withheld cases; ``InputError`` without any, and for an unknown name in ``only``."""
    logs = Path(settings.logs)
    if not logs.is_dir():
        raise InputError(logs, "no such folder", "withheld logs, one folder a case", "run stages.withhold first")
    folders = (path.name for path in sorted(logs.iterdir()) if path.is_dir())
    cases = [name for name in folders if settings.published or name != PUBLISHED]
    if unknown := set(settings.only) - set(cases):
        raise InputError("diagnose_withheld.only", ", ".join(sorted(unknown)), "names of cases", "correct them")
    return cases


def run_cases(
    cases: Sequence[str],
    settings: DiagnoseWithheldSettings,
    diagnosing: Diagnosing,
    robot: Path,
    cache: ResultCache,
    executor: Executor,
) -> None:
    """Diagnose the chosen cases without a verdict in the cache; verdicts of other folders than ``cases`` are removed.

    ``robot``: the model of cases that have none of their own.
    """
    logs = Path(settings.logs)
    jobs = [
        Job(name, logs / name, own_model(logs / name) or robot, diagnosing, pages=settings.pages)
        for name in settings.only or cases
    ]
    for name in cases:
        cache.expect(name)
    for job in jobs:
        cache.expect(job.place, job.key)
    cache.sweep()
    run_jobs(jobs, cache, executor)


def run_jobs(jobs: list[Job], cache: ResultCache, executor: Executor) -> None:
    """Run the jobs without a finished verdict and print the progress."""
    todo = [job for job in jobs if cache.get(job.place, job.key) is None]
    if executor.workers > 1 and len(todo) > 1:
        todo = [replace(job, threads=1) for job in todo]  # side by side; a single one uses every core itself
    print(f"{len(jobs)} cases, {len(jobs) - len(todo)} of them diagnosed already", flush=True)
    failed = {}
    for number, (name, sentence, error) in enumerate(executor.map(partial(judge, cache), todo), start=1):
        print(f"{number}/{len(todo)} {name}: {error or sentence}", flush=True)
        if error:
            failed[name] = error
    if failed:
        do = "fix the diagnosis and run again: the other cases are kept"
        raise InputError(", ".join(failed), "; ".join(sorted(set(failed.values()))), "a verdict for every case", do)


def judge(cache: ResultCache, job: Job) -> tuple[str, str, str]:
    """Name, conclusion and error of one case; an error leaves no verdict and stops no other case."""
    try:
        # Diagnose one case by the very function that stage ``diagnose`` calls; its conclusion
        with tempfile.TemporaryDirectory() as name, cache.store(job.place, job.key) as out:
            logs, robot = Path(name) / "logs", Path(name) / "robot.xml"
            shutil.copytree(job.logs, logs)
            shutil.copyfile(job.robot, robot)
            found = diagnose_folder(logs, Robot.load(robot), job.settings, threads=job.threads)
            if found is None:
                raise InputError(job.logs, "no jump logs", "one or more", "withhold the cases again")
            if job.pages:
                found.write(out / job.name)
            else:
                keep(replace(found, robot=Robot.load(job.robot)), out / job.name)  # its copy is about to go
        return job.name, found.sentence, ""
    except Exception as error:
        return job.name, "", f"{type(error).__name__}: {error}"
