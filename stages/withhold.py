"""Generate cases whose cause is withheld: logs for the diagnosis, sealed truths for the score.

Examples:

    python -m stages.withhold size=tiny withhold.logs=withheld/logs withhold.truth=withheld/truth
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from leapgap.atomic_io import write_json
from leapgap.executor import Executor
from leapgap.jumping.planning.batch import read_targets
from leapgap.jumping.planning.reference_store import reference_to, select_planar_robot
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.output_folder import whole_folder
from leapgap.robot.model import Robot
from leapgap.validation.case import CaseSetup, published_case, withhold, write_case
from leapgap.validation.case_draw import Case, Further, FurtherCounts, Half, draw_cases
from leapgap.validation.seal import SEALS, seal
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.withhold"
PUBLISHED = "published"
"""Name of the case of published jumps; it may be known, since their columns differ anyway."""


@dataclass(frozen=True)
class WithholdSettings:
    """Section ``withhold`` of the configuration."""

    logs: str | None
    truth: str | None
    references: str
    planar: str
    published: str | None
    targets: Any
    world: dict[str, Any]
    halves: dict[str, Any]
    sizes: dict[str, dict[str, list[float]]]
    signed: list[str]
    further: dict[str, Any]
    clocks: dict[str, dict[str, list[float]]]
    too_high: dict[str, dict[str, list[float]]]


def withhold_all(config: DictConfig) -> None:
    """Draw the cases, generate their jumps, and seal their truths."""
    settings = read_config(WithholdSettings, config.withhold, "withhold")
    section = config.withhold
    world = read_config(CaseSetup, section.world, "withhold.world")
    halves = {name: read_config(Half, section.halves[name], f"withhold.halves.{name}") for name in section.halves}
    executor = read_config(Executor, config.executor, "executor")
    inputs = (settings.references, settings.published, config.robot.model)
    logs_out = output_folder(settings.logs, STAGE, inputs, name="logs")
    truth_out = output_folder(settings.truth, STAGE, (*inputs, logs_out), name="truth")
    robot = load_robot(config)
    references = references_of(settings, robot)
    counts = {
        name: read_config(FurtherCounts, section.further[name], f"withhold.further.{name}") for name in section.further
    }
    further = Further(counts, settings.clocks, settings.too_high)
    cases = draw_cases(halves, settings.sizes, settings.signed, robot, further)
    names = {f"case_{i:03d}": case for i, case in enumerate(cases)}
    with whole_folder(truth_out, STAGE) as truths, whole_folder(logs_out, STAGE) as logs:
        job = partial(make_case, references=references, robot=robot, world=world, logs=logs, truths=truths)
        seals = dict(executor.map(job, list(names.items())))
        published = jump_log.read_logs(Path(settings.published)) if settings.published else []
        if len(published) > 1:
            truth = write_case(published_case(published, len(published)), logs / PUBLISHED, truths / PUBLISHED)
            seals[PUBLISHED] = write_truth(truth, truths, PUBLISHED)
        write_json(logs / SEALS, seals)
    more = " and the published jumps" if PUBLISHED in seals else ""
    print(f"{len(names)} cases{more} withheld; seals: {logs_out / SEALS}")


def references_of(settings: WithholdSettings, robot: Robot) -> list[Log]:
    """The planned jumps to all targets."""
    folder, planar = Path(settings.references), select_planar_robot(settings.planar, robot)
    return [reference_to(target, folder, planar) for target in read_targets(settings.targets, "withhold.targets")]


def make_case(
    named: tuple[str, Case], references: list[Log], robot: Robot, world: CaseSetup, logs: Path, truths: Path
) -> tuple[str, str]:
    """Write the logs and the truth of one case; return its name and seal."""
    name, case = named
    truth = write_case(withhold(case, references, robot, world), logs / name, truths / name)
    return name, write_truth(truth, truths, name)


def write_truth(truth: dict[str, Any], truths: Path, name: str) -> str:
    """Write a truth and return its seal."""
    write_json(truths / f"{name}.json", truth)
    return seal(truth)


if __name__ == "__main__":
    run_stage(withhold_all)
