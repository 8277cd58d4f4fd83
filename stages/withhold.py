"""Generate cases whose cause is withheld: logs for the diagnosis, sealed truths for the score.

Examples:

    python -m stages.withhold size=tiny withhold.logs=withheld/logs withhold.truth=withheld/truth
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.planning.batch import read_targets
from leapgap.jumping.planning.reference_store import reference_to, select_planar_robot
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.self_contained import self_contained
from leapgap.runtime.atomic_io import sha256, write_json, write_text
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import whole_folder
from leapgap.validation.case import CaseSetup, ChosenCase, published_case, withhold, write_case
from leapgap.validation.case_draw import Case, Further, FurtherCounts, Half, draw_cases
from leapgap.validation.motions import known
from leapgap.validation.owners.cases import OwnersCase, OwnersHalf, draw_owners, write_owners_case
from leapgap.validation.robot_class import ClassCases, RobotClass, draw_class
from leapgap.validation.seal import SEALS, seal
from stages.common import CONF, find_model, output_folder, read_config, read_one_of, run_stage
from stages.robot import MODEL, load_robot

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
    chosen: list[Any]
    """Cases that are not drawn, each a ``ChosenCase``."""
    further: dict[str, Any]
    clocks: dict[str, dict[str, list[float]]]
    too_high: dict[str, dict[str, list[float]]]
    robots: dict[str, Any]
    """Name of a class of cases → its ``RobotClass``."""
    shares: dict[str, dict[str, list[float]]]
    owners: dict[str, Any]
    """Half → its ``OwnersHalf``."""


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
    counts = {
        name: read_config(FurtherCounts, section.further[name], f"withhold.further.{name}") for name in section.further
    }
    further = Further(counts, settings.clocks, settings.too_high)
    chosen = [read_config(ChosenCase, own, f"withhold.chosen.{k}").case for k, own in enumerate(section.chosen)]
    cases = draw_cases(halves, settings.sizes, settings.signed, robot, further, chosen)
    names = {f"case_{i:03d}": case for i, case in enumerate(cases)}
    references = references_of(settings, robot) if cases else []
    classes = {name: read_class(name, settings, section) for name in section.robots}
    owners = [
        case
        for half, of_half in section.owners.items()
        for case in draw_owners(half, read_config(OwnersHalf, of_half, f"withhold.owners.{half}"))
    ]
    published = jump_log.read_logs(Path(settings.published)) if settings.published else []
    with whole_folder(truth_out, STAGE) as truths, whole_folder(logs_out, STAGE) as logs:
        job = partial(make_case, references=references, robot=robot, world=world, logs=logs, truths=truths)
        seals = dict(executor.map(job, list(names.items())))
        for name, own in classes.items():
            make = partial(make_class_case, name, own, self_contained(own.robot), logs, truths)
            seals |= executor.map(make, [(f"{name}_{i:03d}", case) for i, case in enumerate(own.cases)])
        own_robots = partial(make_owners_case, CONF / "withhold" / "models", logs, truths)
        seals |= executor.map(own_robots, [(f"owners_{i:03d}", case) for i, case in enumerate(owners)])
        if len(published) > 1:
            truth = write_case(published_case(published, len(published)), logs / PUBLISHED, truths / PUBLISHED)
            seals[PUBLISHED] = write_truth(truth, truths, PUBLISHED)
        write_json(logs / SEALS, seals)
    more = " and the published jumps" if PUBLISHED in seals else ""
    for name, own in classes.items():
        print(f"{name}: {len(own.cases)} cases withheld")
    if owners:
        print(f"owners: {len(owners)} cases withheld")
    print(f"{len(names)} cases{more} withheld; seals: {logs_out / SEALS}")


def references_of(settings: WithholdSettings, robot: Robot) -> list[Log]:
    """The planned jumps to all targets."""
    folder, planar = Path(settings.references), select_planar_robot(settings.planar, robot)
    return [reference_to(target, folder, planar) for target in read_targets(settings.targets, "withhold.targets")]


def read_class(name: str, settings: WithholdSettings, section: DictConfig) -> ClassCases:
    """Draw the cases of one class of ``withhold.robots``."""
    own = section.robots[name]
    chosen = read_config(RobotClass, own, f"withhold.robots.{name}")
    robot = Robot.load(find_model(chosen.model), fix_base=chosen.fix_base)
    motion = read_one_of(known(), {"motion": own.motion}, f"withhold.robots.{name}")["motion"]
    world = OmegaConf.create(OmegaConf.to_container(section.world))  # without its flag, so that keys may be added
    merged = OmegaConf.merge(world, {"block_height_m": [0.0, 0.0]}, own.world)
    setup = read_config(CaseSetup, merged, f"withhold.robots.{name}.world")
    halves = {half: read_config(Half, own.halves[half], f"withhold.robots.{name}.halves.{half}") for half in own.halves}
    return draw_class(robot, motion, setup, halves, settings.shares, settings.signed, chosen.without)


def make_class_case(
    name: str, of: ClassCases, model: str, logs: Path, truths: Path, named: tuple[str, Case]
) -> tuple[str, str]:
    """Write the logs, the model and the truth of one case of a class; return the case's name and seal."""
    case_name, case = named
    truth = write_case(withhold(case, of.plans, of.robot, of.setup), logs / case_name, truths / case_name)
    write_text(logs / case_name / MODEL, model)
    truth |= {"robot": name, "model": {MODEL: sha256(logs / case_name / MODEL)}}
    return case_name, write_truth(truth, truths, case_name)


def make_case(
    named: tuple[str, Case], references: list[Log], robot: Robot, world: CaseSetup, logs: Path, truths: Path
) -> tuple[str, str]:
    """Write the logs and the truth of one case; return its name and seal."""
    name, case = named
    truth = write_case(withhold(case, references, robot, world), logs / name, truths / name)
    return name, write_truth(truth, truths, name)


def make_owners_case(models: Path, logs: Path, truths: Path, named: tuple[str, OwnersCase]) -> tuple[str, str]:
    """Write the logs, the model and the truth of one case of owners' errors; return its name and seal."""
    name, case = named
    return name, write_truth(write_owners_case(case, models, logs / name, truths / name), truths, name)


def write_truth(truth: dict[str, Any], truths: Path, name: str) -> str:
    """Write a truth and return its seal."""
    write_json(truths / f"{name}.json", truth)
    return seal(truth)


if __name__ == "__main__":
    run_stage(withhold_all)
