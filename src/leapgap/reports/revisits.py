"""Withheld cases diagnosed again with knowledge of their truth; the first verdicts stay as they are."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_logs, write_logs
from leapgap.reports.diagnosis import REPORT
from leapgap.reports.verdict_jobs import Job, run_jobs
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.content_hash import file_digests
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from leapgap.validation.case import CaseSetup, further_jumps, proposed_logs
from leapgap.validation.outcome import outcome
from leapgap.validation.revisits import (
    Seen,
    ablation_cases,
    ablation_result,
    experiment_cases,
    extension_result,
    is_feasible,
)
from leapgap.validation.scoring import is_missed
from leapgap.validation.seal import open_truth

Planner = Callable[[Sequence[str], str], tuple[list[Log], tuple[float, float]]]
"""References, and the range of heights of the first block, m, by settings of ``collect`` and the name of a case."""


@dataclass(frozen=True)
class RevisitSettings:
    """Section ``revisit`` of the configuration; numbers of cases, where −1 means all."""

    logs: str
    truth: str
    verdicts: str
    references: str
    planar: str
    out: str | None
    struck: int
    experiments: int
    missed: int
    further: list[str]
    """Settings of ``collect`` that make the jumps which missed cases are diagnosed with."""


@dataclass(frozen=True)
class Revisit:
    """What cases are diagnosed again with; results and logs lie in the folder of the cache."""

    settings: RevisitSettings
    diagnosing: Settings
    robot: Robot
    world: CaseSetup
    plan: Planner
    cache: ResultCache
    executor: Executor
    pages: bool

    def run(self, by: str) -> None:
        """Choose the cases, diagnose them again, and write the results; ``by``: the command that writes."""
        settings, out = self.settings, self.cache.folder
        cases = read_cases(settings, self.robot.topology.sides)
        claim_folder(out, by)
        struck, experiments, missed = (
            None if number < 0 else number for number in (settings.struck, settings.experiments, settings.missed)
        )
        ablated = ablation_cases(cases, struck)
        jobs = [
            self.job("struck", case, Path(settings.logs) / case.name, without=[case.first.true[0]]) for case in ablated
        ]
        run_jobs(jobs, self.cache, self.executor)
        results = {case.name: ablation_result(case, out / "struck") for case in ablated}
        write_json(out / "struck.json", results)
        asking = [
            (case, [str(line) for line in case.report["next_experiment"].get("collect", ())])
            for case in experiment_cases(cases, experiments)
        ]
        not_found = [(case, settings.further) for case in cases if is_missed(case.first)][:missed]
        for kind, chosen in (("experiments", asking), ("missed", not_found)):
            feasible = [(case, lines) for case, lines in chosen if is_feasible(case, lines)]
            jobs = [self.job(kind, case, self.extended(kind, case, lines)) for case, lines in feasible]
            run_jobs(jobs, self.cache, self.executor)
            results = {case.name: extension_result(case, lines, out / kind) for case, lines in feasible}
            write_json(out / f"{kind}.json", results)
        self.cache.sweep()

    def job(self, kind: str, case: Seen, logs: Path, without: Sequence[str] = ()) -> Job:
        """The diagnosis of a case from a folder of logs, without some hypotheses."""
        settings = replace(self.diagnosing, without=[*self.diagnosing.without, *without])
        return Job(f"{kind}/{case.name}", logs, self.robot.path, settings, pages=self.pages)

    def extended(self, kind: str, case: Seen, overrides: Sequence[str]) -> Path:
        """Folder of the logs of a case with further jumps, or, without overrides, with what its report proposes."""
        logs, place = Path(self.settings.logs) / case.name, f"{kind}_logs/{case.name}"
        make: Callable[[], Sequence[Log]]
        if overrides:
            inputs = (case.truth, *self.plan(overrides, case.name), self.robot, self.world)
            key = result_key(further_jumps, [inputs, file_digests(logs)])
            make = partial(further_jumps, *inputs)
        else:
            world = replace(self.world, course=replace(self.world.course, after_landing_s=0.0))
            proposal: Mapping[str, Any] = case.report["next_experiment"]["settings"]
            key = result_key(proposed_logs, [case.truth, proposal, self.robot, world, file_digests(logs)])
            make = partial(proposed_logs, case.truth, proposal, read_logs(logs), self.robot, world)
        if self.cache.get(place, key) is None:
            with self.cache.store(place, key) as folder:
                shutil.copytree(logs, folder / case.name)
                write_logs(make(), folder / case.name)
        return self.cache.folder / place


def read_cases(settings: RevisitSettings, sides: Mapping[str, str]) -> list[Seen]:
    """Read the cases with a verdict and check their seals; those of the reported half come first.

    Further jumps are planned for the pipeline's own robot, so that cases of other robots are left out.
    """
    cases: list[Seen] = []
    if not Path(settings.verdicts).is_dir():
        raise InputError(settings.verdicts, "no such folder", "verdicts", "run stages.diagnose_withheld first")
    for path in sorted(Path(settings.verdicts).glob(f"*/{REPORT}")):
        name = path.parent.name
        truth, report = open_truth(Path(settings.truth), Path(settings.logs), name), read_json(path)
        if truth["kind"] != "published" and "robot" not in truth:
            cases.append(Seen(name, truth, report, outcome(name, truth, report, None, sides)))
    return sorted(cases, key=lambda case: case.first.half)  # "reported" before "tuning"
