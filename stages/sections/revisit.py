"""The further jumps that settings of ``collect`` ask for."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.planning.reference import read_targets, reference_to, select_planar_robot
from leapgap.logs.log import Log
from leapgap.reports.revisits import RevisitSettings
from leapgap.robot.model import Robot


def planned_jumps(
    config: DictConfig, settings: RevisitSettings, robot: Robot, overrides: Sequence[str], case: str
) -> tuple[list[Log], tuple[float, float]]:
    """References of the jumps that overrides of ``collect`` ask for, and the range of heights of the first block, m."""
    own = {"target": None, "targets": config.withhold.targets, "jumps": None}
    own |= {"block_height_m": config.withhold.world.block_height_m}
    asked = OmegaConf.merge(own, OmegaConf.from_dotlist(list(overrides)).collect)
    targets = read_targets(asked.targets if asked.target is None else [asked.target], f"experiment of {case}")
    folder, planar = Path(settings.references), select_planar_robot(settings.planar, robot)
    count = int(asked.jumps or len(targets))
    low, high = asked.block_height_m
    return [reference_to(targets[i % len(targets)], folder, planar) for i in range(count)], (low, high)
