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
from leapgap.validation.outcome import CLAIMS, CaseOutcome, outcome
from leapgap.validation.scoring import is_missed
from leapgap.validation.seal import open_truth

UNMADE = ("sensor", "jumps")  # kinds that cannot be made: the generator has no further sensors and plans no jumps
RUNNABLE = ("target", "targets", "jumps", "block_height_m")  # settings of ``collect`` it can follow


@dataclass(frozen=True)
class Seen:
    """A case with its truth, its report and the outcome of its first verdict."""

    name: str
    truth: Mapping[str, Any]
    report: Mapping[str, Any]
    first: CaseOutcome


def ablation_result(case: Seen, folder: Path) -> dict[str, Any]:
    """Result of a diagnosis without the true effect.

    It is honest where the verdict is ``unknown`` or ``partly``, or the answer holds only causes that the first report
    called confusable with the true effect, and the localisation is right.
    """
    report = read_json(folder / case.name / "report.json")
    again = outcome(case.name, case.truth, report, None, case.first.sides)
    effect = case.first.true[0]
    confusable = {
        other
        for cause in case.report["causes"]
        for other in (cause["effect"], *cause["confusable_with"])
        if effect in (cause["effect"], *cause["confusable_with"])
    }
    accepted = again.verdict in ("unknown", "partly", "none") or again.answered <= confusable
    return {
        "effect": effect,
        "half": case.first.half,
        "verdict": again.verdict,
        "answer": [list(names) for names in again.answer],
        "where_right": again.where_right,
        "honest": accepted and again.verdict != "none" and again.where_right,
        "honest_mirrored": accepted and again.verdict != "none" and again.where_mirrored,
    }


def experiment_cases(cases: list[Seen], number: int | None) -> list[Seen]:
    """Cases of detectable effects of the table with an ambiguous verdict that proposes further jumps."""
    asking = []
    for case in cases:
        proposal = case.report.get("next_experiment") or {}
        made = (
            proposal.get("settings", {}).get("kind", UNMADE[0]) not in UNMADE
        )  # by the generator, without new sensors
        is_effect = case.first.kind in ("single", "pair", "triple") and case.first.detectable
        if is_effect and case.first.verdict == "ambiguous" and (proposal.get("collect") or made):
            asking.append(case)
    return asking[:number]


def is_feasible(case: Seen, overrides: list[str]) -> bool:
    """Whether the generator can make the proposed jumps with the robot of the case."""
    keys = [line.split("=", 1)[0].removeprefix("collect.") for line in overrides]
    if set(keys) <= set(RUNNABLE):
        return True
    print(f"{case.name}: cannot make {', '.join(overrides)}", flush=True)
    return False


def extension_result(case: Seen, overrides: list[str], folder: Path) -> dict[str, Any]:
    """Result of a diagnosis of the first and the further jumps together.

    ``resolved``: exactly the true effects are named. ``found``: the answer contains all of them.
    """
    again = outcome(case.name, case.truth, read_json(folder / case.name / "report.json"), None)
    return {
        "half": case.first.half,
        "truth": list(again.true),
        "collect": list(overrides),
        "settings": (case.report.get("next_experiment") or {}).get("settings"),
        "before": {"verdict": case.first.verdict, "answer": [list(names) for names in case.first.answer]},
        "verdict": again.verdict,
        "answer": [list(names) for names in again.answer],
        "resolved": again.verdict == "named" and again.answered == set(again.true),
        "found": again.verdict in CLAIMS and set(again.true) <= again.answered,
    }


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
    further: list[str]  # settings of ``collect`` that make the jumps which missed cases are diagnosed with


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
        # Read the cases with a verdict and check their seals; those of the reported half come first
        cases: list[Seen] = []
        if not Path(settings.verdicts).is_dir():
            raise InputError(settings.verdicts, "no such folder", "verdicts", "run stages.diagnose_withheld first")
        for path in sorted(Path(settings.verdicts).glob(f"*/{REPORT}")):
            name = path.parent.name
            truth, report = open_truth(Path(settings.truth), Path(settings.logs), name), read_json(path)
            if truth["kind"] != "published" and "robot" not in truth:
                cases.append(Seen(name, truth, report, outcome(name, truth, report, None, self.robot.topology.sides)))
        cases = sorted(cases, key=lambda case: case.first.half)
        claim_folder(out, by)
        struck, experiments, missed = (
            None if number < 0 else number for number in (settings.struck, settings.experiments, settings.missed)
        )
        # Cases of detectable single effects that were named first: one per effect, at most ``number`` (None: all)
        named_first: dict[str, Seen] = {}
        for case in cases:
            first = case.first
            if first.kind == "single" and first.detectable and first.first == first.true[0]:
                named_first.setdefault(first.true[0], case)
        ablated = list(named_first.values())[:struck]
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
