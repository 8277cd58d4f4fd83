"""Landing errors of each method in closed-loop experiments on simulated hardware that no controller knows.

Examples:

    python -m stages.land 'land.methods=[ours,joint_pd]' 'land.hardware=[worn]' land.out=landings
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.jumping.experiments.bench import TrialRunner
from leapgap.jumping.experiments.landing_experiment import FIGURES, PAGE, RUNS, TABLE, LandingExperiment, print_trial
from leapgap.jumping.experiments.method_registry import known
from leapgap.jumping.experiments.rig import LandSettings
from leapgap.jumping.experiments.scores import landing_figures, write_rows
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.runtime.atomic_io import write_json, write_text
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.runtime.output_folder import claim_folder
from leapgap.simulation.closed_loop import Sensing
from stages.common import output_folder, read_config, read_one_of, read_optional, run_stage
from stages.robot import load_robot

STAGE = "stages.land"


@dataclass(frozen=True)
class Repeats:
    """How often a task of ``land.tasks`` is run."""

    repeats: int


def land(config: DictConfig) -> dict[str, float]:
    """Run all methods on all hardware and tasks; cached results are reused. Mean errors are returned for a sweep."""
    settings = read_config(LandSettings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    experiment = experiment_of(config, settings)
    inputs = (settings.references, settings.published, settings.corrected, *settings.models.values())
    out = claim_folder(output_folder(settings.out, STAGE, (*inputs, config.robot.model), kept=True), STAGE)
    for name in (FIGURES, TABLE, PAGE):  # results of an earlier call, so that none are left if this one fails
        (out / name).unlink(missing_ok=True)
    cache, earlier = ResultCache(out / RUNS), ResultCache(Path(settings.practised or out) / RUNS)
    with executor.pool() as pool:
        runner = TrialRunner(cache, pool.map, print_trial, pool.map_last, side_by_side=True, earlier=earlier)
        scored = experiment.run(runner)
    cache.sweep()
    figures = landing_figures(scored, settings.single, settings.seed)
    rows = [row for one in scored for row in one.rows()]
    write_rows(rows, out / TABLE)
    for path in (out / FIGURES, settings.metrics):
        if path is not None:
            write_json(Path(path), figures)
    if settings.pages:
        from leapgap.jumping.reports.landing import html_of

        write_text(out / PAGE, html_of(out, settings.single))
    for key, value in figures["mean_abs_error_cm"].items():
        print(f"{key}: {value:.2f} cm over {', '.join(settings.single)}")
    if settings.pages:
        print(f"look at it: {out / PAGE}")
    return {f"mean_abs_error_cm/{name}": value for name, value in figures["mean_abs_error_cm"].items()}


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


if __name__ == "__main__":
    run_stage(land)
