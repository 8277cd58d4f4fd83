"""The landing experiment that the section ``land`` describes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.experiments.landing_experiment import LandingExperiment, known
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.experiments.rig import LandSettings
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.simulation.closed_loop import Sensing
from stages.common import read_config, read_one_of, read_optional
from stages.robot import load_robot


@dataclass(frozen=True)
class Repeats:
    """How often a task of ``land.tasks`` is run."""

    repeats: int


def experiment_of(config: DictConfig, settings: LandSettings) -> LandingExperiment:
    """The experiment with these settings, on the robot and the simulated hardware of the configuration."""
    return LandingExperiment(
        settings,
        read_one_of(known(), settings.method_settings, "land.method_settings"),
        OmegaConf.to_container(config.collect.variants),
        *tasks_of(settings.tasks),
        load_robot(config),
        read_config(Sensing, config.collect.sensing, "collect.sensing"),
        read_optional(RigidBody, config.robot.get("body"), "robot.body"),
    )


def tasks_of(section: Mapping[str, Any]) -> tuple[list[JumpTask], dict[str, int]]:
    """Tasks, and the repeats of each by name; a task with no repeats is left out."""
    tasks, repeats = [], {}
    for name, values in section.items():
        own = OmegaConf.create({"name": name, **values})
        count = OmegaConf.create({"repeats": own.pop("repeats", 1)})
        repeats[name] = read_config(Repeats, count, f"land.tasks.{name}").repeats
        if repeats[name] > 0:
            tasks.append(read_config(JumpTask, own, f"land.tasks.{name}"))
    return tasks, repeats
