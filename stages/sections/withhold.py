"""The cases that the section ``withhold`` describes."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.planning.reference import read_targets, reference_to, select_planar_robot
from leapgap.logs.log import Log, read_logs
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course
from leapgap.validation.case import CaseSetup, ChosenCase
from leapgap.validation.case_draw import FurtherCounts, FurtherKinds, Half, OwnNumbers, draw_cases, draw_ordinary_cases
from leapgap.validation.motions import MOTIONS
from leapgap.validation.owners.cases import OwnersHalf, draw_owners
from leapgap.validation.withholding import ClassCases, DrawnCases
from stages.common import CONF, find_model, read_config, read_each, read_one_of


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
    chosen: list[Any]  # cases that are not drawn, each a ``ChosenCase``
    further: dict[str, Any]
    clocks: dict[str, dict[str, list[float]]]
    too_high: dict[str, dict[str, list[float]]]
    robots: dict[str, Any]  # name of a class of cases → its ``RobotClass``
    shares: dict[str, dict[str, list[float]]]
    owners: dict[str, Any]  # half → its ``OwnersHalf``


@dataclass(frozen=True)
class RobotClass:
    """Settings of one class: the robot, its motion, and how many cases there are."""

    model: str  # model file, or a name in MuJoCo Menagerie
    fix_base: bool | None  # true: a floating robot is held at the pose of its model file; null: as the file has it
    motion: dict[str, Any]  # kind of a motion and its numbers
    world: dict[str, Any]  # how its logs are generated, where that departs from the setup of the jumps
    halves: dict[str, Any]
    without: list[str]  # effects that are not drawn, since they change nothing of the robot's motion


def draw_all(settings: WithholdSettings, section: DictConfig, robot: Robot) -> DrawnCases:
    """Draw all cases, and plan the jumps of ``robot``."""
    halves = read_each(Half, section.halves, "withhold.halves")
    counts = read_each(FurtherCounts, section.further, "withhold.further")
    further = FurtherKinds(counts, settings.clocks, settings.too_high)
    chosen = [read_config(ChosenCase, own, f"withhold.chosen.{k}").case for k, own in enumerate(section.chosen)]
    cases = draw_cases(halves, settings.sizes, settings.signed, robot, further, chosen)
    owners = read_each(OwnersHalf, section.owners, "withhold.owners").items()
    return DrawnCases(
        robot,
        read_config(CaseSetup, section.world, "withhold.world"),
        references_of(settings, robot) if cases else [],
        cases,
        {name: read_class(name, settings, section) for name in section.robots},
        [case for half, of_half in owners for case in draw_owners(half, of_half)],
        CONF / "withhold" / "models",
        read_logs(Path(settings.published)) if settings.published else [],
    )


def references_of(settings: WithholdSettings, robot: Robot) -> list[Log]:
    """The planned jumps to all targets."""
    folder, planar = Path(settings.references), select_planar_robot(settings.planar, robot)
    return [reference_to(target, folder, planar) for target in read_targets(settings.targets, "withhold.targets")]


def read_class(name: str, settings: WithholdSettings, section: DictConfig) -> ClassCases:
    """Draw the cases of one class of ``withhold.robots``."""
    own = section.robots[name]
    chosen = read_config(RobotClass, own, f"withhold.robots.{name}")
    robot = Robot.load(find_model(chosen.model), fix_base=chosen.fix_base)
    motion = read_one_of(MOTIONS, {"motion": own.motion}, f"withhold.robots.{name}")["motion"]
    world = OmegaConf.create(OmegaConf.to_container(section.world))  # without its flag, so that keys may be added
    merged = OmegaConf.merge(world, {"block_height_m": [0.0, 0.0]}, own.world)
    setup = read_config(CaseSetup, merged, f"withhold.robots.{name}.world")
    halves = read_each(Half, own.halves, f"withhold.robots.{name}.halves")
    setup = replace(setup, log="log", course=Course(setup.course.settle_s, after_landing_s=0.0))
    shares = {effect: of_effect for effect, of_effect in settings.shares.items() if effect not in chosen.without}
    numbers = OwnNumbers.of(robot, motion.start(robot), motion.sample_period_s)
    cases = draw_ordinary_cases(halves, shares, settings.signed, robot, numbers)
    return ClassCases(robot, motion.draw(robot), setup, cases)
