"""References by target: read from a folder where they are there, else planned."""

from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.planning.problem import Grid, Problem
from leapgap.jumping.planning.reference import Gains, name_of, to_jump
from leapgap.jumping.planning.solve import solve_all
from leapgap.jumping.task import ContactSchedule, Target, schedule_of
from leapgap.logs.log import Log, read_log
from leapgap.robot.model import Robot

PUBLISHED_SCHEDULE = ContactSchedule()
SAME_LENGTH, SAME_MASS = 0.05, 0.1
"""Largest relative differences of wheelbase, lengths of links and mass between two models of one robot."""


def select_planar_robot(planar: str | None, robot: Robot) -> PlanarRobot:
    """The planar robot to plan a jump of ``robot`` with; ``InputError`` for a robot that has none.

    ``published``: that of the published references, for the robot that they are of and no other. ``own``: the planar
    form of ``robot``. None: the published one where ``robot`` is of it, else its own.
    """
    own, published = planar_robot(robot), PlanarRobot()
    if planar == "own":
        return own
    if planar not in ("published", None):
        raise InputError("planar", planar, "published, own or null", "choose one")
    if is_same_robot(own, published):
        return published
    if planar is None:
        return own
    found = f"published, whose plans are of the {published.name} with {published.total_mass:.1f} kg"
    raise InputError("planar", found, f"own: {robot.path} is another robot, {own.total_mass:.1f} kg", "choose own")


def is_same_robot(one: PlanarRobot, other: PlanarRobot) -> bool:
    """Whether joints are the same, and lengths and mass differ by no more than those of two models of one robot."""
    if set(one.joints) != set(other.joints):
        return False
    lengths = np.array([[robot.wheelbase, *link_lengths(robot)] for robot in (one, other)])
    return bool(
        np.allclose(lengths[0], lengths[1], rtol=SAME_LENGTH)
        and np.isclose(one.total_mass, other.total_mass, rtol=SAME_MASS)
    )


def link_lengths(robot: PlanarRobot) -> list[float]:
    """Lengths of front thigh and calf and rear thigh and calf, m."""
    return [link.length for leg in robot.legs for link in (leg.thigh, leg.calf)]


def reference_to(
    target: Target, folder: Path, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE
) -> Log:
    """The reference to a target: its file in ``folder`` if that has this robot and schedule, else a new plan."""
    path = folder / f"{name_of(target)}.parquet"
    if path.is_file():
        found = read_log(path)
        if schedule_of(found) == schedule and found.info.robot == planar.name:
            return found
    return plan_reference(target, planar, schedule)


def plan_reference(target: Target, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE) -> Log:
    """Plan the reference to a target for a planar robot."""
    (solution,) = solve_all([Problem(target, Grid(schedule), planar)])
    return to_jump(solution, Gains())
