"""Where each method lands: closed-loop experiments on simulated hardware that no controller knows."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from leapgap.cache import ResultCache
from leapgap.control.exported import load
from leapgap.control.planner import MpcConfig
from leapgap.effects import to_config
from leapgap.errors import InputError
from leapgap.executor import Executor
from leapgap.experiment.aimed import AIMED_LIMITS, JumpPlanner
from leapgap.experiment.aiming import LandingModel
from leapgap.experiment.bench import Bench, TrialRunner
from leapgap.experiment.made import TrialResult, TrialSpec
from leapgap.experiment.matrix import AdaptConfig, adapted, all_trials, best_shift
from leapgap.experiment.methods import ByAiming, ByJointPd, ByMpc, Method, References
from leapgap.experiment.practice import PracticeConfig, practised
from leapgap.experiment.scores import Scored, overall, tables
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import World
from leapgap.files import whole_file, write_json, write_text
from leapgap.planning.library import planned, reference_to
from leapgap.planning.problem import Limits
from leapgap.recording.jump import Jump, Target
from leapgap.recording.windows import Purpose, TimeGrid
from leapgap.robot.model import Robot
from leapgap.robot.nominal import RigidBodyModel
from leapgap.robot.planar import PlanarRobot, planar_robot
from leapgap.robot.prediction import PredictionModel
from leapgap.robot.rigid_body import RigidBody
from leapgap.robot.schedule import ContactSchedule
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.corrected import beyond_plans, body_with, planned_with, read_corrected
from leapgap.simulation.variants import Variant
from leapgap.view import landing as page
from stages.common import output_folder, read_config, run_stage

GRIDS = {
    "variable": TimeGrid(0.025, 0.1, 10),
    "fixed": TimeGrid(0.025, 0.025, 10),
    "fixed_k22": TimeGrid(0.025, 0.025, 22),
    "50_50": TimeGrid(0.05, 0.05, 10),
    "25_80": TimeGrid(0.025, 0.08, 10),
}
"""Steps of the MPC by the end of a method's name."""
CORRECTED = "_corrected"
"""Ends the names of methods that plan for, and predict with, the robot that a diagnosis corrected."""
RUNS, FIGURES, TABLE, PAGE = "runs", "landing.json", "landings.csv", "report.html"


@dataclass(frozen=True)
class Settings:
    """Section ``land``."""

    references: str
    published: str
    corrected: str | None
    models: dict[str, str]
    model: str
    hardware: list[str]
    methods: list[str]
    only: dict[str, list[str]]
    seed: int
    out: str | None
    metrics: str | None
    single: list[str]
    tasks: dict[str, Any]
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    mpc: MpcConfig = field(default_factory=MpcConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    limits: Limits = AIMED_LIMITS
    """Of the plans of `ours`."""


def land(config: DictConfig) -> None:
    """Run the matrix on every hardware; what is kept from a run before is not run again."""
    settings = read_config(Settings, config.land, "land")
    executor = read_config(Executor, config.executor, "executor")
    out, (tasks, repeats) = output_folder(settings.out), tasks_of(settings.tasks)
    places = {hardware: hardware.replace(":", "_") for hardware in settings.hardware}
    for name in (FIGURES, TABLE, PAGE):  # those of an earlier run: they are written when all runs are done
        (out / name).unlink(missing_ok=True)
    cache = ResultCache(out / RUNS)
    runner = TrialRunner(cache, executor.map, tell)
    scored = [
        one
        for hardware, place in places.items()
        for one in Rig(settings, config, hardware, place, tasks, runner).run(repeats)
    ]
    cache.sweep()
    means = overall(scored, settings.single, settings.seed)
    found = tables(scored, settings.seed) | means | {"seed": settings.seed}
    rows = [row for one in scored for row in one.rows()]
    write_rows(rows, out / TABLE)
    write_text(out / PAGE, page.html(found, rows, settings.single, out / RUNS))
    write_json(out / FIGURES, found)
    if settings.metrics is not None:
        write_json(Path(settings.metrics), found)
    for key, value in means["mean_abs_error_cm"].items():
        print(f"{key}: {value:.2f} cm over {', '.join(settings.single)}")
    print(f"look at it: {out / PAGE}")


class Rig:
    """One hardware with everything its trials need; methods are prepared when they are asked for."""

    def __init__(
        self,
        settings: Settings,
        config: DictConfig,
        hardware: str,
        place: str,
        tasks: Sequence[Task],
        runner: TrialRunner,
    ) -> None:
        self.settings, self.tasks = settings, list(tasks)
        self.robot = Robot.load(config.robot.model)
        self.variant, effects = effects_of(config.collect.variants, hardware)
        references: References = {task.target: self.plan(task.target) for task in tasks}
        world = World(self.robot, read_config(Sensing, config.collect.sensing, "collect.sensing"))
        self.bench = Bench(place, effects, world, references, runner, settings.seed)

    def plan(self, target: Target) -> Jump:
        """A plan from level ground."""
        return reference_to(target, Path(self.settings.references), planar_robot(self.robot), self.settings.schedule)

    def published(self, target: Target) -> Jump:
        """The same for the masses of the published planner."""
        return reference_to(target, Path(self.settings.published), PlanarRobot(), self.settings.schedule)

    def run(self, repeats: Mapping[str, int]) -> list[Scored]:
        """Every method at every task."""
        names = self.settings.only.get(self.variant, self.settings.methods)
        methods = {name: method for name in names if (method := self.method(name)) is not None}
        named = all_trials(self.bench, methods, self.tasks, repeats)
        results = self.bench.runner.results([trial for _, trial in named])
        return [
            Scored(self.variant, self.bench.hardware, name, trial.task.name, number_of(trial), trial.task.jumps, done)
            for (name, trial), done in zip(named, results, strict=True)
        ]

    def method(self, name: str) -> Method | None:
        """By name; None where its trained models are not there, or plans cannot express what was corrected."""
        plain, corrected = name.removesuffix(CORRECTED), name.endswith(CORRECTED)
        plans = self.corrected if corrected else (self.bench.references, RigidBody())
        if plans is None:
            return None
        references, body = plans
        kind, _, steps = plain.partition("_")
        if plain == "joint_pd":
            return ByJointPd(self.robot, references)
        if kind == "nominal" and steps in GRIDS:
            return self.mpc(RigidBodyModel(body), steps, references)
        if kind == "learned" and steps in GRIDS:
            model = self.learned(name, steps)
            return None if model is None else self.mpc(model, steps, references)
        if name == "joint_pd_published":
            return ByJointPd(self.robot, {target: self.published(target) for target in self.bench.references})
        if name == "joint_pd_shifted":
            singles = [task for task in self.tasks if task.name in self.settings.single]
            if not singles:
                raise InputError("land.single", "none of the tasks", "one or more to learn a shift on", "name one")
            return best_shift(self.bench, singles, self.tasks, self.plan)
        if name == "ours":
            return self.ours
        if name == "ours_adapted":
            return adapted(self.bench, self.ours, self.tasks, self.settings.adapt)
        known = "joint_pd, joint_pd_published, joint_pd_shifted, nominal_<steps>, learned_<steps>, ours, ours_adapted"
        known += f", and with {CORRECTED} those of joint_pd, nominal and learned that plan for a corrected robot"
        raise InputError("land.methods", name, known, f"choose known ones; steps are {', '.join(GRIDS)}")

    @cached_property
    def corrected(self) -> tuple[References, RigidBody] | None:
        """Plans for the robot that a diagnosis corrected, and its rigid body in the crouch they begin in.

        None, and said by name, where it has an effect that no plan can reckon with.
        """
        if self.settings.corrected is None:
            raise InputError("land.corrected", "no folder", "a folder 'corrected' of a diagnosis", "name one")
        robot, found = read_corrected(Path(self.settings.corrected))
        beyond = beyond_plans(found)
        if beyond:
            print(f"no plan can reckon with {', '.join(beyond)}: methods {CORRECTED} are left out", flush=True)
            return None
        planar = planned_with(robot, found)
        references = {target: planned(target, planar, self.settings.schedule) for target in self.bench.references}
        crouch = next(iter(references.values())).per_joint("cmd_pos", robot.joints)[0]
        return references, body_with(robot, found, crouch)

    def mpc(self, model: PredictionModel, steps: str, references: References) -> ByMpc:
        """The paper's."""
        config = replace(self.settings.mpc, grid=GRIDS[steps])
        return ByMpc(self.robot, references, model=model, config=config)

    def learned(self, name: str, steps: str) -> PredictionModel | None:
        """The exported model of all jumps, for these steps."""
        if steps not in self.settings.models:
            raise InputError("land.models", f"no folder for {steps}", "one for each learned method", "name it")
        folder = Path(self.settings.models[steps]) / "exported"
        if not folder.is_dir():
            print(f"{name}: no trained models in {folder}, left out", flush=True)
            return None
        purpose = Purpose(GRIDS[steps], self.settings.schedule, self.robot.name, self.robot.sha256)
        return load(folder, self.settings.model, purpose)

    @cached_property
    def ours(self) -> ByAiming:
        """After its practice."""
        planner = JumpPlanner(planar_robot(self.robot), self.settings.schedule, self.settings.limits)
        start = ByAiming(self.robot, self.bench.references, planner=planner)
        learned = practised(self.bench, start, self.settings.practice)
        print(f"{self.bench.hardware}: found {json.dumps(to_config(learned.found))}", flush=True)
        landing = LandingModel(learned.tried, self.settings.practice.aim)
        return replace(start, planner=learned.planner, landing=landing)


def effects_of(variants: DictConfig, hardware: str) -> tuple[str, tuple[Any, ...]]:
    """The variant's name and what this robot of it has: ``random:3`` is number 3 of the drawn ones."""
    name, _, number = hardware.partition(":")
    known = OmegaConf.to_container(variants)
    if not isinstance(known, dict) or name not in known or not (number or "0").isdigit():
        raise InputError("land.hardware", hardware, f"one of {', '.join(variants)}", "choose a known variant")
    return name, Variant(**known[name]).drawn(int(number or 0))


def tasks_of(section: Mapping[str, Any]) -> tuple[tuple[Task, ...], dict[str, int]]:
    """Tasks, and how often each is done; one that is never done is none."""
    tasks, repeats = [], {}
    for name, raw in section.items():
        values = dict(raw)
        times = int(values.pop("repeats", 1))
        if times < 1:
            continue
        repeats[name] = times
        tasks.append(read_config(Task, OmegaConf.create({"name": name, **values}), f"land.tasks.{name}"))
    return tuple(tasks), repeats


def number_of(trial: TrialSpec) -> int:
    """Which run of its task a trial is."""
    return int(trial.place.rpartition("_")[2])


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A table for `dvc plots` and for spreadsheets."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["hardware"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def tell(trial: TrialSpec, done: TrialResult) -> None:
    """One line for a person."""
    landings = ", ".join(f"{one.error_cm:+.1f} cm{'' if one.success else ' fell'}" for one in done.landings)
    print(f"{trial.place}: {landings or 'no jump'}", flush=True)


if __name__ == "__main__":
    run_stage(land)
