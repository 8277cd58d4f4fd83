"""Diagnose the withheld cases, each in a folder that holds only copies of its logs and of the robot.

Examples:

    python -m stages.diagnose_withheld 'diagnose_withheld.only=[case_000]' diagnose_withheld.out=verdicts
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.diagnosis.settings import Settings as Diagnosing
from leapgap.errors import InputError
from leapgap.reports.verdict_jobs import Job, run_jobs
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot, own_model

STAGE = "stages.diagnose_withheld"
PUBLISHED = "published"


@dataclass(frozen=True)
class DiagnoseWithheldSettings:
    """Section ``diagnose_withheld`` of the configuration."""

    logs: str
    out: str | None
    settings: dict[str, Any]
    """Overrides of ``diagnose.settings``."""
    only: list[str] = field(default_factory=list)
    """Names of the cases; empty: all."""
    published: bool = False
    pages: bool = True


def diagnose_withheld(config: DictConfig) -> None:
    """Diagnose the cases without a valid verdict; remove the verdicts of cases that no longer exist."""
    settings = read_config(DiagnoseWithheldSettings, config.diagnose_withheld, "diagnose_withheld")
    executor = read_config(Executor, config.executor, "executor")
    out = output_folder(settings.out, STAGE, (settings.logs, config.robot.model), kept=True)
    logs, cache = Path(settings.logs), ResultCache(out)
    if not logs.is_dir():
        raise InputError(logs, "no such folder", "withheld logs, one folder a case", "run stages.withhold first")
    folders = (path.name for path in sorted(logs.iterdir()) if path.is_dir())
    cases = [name for name in folders if settings.published or name != PUBLISHED]
    unknown = set(settings.only) - set(cases)
    if unknown:
        raise InputError("diagnose_withheld.only", ", ".join(sorted(unknown)), "names of cases", "correct them")
    own = diagnosis_settings(config, settings.settings)
    robot = load_robot(config).path
    jobs = [
        Job(name, logs / name, own_model(logs / name) or robot, own, pages=settings.pages)
        for name in settings.only or cases
    ]
    claim_folder(out, STAGE)
    for name in cases:
        cache.expect(name)
    for job in jobs:
        cache.expect(job.place, job.key)
    cache.sweep()
    run_jobs(jobs, cache, executor)


def diagnosis_settings(config: DictConfig, overrides: Mapping[str, Any]) -> Diagnosing:
    """The settings of stage ``diagnose`` with overrides, without a best simulator: answers are judged."""
    merged = OmegaConf.merge(config.diagnose.settings, overrides)
    return replace(read_config(Diagnosing, merged, "diagnose_withheld.settings"), best=False)


if __name__ == "__main__":
    run_stage(diagnose_withheld)
