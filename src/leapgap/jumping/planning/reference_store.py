"""References by target: read from a folder where they are there, else planned."""

from pathlib import Path

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.planning.problem import Grid, Problem
from leapgap.jumping.planning.reference import Gains, name_of, to_jump
from leapgap.jumping.planning.solve import solve_all
from leapgap.jumping.task import ContactSchedule, Target, schedule_of
from leapgap.logs.log import Log, read_log
from leapgap.robot.model import Robot

PUBLISHED_SCHEDULE = ContactSchedule()


def select_planar_robot(planar: str, robot: Robot) -> PlanarRobot:
    """``published``: the planar robot of the published references; ``own``: the planar form of ``robot``."""
    if planar == "published":
        return PlanarRobot()
    if planar == "own":
        return planar_robot(robot)
    raise InputError("planar", planar, "published or own", "choose one")


def reference_to(
    target: Target, folder: Path, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE
) -> Log:
    """The reference to a target: its file in ``folder`` if that has this schedule, else a new plan."""
    path = folder / f"{name_of(target)}.parquet"
    if path.is_file():
        found = read_log(path)
        if schedule_of(found) == schedule:
            return found
    return plan_reference(target, planar, schedule)


def plan_reference(target: Target, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE) -> Log:
    """Plan the reference to a target for a planar robot."""
    (solution,) = solve_all([Problem(target, Grid(schedule), planar)])
    return to_jump(solution, Gains())
