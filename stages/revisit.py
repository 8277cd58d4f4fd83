"""Diagnose cases again with knowledge of their truth: with the true effect ablated, and with further jumps.

The first verdicts stay as they are.

Examples:

    python -m stages.revisit revisit.struck=2 revisit.out=revisits
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

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
from leapgap.validation.experiments import proposed_logs
from leapgap.validation.outcome import outcome
from leapgap.validation.revisits import (
    Seen,
    ablation_cases,
    ablation_result,
    experiment_cases,
    extension_result,
    is_feasible,
    missed_cases,
    proposed_experiment,
    without,
)
from leapgap.validation.seal import open_truth
from stages.common import output_folder, read_config, run_stage
from stages.diagnose_withheld import Job, diagnosis_settings, run_jobs
from stages.robot import load_robot

STAGE = "stages.revisit"


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


if __name__ == "__main__":
    run_stage(revisit)
