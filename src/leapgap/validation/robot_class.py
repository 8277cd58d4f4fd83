"""A class of cases: a robot beside the pipeline's own, and the motion that it makes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course
from leapgap.validation.case import CaseSetup
from leapgap.validation.case_draw import Case, Half, Sizes, draw_ordinary_cases
from leapgap.validation.motions.base import PlannedMotion
from leapgap.validation.own_numbers import OwnNumbers


@dataclass(frozen=True)
class RobotClass:
    """Settings of one class: the robot, its motion, and how many cases there are."""

    model: str
    """Model file, or a name in MuJoCo Menagerie."""
    fix_base: bool | None
    """True: a floating robot is held at the pose of its model file; null: as the file has it."""
    motion: dict[str, Any]
    """Kind of a motion and its numbers."""
    world: dict[str, Any]
    """How its logs are generated, where that departs from the setup of the jumps."""
    halves: dict[str, Any]
    without: list[str]
    """Effects that are not drawn although they exist on the robot, since they change nothing of its motion."""


@dataclass(frozen=True)
class ClassCases:
    """The cases of one class with what generates them."""

    robot: Robot
    plans: Sequence[Log]
    setup: CaseSetup
    cases: Sequence[Case]


def draw_class(
    robot: Robot,
    motion: PlannedMotion,
    setup: CaseSetup,
    halves: Mapping[str, Half],
    shares: Sizes,
    signed: Sequence[str],
    without: Sequence[str] = (),
) -> ClassCases:
    """Draw the plans and cases of one class; ``shares`` are sizes of effects as shares of the robot's own numbers.

    Effects of the table that ``without`` names are not drawn.
    """
    plans = motion.draw(robot)
    own = OwnNumbers.of(robot, motion.start(robot), motion.sample_period_s)
    setup = replace(setup, log="log", course=Course(setup.course.settle_s, after_landing_s=0.0))
    chosen = {name: of_effect for name, of_effect in shares.items() if name not in without}
    return ClassCases(robot, plans, setup, draw_ordinary_cases(halves, chosen, signed, robot, own))
