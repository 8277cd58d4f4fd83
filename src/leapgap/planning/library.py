"""References by target: from a folder of planned ones, or planned on the spot."""

from pathlib import Path

from leapgap.planning.formulation import Problem
from leapgap.planning.reference import Gains, name_of, to_jump
from leapgap.planning.solve import solve_all
from leapgap.recording.jump import Jump, Target, read
from leapgap.robot.model import Robot
from leapgap.robot.planar import planar_robot


def reference_to(target: Target, folder: Path, robot: Robot) -> Jump:
    """The reference to a target: its file in ``folder`` where there is one, else planned for the robot itself."""
    path = folder / f"{name_of(target)}.parquet"
    if path.is_file():
        return read(path)
    (solution,) = solve_all([Problem(target, robot=planar_robot(robot))])
    return to_jump(solution, Gains())
