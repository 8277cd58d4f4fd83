"""Simulated jumps as jump logs: references tracked by hardware with effects its controller does not know."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from leapgap import effects
from leapgap.errors import InputError
from leapgap.files import whole_folder
from leapgap.planning.batch import read_targets
from leapgap.planning.library import reference_to
from leapgap.recording import jump as jump_log
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import read_corrected
from leapgap.simulation.hardware import Course, Plan, SensorNoise, landing_error_cm, make_jumps
from stages.common import output_folder, read_config, run_stage


@dataclass(frozen=True)
class Settings:
    """Section ``collect``."""

    references: str
    robot: str | None
    hardware: str
    jumps: int
    target: Any
    targets: Any
    block_height_m: tuple[float, float]
    seed: int
    out: str | None
    noise: SensorNoise = field(default_factory=SensorNoise)
    course: Course = field(default_factory=Course)
    variants: dict[str, Any] = field(default_factory=dict)


def collect(config: DictConfig) -> None:
    """Let the chosen hardware make the configured jumps."""
    settings = read_config(Settings, config.collect, "collect")
    robot = Robot.load(config.robot.model)
    on_top: tuple[effects.Effect, ...] = ()
    if settings.robot is not None:
        robot, on_top = read_corrected(Path(settings.robot))
    if settings.hardware not in settings.variants:
        raise InputError(
            "collect.hardware", settings.hardware, f"one of {', '.join(settings.variants)}", "choose a known variant"
        )
    hidden = effects.from_config(settings.variants[settings.hardware]["effects"])
    listed = settings.targets if settings.target is None else [settings.target]
    targets = read_targets(listed, "collect.targets")
    references = {target: reference_to(target, Path(settings.references), robot) for target in targets}
    rng = np.random.default_rng(settings.seed)
    plans = [
        Plan(
            f"{settings.hardware}_{i:02d}",
            references[targets[i % len(targets)]],
            round(float(rng.uniform(*settings.block_height_m)), 4),
        )
        for i in range(settings.jumps)
    ]
    jumps = make_jumps(plans, robot, (*on_top, *hidden), settings.noise, settings.course, rng)
    with whole_folder(output_folder(settings.out)) as folder:
        for plan, jump in zip(plans, jumps, strict=True):
            jump_log.write(jump, folder / f"{jump.name}.parquet")
            print(
                f"{jump.name}: {jump.info.target.x_m:.2f} m from a {100 * plan.block_height_m:.1f} cm block, "
                f"lands {landing_error_cm(jump):+.1f} cm short"
            )


if __name__ == "__main__":
    run_stage(collect)
