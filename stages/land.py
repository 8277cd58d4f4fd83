"""Where each method lands: closed-loop experiments on simulated hardware that no controller knows."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.control.exported import load
from leapgap.control.planner import MpcConfig
from leapgap.effects import to_config
from leapgap.errors import InputError
from leapgap.executor import Executor
from leapgap.experiment.aimed import JumpPlanner
from leapgap.experiment.aiming import LandingModel
from leapgap.experiment.matrix import AdaptConfig, Bench, Done, Trial, adapted, all_trials, best_shift, practised
from leapgap.experiment.methods import ByAiming, ByJointPd, ByMpc, Method, References
from leapgap.experiment.practice import Learned, PracticeConfig
from leapgap.experiment.scores import Scored, overall, tables
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import World
from leapgap.files import whole_folder, write_json
from leapgap.planning.library import reference_to
from leapgap.recording import jump as jump_log
from leapgap.recording.jump import Jump, Target
from leapgap.recording.windows import Purpose, TimeGrid
from leapgap.robot.model import Robot
from leapgap.robot.nominal import RigidBodyModel
from leapgap.robot.planar import planar_robot
from leapgap.robot.prediction import PredictionModel
from leapgap.robot.schedule import ContactSchedule
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.variants import Variant
from stages.common import output_folder, read_config, run_stage

VARIABLE, FIXED, FIXED_22 = TimeGrid(0.025, 0.1, 10), TimeGrid(0.025, 0.025, 10), TimeGrid(0.025, 0.025, 22)
OURS = ("ours", "ours_adapted")


@dataclass(frozen=True)
class Settings:
    """Section ``land``."""

    references: str
    models: str
    fixed_models: str
    model: str
    hardware: list[str]
    methods: list[str]
    seed: int
    out: str | None
    metrics: str | None
    single: list[str]
    tasks: dict[str, Any]
    mpc: MpcConfig = field(default_factory=MpcConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    adapt: AdaptConfig = field(default_factory=AdaptConfig)


def land(config: DictConfig) -> None:
    """Run the matrix on every hardware."""
    settings = read_config(Settings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    out = output_folder(settings.out)
    tasks, repeats = tasks_of(settings.tasks)
    scored: list[Scored] = []
    with whole_folder(out) as folder:
        for name in settings.hardware:
            rig = Rig(settings, config, name, list(tasks), executor)
            done = rig.run(list(tasks), repeats, folder / "logs" / name.replace(":", "_"))
            scored += done
            write_json(folder / f"{name.replace(':', '_')}.json", {"runs": [one.to_json() for one in done]})
        means = overall(scored, settings.single)
        found = tables(scored, settings.seed) | {"mean_abs_error_cm": means, "seed": settings.seed}
        write_json(folder / "landing.json", found)
    if settings.metrics is not None:
        write_json(Path(settings.metrics), found)
    for key, value in means.items():
        print(f"{key}: {value:.2f} cm over {', '.join(settings.single)}")


class Rig:
    """One hardware with everything its trials need; methods are prepared when they are asked for."""

    def __init__(self, settings: Settings, config: DictConfig, hardware: str, tasks: list[Task], executor: Executor):
        self.settings, self.executor, self.tasks = settings, executor, tasks
        self.robot = Robot.load(config.robot.model)
        variant, _, number = hardware.partition(":")
        variants = OmegaConf.to_container(config.collect.variants)
        if not isinstance(variants, dict) or variant not in variants:
            raise InputError("land.hardware", hardware, f"one of {', '.join(variants)}", "choose a known variant")
        effects = Variant(**variants[variant]).drawn(int(number or 0))
        references: References = {task.target: self.plan(task.target) for task in tasks}
        world = World(self.robot, read_config(Sensing, config.collect.sensing, "collect.sensing"))
        self.bench = Bench(variant, effects, world, references, seed=settings.seed + int(number or 0))

    def plan(self, target: Target) -> Jump:
        """A plan from level ground."""
        return reference_to(target, Path(self.settings.references), planar_robot(self.robot))

    def map(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
        """In processes, as configured."""
        return self.executor.map(function, items)

    def run(self, tasks: list[Task], repeats: Mapping[str, int], logs: Path) -> list[Scored]:
        """Every method at every task; the log of each first run is kept."""
        methods = {name: method for name in self.settings.methods if (method := self.method(name)) is not None}
        trials = all_trials(self.bench, methods, tasks, repeats)
        scored, seen = [], set()
        for trial, done in zip(trials, self.map(Trial.done, trials), strict=True):
            scored.append(done.scored)
            if (trial.name, trial.task.name) not in seen:
                seen.add((trial.name, trial.task.name))
                log = Jump(trial.name, done.log.columns, done.log.info)
                jump_log.write(log, logs / trial.task.name / f"{trial.name}.parquet")
                print(said(done), flush=True)
        return scored

    def method(self, name: str) -> Method | None:
        """By name; None where its trained models are not there."""
        robot, references, mpc = self.robot, self.bench.references, self.settings.mpc
        nominal = RigidBodyModel()
        grids = {"variable": VARIABLE, "fixed": FIXED, "fixed_k22": FIXED_22}
        kind, _, steps = name.partition("_")
        if name == "joint_pd":
            return ByJointPd(robot, references)
        if name == "joint_pd_shifted":
            singles = [task for task in self.tasks if task.name in self.settings.single]
            return self.shifted(singles)
        if kind == "nominal" and steps in grids:
            return ByMpc(robot, references, model=nominal, config=replace(mpc, grid=grids[steps]))
        if kind == "learned" and steps in ("variable", "fixed"):
            model = self.learned(steps, grids[steps])
            return (
                None if model is None else ByMpc(robot, references, model=model, config=replace(mpc, grid=grids[steps]))
            )
        if name == "ours":
            return self.ours
        if name == "ours_adapted":
            return adapted(self.bench, self.ours, self.tasks, self.settings.adapt, self.map)
        known = "joint_pd, joint_pd_shifted, nominal_<steps>, learned_<steps>, ours, ours_adapted"
        raise InputError("land.methods", name, known, "choose known ones; steps are variable, fixed or fixed_k22")

    def shifted(self, singles: list[Task]) -> ByJointPd:
        """Joint PD with the best constant shift; its other tasks are shifted alike."""
        method = best_shift(self.bench, singles, self.plan, self.map)
        references = dict(method.references)
        for task in self.tasks:
            goal = Target(round(task.x_m + method.shift_m, 3), task.z_m)
            if goal not in references:
                references[goal] = self.plan(goal)
        return replace(method, references=references)

    def learned(self, steps: str, grid: TimeGrid) -> PredictionModel | None:
        """The exported model of all jumps, for these steps."""
        folder = Path(self.settings.models if steps == "variable" else self.settings.fixed_models) / "exported"
        if not folder.is_dir():
            print(f"learned_{steps}: no trained models in {folder}, left out", flush=True)
            return None
        purpose = Purpose(grid, ContactSchedule(), self.robot.name, self.robot.sha256)
        return load(folder, self.settings.model, purpose)

    @cached_property
    def ours(self) -> ByAiming:
        """After its practice."""
        start = ByAiming(self.robot, self.bench.references, planner=JumpPlanner(planar_robot(self.robot)))
        learned: Learned = practised(self.bench, start, self.settings.practice, self.map)
        print(f"{self.bench.hardware}: found {json.dumps(to_config(learned.found))} in {len(learned.tried)} jumps")
        landing = LandingModel(learned.tried, self.settings.practice.aim)
        return replace(start, planner=learned.planner, landing=landing)


def tasks_of(section: Mapping[str, Any]) -> tuple[tuple[Task, ...], dict[str, int]]:
    """Tasks, and how often each is done."""
    tasks, repeats = [], {}
    for name, raw in section.items():
        values = dict(raw)
        repeats[name] = int(values.pop("repeats", 1))
        tasks.append(read_config(Task, OmegaConf.create({"name": name, **values}), f"land.tasks.{name}"))
    return tuple(tasks), repeats


def said(done: Done) -> str:
    """One line for a person."""
    landings = ", ".join(f"{one.error_cm:+.1f} cm{'' if one.success else ' fell'}" for one in done.scored.landings)
    return f"{done.scored.key}: {landings or 'no jump'}"


if __name__ == "__main__":
    run_stage(land)
