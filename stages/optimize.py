"""Plan jumps to the configured targets and write one reference per target as a jump log.

Examples:

    python -m stages.optimize 'optimize.targets=[[0.55,0.0],[0.5,0.1]]' optimize.out=references
    python -m stages.optimize robot=go2 'optimize.targets=[[0.4,0.0]]' optimize.out=references
"""

from pathlib import Path

from omegaconf import DictConfig

from leapgap.jumping.models.planar import planar_robot_with
from leapgap.jumping.planning.reference import OptimizeSettings, plan_all, read_targets, select_planar_robot, write_all
from leapgap.simulation.corrected import read_corrected
from stages.common import output_folder, read_config, run_stage
from stages.robot import load_robot

STAGE = "stages.optimize"


def optimize(config: DictConfig) -> dict[str, float]:
    """Solve all targets; write references, index, solution times and, where a file is named, metrics."""
    settings = read_config(OptimizeSettings, config.optimize, "optimize")
    targets = read_targets(settings.targets, "optimize.targets")
    out = output_folder(settings.out, STAGE, (settings.robot, config.robot.model))
    corrected = settings.robot and planar_robot_with(*read_corrected(Path(settings.robot)))
    planar = corrected or select_planar_robot(settings.planar, load_robot(config))
    return write_all(plan_all(settings.problems(targets, planar)), settings, out, STAGE)


if __name__ == "__main__":
    run_stage(optimize)
