"""The robot that the section ``robot`` of the configuration describes."""

from dataclasses import dataclass, field
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from leapgap.robot.model import Robot
from leapgap.robot.topology import PartNames
from stages.common import read_config


@dataclass(frozen=True)
class RobotSettings:
    """Section ``robot`` of the configuration, without ``body``, which controllers read."""

    model: str
    fix_base: bool | None = None
    feet: list[str] = field(default_factory=list)


def load_robot(config: DictConfig, model: str | Path | None = None) -> Robot:
    """The configured robot, or another model file read by the same settings; its notes are printed."""
    section = OmegaConf.masked_copy(config.robot, [key for key in config.robot if key != "body"])
    settings = read_config(RobotSettings, section, "robot")
    names = PartNames(feet=tuple(settings.feet)) if settings.feet else None
    robot = Robot.load(model or settings.model, names=names, fix_base=settings.fix_base)
    for note in robot.notes:
        print(f"{robot.path}: {note}", flush=True)
    return robot
