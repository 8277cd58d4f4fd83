"""Plan jumps to the configured targets and write one reference per target as a jump log.

Examples:

    python -m stages.optimize 'optimize.targets=[[0.55,0.0],[0.5,0.1]]' optimize.out=references
    python -m stages.optimize robot=go2 'optimize.targets=[[0.4,0.0]]' optimize.out=references
"""

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.models.corrected_robot import planar_robot_with
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.batch import metrics, read_targets, timing, write_references
from leapgap.jumping.planning.problem import Grid, Limits, Problem, Weights
from leapgap.jumping.planning.reference import Gains, name_of
from leapgap.jumping.planning.reference_store import select_planar_robot
from leapgap.jumping.planning.solve import solve_all
from leapgap.jumping.task import ContactSchedule
from leapgap.runtime.atomic_io import write_json
from leapgap.runtime.output_folder import whole_folder
from leapgap.simulation.corrected import read_corrected
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.optimize"


def optimize(config: DictConfig) -> dict[str, float]:
    """Solve all targets; write references, index, solution times and, where a file is named, metrics."""
    section = config.optimize
    grid = Grid(read_config(ContactSchedule, section.schedule, "optimize.schedule"))
    weights = read_config(Weights, section.weights, "optimize.weights")
    limits = read_config(Limits, section.limits, "optimize.limits")
    gains = read_config(Gains, section.gains, "optimize.gains")
    targets = read_targets(OmegaConf.to_container(section).get("targets"), "optimize.targets")
    out = output_folder(section.out, STAGE, (section.robot, config.robot.model))
    planar = planar_of(section, config)
    problems = [Problem(target, grid, planar, weights, limits) for target in targets]
    solutions = []
    for solution in solve_all(problems):
        solutions.append(solution)
        print(
            f"{name_of(solution.problem.target)}: cost {solution.cost:.1f}, "
            f"{solution.iterations} iterations, {solution.seconds:.2f} s",
            flush=True,
        )
    with whole_folder(out, STAGE) as folder:
        write_references(solutions, folder, gains)
        if section.timing == "beside":
            write_json(folder / "timing.json", timing(solutions))
    if section.timing not in (None, "beside"):
        write_json(Path(section.timing), timing(solutions))
    if section.metrics is not None:
        write_json(Path(section.metrics), metrics(solutions))
    print(f"{len(solutions)} references in {out}")
    return {f"cost/{name_of(one.problem.target)}": float(one.cost) for one in solutions}


def planar_of(section: DictConfig, config: DictConfig) -> PlanarRobot:
    """Planar robot of the configured robot, or of a corrected robot with the effects of a diagnosis."""
    if section.robot is None:
        return select_planar_robot(section.planar, load_robot(config))
    return planar_robot_with(*read_corrected(Path(section.robot)))


if __name__ == "__main__":
    run_stage(optimize)
