"""Diagnose cases again with knowledge of their truth: with the true effect ablated, and with further jumps.

The first verdicts stay as they are.

Examples:

    python -m stages.revisit revisit.struck=2 revisit.out=revisits
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.diagnosis.settings import Settings as Diagnosing
from leapgap.errors import InputError
from leapgap.jumping.planning.batch import read_targets
from leapgap.jumping.planning.reference_store import reference_to, select_planar_robot
from leapgap.logs import log as jump_log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.runtime.content_hash import file_digests
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from leapgap.validation.case import CaseSetup, further_jumps
from leapgap.validation.experiments import UNMADE, proposed_logs
from leapgap.validation.outcome import CLAIMS, CaseOutcome, outcome
from leapgap.validation.scoring import is_missed
from leapgap.validation.seal import open_truth
from stages.common import output_folder, read_config, run_stage
from stages.diagnose_withheld import Job, diagnosis_settings, run_jobs
from stages.robot import load_robot

STAGE = "stages.revisit"
RUNNABLE = ("target", "targets", "jumps", "block_height_m")
"""Settings of ``collect`` that the generator can follow for the robot of a case."""


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
class Seen:
    """A case with its truth, its report and the outcome of its first verdict."""

    name: str
    truth: Mapping[str, Any]
    report: Mapping[str, Any]
    first: CaseOutcome


def revisit(config: DictConfig) -> None:
    """Choose the cases, diagnose them again, and write the results."""
    settings = read_config(RevisitSettings, config.revisit, "revisit")
    executor = read_config(Executor, config.executor, "executor")
    inputs = (settings.logs, settings.truth, settings.verdicts, settings.references, config.robot.model)
    cache = ResultCache(output_folder(settings.out, STAGE, inputs, kept=True))
    robot = load_robot(config)
    cases = read_cases(settings, robot.topology.sides)
    base = diagnosis_settings(config, config.diagnose_withheld.settings)
    claim_folder(cache.folder, STAGE)
    ablated = ablation_cases(cases, settings.struck)
    jobs = [
        Job(
            f"struck/{case.name}",
            Path(settings.logs) / case.name,
            robot.path,
            without(base, case.first.true[0]),
            pages=config.diagnose_withheld.pages,
        )
        for case in ablated
    ]
    run_jobs(jobs, cache, executor)
    folder = cache.folder / "struck"
    write_json(cache.folder / "struck.json", {case.name: ablation_result(case, folder) for case in ablated})
    experiments = [(case, proposed_experiment(case)) for case in experiment_cases(cases, settings.experiments)]
    missed = [(case, settings.further) for case in missed_cases(cases, settings.missed)]
    for kind, chosen in (("experiments", experiments), ("missed", missed)):
        feasible = [(case, lines) for case, lines in chosen if is_feasible(case, lines)]
        logs = [
            make_experiment(f"{kind}_logs/{case.name}", case, lines, config, settings, robot, cache)
            for case, lines in feasible
        ]
        jobs = [
            Job(f"{kind}/{case.name}", folder, robot.path, base, pages=config.diagnose_withheld.pages)
            for (case, _), folder in zip(feasible, logs, strict=True)
        ]
        run_jobs(jobs, cache, executor)
        results = {case.name: extension_result(case, lines, cache.folder / kind) for case, lines in feasible}
        write_json(cache.folder / f"{kind}.json", results)
    cache.sweep()


def read_cases(settings: RevisitSettings, sides: Mapping[str, str]) -> list[Seen]:
    """Read the cases with a verdict and check their seals; those of the reported half come first.

    Further jumps are planned for the pipeline's own robot, so that cases of other robots are left out.
    """
    cases: list[Seen] = []
    if not Path(settings.verdicts).is_dir():
        raise InputError(settings.verdicts, "no such folder", "verdicts", "run stages.diagnose_withheld first")
    for path in sorted(Path(settings.verdicts).glob("*/report.json")):
        name = path.parent.name
        truth, report = open_truth(Path(settings.truth), Path(settings.logs), name), read_json(path)
        if truth["kind"] != "published" and "robot" not in truth:
            cases.append(Seen(name, truth, report, outcome(name, truth, report, None, sides)))
    return sorted(cases, key=lambda case: case.first.half)  # "reported" before "tuning"


def ablation_cases(cases: list[Seen], number: int) -> list[Seen]:
    """Cases of detectable single effects that were named first: one per effect, at most ``number`` (−1: all)."""
    chosen: dict[str, Seen] = {}
    for case in cases:
        first = case.first
        if first.kind == "single" and first.detectable and first.first == first.true[0]:
            chosen.setdefault(first.true[0], case)
    return at_most(number, list(chosen.values()))


def at_most(number: int, cases: list[Seen]) -> list[Seen]:
    """The first ``number`` cases; all of them where it is −1."""
    return cases if number < 0 else cases[:number]


def without(settings: Diagnosing, effect: str) -> Diagnosing:
    """The diagnosis's settings without one hypothesis."""
    return replace(settings, without=[*settings.without, effect])


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


def experiment_cases(cases: list[Seen], number: int) -> list[Seen]:
    """Cases of detectable effects of the table with an ambiguous verdict that proposes further jumps."""
    asking = [
        case
        for case in cases
        if case.first.kind in ("single", "pair", "triple")
        and case.first.verdict == "ambiguous"
        and case.first.detectable
        and is_runnable(case.report.get("next_experiment") or {})
    ]
    return at_most(number, asking)


def is_runnable(proposal: Mapping[str, Any]) -> bool:
    """Whether the generator can make a proposal: by settings of ``collect``, or without new sensors."""
    return bool(proposal.get("collect")) or proposal.get("settings", {}).get("kind", UNMADE[0]) not in UNMADE


def proposed_experiment(case: Seen) -> list[str]:
    """The next experiment that a report proposes, as settings of ``collect``; empty for another experiment."""
    return [str(line) for line in case.report["next_experiment"].get("collect", ())]


def missed_cases(cases: list[Seen], number: int) -> list[Seen]:
    """Cases in which an effect of the table shows and was not found (``scoring.is_missed``)."""
    return at_most(number, [case for case in cases if is_missed(case.first)])


def is_feasible(case: Seen, overrides: list[str]) -> bool:
    """Whether the generator can make the proposed jumps with the robot of the case."""
    keys = [line.split("=", 1)[0].removeprefix("collect.") for line in overrides]
    if set(keys) <= set(RUNNABLE):
        return True
    print(f"{case.name}: cannot make {', '.join(overrides)}", flush=True)
    return False


def make_experiment(
    place: str,
    case: Seen,
    overrides: list[str],
    config: DictConfig,
    settings: RevisitSettings,
    robot: Robot,
    cache: ResultCache,
) -> Path:
    """Generate further jumps of a case, or what its report proposes; return the folder of all its logs."""
    if not overrides:
        return make_proposal(place, case, config, settings, robot, cache)
    own = {"target": None, "targets": config.withhold.targets, "jumps": None}
    own |= {"block_height_m": config.withhold.world.block_height_m}
    experiment = OmegaConf.merge(own, OmegaConf.from_dotlist(overrides).collect)
    targets = read_targets(
        experiment.targets if experiment.target is None else [experiment.target], f"experiment of {case.name}"
    )
    count = int(experiment.jumps or len(targets))
    planned, planar = Path(settings.references), select_planar_robot(settings.planar, robot)
    references = [reference_to(targets[i % len(targets)], planned, planar) for i in range(count)]
    low, high = experiment.block_height_m
    inputs = (
        case.truth,
        references,
        (low, high),
        robot,
        read_config(CaseSetup, config.withhold.world, "withhold.world"),
    )
    logs = Path(settings.logs) / case.name
    key = result_key(further_jumps, [inputs, file_digests(logs)])
    if cache.get(place, key) is None:
        with cache.store(place, key) as made:
            shutil.copytree(logs, made / case.name)
            for jump in further_jumps(*inputs):
                jump_log.write_log(jump, made / case.name / f"{jump.name}.parquet")
    return cache.folder / place


def make_proposal(
    place: str, case: Seen, config: DictConfig, settings: RevisitSettings, robot: Robot, cache: ResultCache
) -> Path:
    """Make the experiment that a report proposes with the case's robot; return the folder of all logs."""
    world = read_config(CaseSetup, config.withhold.world, "withhold.world")
    world = replace(world, course=replace(world.course, after_landing_s=0.0))
    proposal, logs = case.report["next_experiment"]["settings"], Path(settings.logs) / case.name
    key = result_key(proposed_logs, [case.truth, proposal, robot, world, file_digests(logs)])
    if cache.get(place, key) is None:
        with cache.store(place, key) as made:
            shutil.copytree(logs, made / case.name)
            for log in proposed_logs(case.truth, proposal, jump_log.read_logs(logs), robot, world):
                jump_log.write_log(log, made / case.name / f"{log.name}.parquet")
    return cache.folder / place


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


if __name__ == "__main__":
    run_stage(revisit)
