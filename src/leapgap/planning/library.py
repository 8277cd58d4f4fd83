"""References by target: from a folder of planned ones, or planned on the spot; and for which robot."""

from pathlib import Path

from leapgap.errors import InputError
from leapgap.planning.problem import Grid, Problem
from leapgap.planning.reference import Gains, name_of, to_jump
from leapgap.planning.solve import solve_all
from leapgap.recording.jump import Jump, Target, read
from leapgap.robot.model import Robot
from leapgap.robot.planar import PlanarRobot, planar_robot
from leapgap.robot.schedule import ContactSchedule

PUBLISHED_SCHEDULE = ContactSchedule()


def planned_robot(planar: str, robot: Robot) -> PlanarRobot:
    """``published``: the planar robot of the published references; ``own``: the planar form of ``robot``."""
    if planar == "published":
        return PlanarRobot()
    if planar == "own":
        return planar_robot(robot)
    raise InputError("planar", planar, "published or own", "choose one")


def reference_to(
    target: Target, folder: Path, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE
) -> Jump:
    """The reference to a target: its file in ``folder`` where there is one of this schedule, else planned now."""
    path = folder / f"{name_of(target)}.parquet"
    if path.is_file():
        found = read(path)
        if found.info.schedule == schedule:
            return found
    return planned(target, planar, schedule)


def planned(target: Target, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE) -> Jump:
    """The reference to a target for a planar robot, planned now."""
    (solution,) = solve_all([Problem(target, Grid(schedule), planar)])
    return to_jump(solution, Gains())
