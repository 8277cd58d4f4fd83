"""Closed-loop runs of every landing method at every task, on each simulated hardware."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError, did_you_mean
from leapgap.jumping.experiments import methods
from leapgap.jumping.experiments.method import JumpTask, References, crouch
from leapgap.jumping.experiments.methods.mpc import PractisedMpcSettings
from leapgap.jumping.experiments.rig import Bench, LandSettings, MethodSettings, Rig, TrialRunner
from leapgap.jumping.experiments.trial import TrialResult, TrialSetup, TrialSpec
from leapgap.jumping.learning.model_files import write_csv, write_npz
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody, planner_body
from leapgap.jumping.planning.reference import reference_to
from leapgap.jumping.task import Target
from leapgap.registry import classes_by_name
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json, write_metrics
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.presets import Variant

BOOTSTRAP_DRAWS = 1000


@dataclass(frozen=True)
class ScoredRun:
    """One run of a method at a task."""

    hardware: str  # Name of its variant; robots drawn from one variant count together
    robot: str  # Which robot of the variant, as in places
    method: str
    task: str
    number: int
    planned_jumps: int  # Number of jumps in the task
    result: TrialResult

    @property
    def key(self) -> str:
        """Key of this run's figures in the metrics: hardware/method/task."""
        return f"{self.hardware}/{self.method}/{self.task}"

    def rows(self) -> Iterator[dict[str, Any]]:
        """One row for each jump that was made: its landing, and what the run demanded of the robot."""
        about = {name: getattr(self, name) for name in ("hardware", "robot", "method", "task", "number")}
        for jump, landing in enumerate(self.result.landings):
            figures = {name: round_value(value) for name, value in asdict(landing).items()}
            figures["disturbance"] = self.result.disturbance
            demands = {name: round_value(value) for name, value in asdict(self.result.metrics).items()}
            yield about | {"jump": jump} | figures | demands | {"fallbacks": sum(self.result.fallbacks.values())}


def tables(scored: Iterable[ScoredRun], seed: int) -> dict[str, dict[str, Any]]:
    """``{"abs_error_cm": {"worn/ours/jump_60": 1.2, …}, …}``; intervals are 95 %, as in ``interval``."""
    groups: dict[str, list[ScoredRun]] = {}
    for one in scored:
        groups.setdefault(one.key, []).append(one)
    found: dict[str, dict[str, Any]] = {}
    for key, runs in groups.items():
        for name, value in figures(runs, seed).items():
            found.setdefault(name, {})[key] = value
    return found


def figures(runs: Sequence[ScoredRun], seed: int) -> dict[str, Any]:
    """Figures over all jumps of some runs. A jump that was not made because one before it failed is no success."""
    jumps = [landing for run in runs for landing in run.result.landings]
    wanted = sum(run.planned_jumps for run in runs)
    error = np.array([jump.error_cm for jump in jumps])
    robots = [run.robot for run in runs for _ in run.result.landings]
    pitch = np.array([jump.pitch_deg for jump in jumps])
    demands = [run.result.metrics for run in runs]
    found = {
        "error_cm": summarise(np.mean, error),
        "error_ci95_cm": interval(error, robots, seed),
        "error_sd_cm": round_value(error.std(ddof=1)) if len(error) > 1 else None,
        "abs_error_cm": summarise(np.mean, np.abs(error)),
        "abs_error_ci95_cm": interval(np.abs(error), robots, seed),
        "worst_error_cm": summarise(np.max, np.abs(error)),
        "success": round_value(sum(jump.success for jump in jumps) / wanted),
        "landing_pitch_deg": summarise(np.mean, np.abs(pitch)),
        "worst_pitch_deg": summarise(np.max, np.abs(pitch)),
        "apex": summarise(np.mean, np.array([jump.apex for jump in jumps])),
        "jumps": wanted,
        "jumps_made": len(jumps),
        "fallbacks": sum(sum(run.result.fallbacks.values()) for run in runs),
        "friction": summarise(np.max, np.array([one.friction for one in demands])),
        "force_n": summarise(np.max, np.array([one.force_n for one in demands])),
        "tracking_rad": summarise(np.mean, np.array([one.tracking_rad for one in demands])),
        "short_of_torque": summarise(np.mean, np.array([one.short_of_torque for one in demands])),
    }
    if any(run.planned_jumps > 1 for run in runs):
        totals = np.array([run.result.total_error_cm for run in runs if run.result.total_error_cm is not None])
        found |= {
            "total_error_cm": summarise(np.mean, totals),
            "total_abs_error_cm": summarise(np.mean, np.abs(totals)),
        }
    return found


def summarise(statistic: Callable[[np.ndarray], Any], values: np.ndarray) -> float | None:
    """A statistic of some values, rounded; None where there are none."""
    return round_value(statistic(values)) if len(values) else None


def interval(values: np.ndarray, robots: Sequence[str], seed: int) -> list[float | None] | None:
    """95 % bootstrap interval of the mean: resamples robots, where there are several, else jumps; None of one jump."""
    if len(values) < 2:
        return None
    units = np.unique(robots, return_inverse=True)[1] if len(set(robots)) > 1 else np.arange(len(values))
    sums, counts = (np.bincount(units, weights) for weights in (values, np.ones(len(values))))
    drawn = np.random.default_rng(seed).integers(0, len(sums), (BOOTSTRAP_DRAWS, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    return [round_value(edge) for edge in np.percentile(means, [2.5, 97.5])]


def round_value(value: Any) -> Any:
    """A number rounded to three digits; truth values and None unchanged."""
    return value if value is None or isinstance(value, bool) else round(float(value), 3)


def mean_over_tasks(scored: Iterable[ScoredRun], tasks: Sequence[str], seed: int) -> dict[str, dict[str, Any]]:
    """Mean absolute error and its interval over some tasks, each with equal weight, by hardware and method, cm."""
    by: dict[str, dict[tuple[str, str], list[float]]] = {}
    for run in scored:
        if run.task in tasks and run.result.landings:
            of_task = by.setdefault(f"{run.hardware}/{run.method}", {}).setdefault((run.task, run.robot), [])
            of_task += [abs(jump.error_cm) for jump in run.result.landings]
    return {
        "mean_abs_error_cm": {
            key: round_value(np.mean([np.mean(v) for v in errors.values()])) for key, errors in by.items()
        },
        "mean_abs_error_ci95_cm": {key: task_mean_interval(errors, seed) for key, errors in by.items()},
    }


def task_mean_interval(errors: Mapping[tuple[str, str], Sequence[float]], seed: int) -> list[float | None] | None:
    """95 % bootstrap interval of the mean of the tasks' means; ``errors`` by task and robot, cm.

    None where a task was jumped once on the only robot: one jump says nothing of its scatter.
    """
    of_robots: dict[str, list[np.ndarray]] = {}
    for (_, robot), of_task in errors.items():
        of_robots.setdefault(robot, []).append(np.array(of_task))
    if len(of_robots) > 1:
        means = np.array([np.mean([of_task.mean() for of_task in tasks]) for tasks in of_robots.values()])
        return interval(means, list(of_robots), seed)
    rng, (tasks,) = np.random.default_rng(seed), of_robots.values()
    if min(len(of_task) for of_task in tasks) < 2:
        return None
    drawn = np.mean([rng.choice(v, (BOOTSTRAP_DRAWS, len(v))).mean(axis=1) for v in tasks], axis=0)
    return [round_value(edge) for edge in np.percentile(drawn, [2.5, 97.5])]


ENTRY_POINTS = "leapgap.landing_methods"  # Entry-point group under which other packages provide methods


@cache
def known() -> dict[str, type[MethodSettings]]:
    """Classes of methods by their names, in alphabetical order."""
    return classes_by_name(methods, MethodSettings, ENTRY_POINTS)  # type: ignore[type-abstract]


def available(configured: Mapping[str, MethodSettings]) -> dict[str, MethodSettings]:
    """Methods by the names they can be asked for: those configured, and every class that needs no configuration."""
    found = dict[str, MethodSettings]()
    for name, kind in known().items():
        if not any(one.default is MISSING and one.default_factory is MISSING for one in fields(kind)):
            found[name] = kind()
    return found | dict(configured)


RUNS, FIGURES, TABLE, PAGE = "runs", "landing.json", "landings.csv", "report.html"
MOST_REPEATS = 10_000  # Of a task; all runs of an experiment are listed before the first one begins
LEVEL = Target(0.6)  # A jump to the ground, which is planned where no task has one


@dataclass(frozen=True)
class Hardware:
    """A simulated robot with effects that no controller knows."""

    place: str  # Its name in paths
    variant: str
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class LandingExperiment:
    """Grid of hardware, methods and tasks. Creating one with an unknown name is an ``InputError``."""

    settings: LandSettings
    methods: Mapping[str, MethodSettings]  # Settings in ``land.method_settings``, by name
    variants: Mapping[str, Mapping[str, Any]]  # Hardware by name, each with its effects: ``collect.variants``
    tasks: Sequence[JumpTask]
    repeats: Mapping[str, int]  # Number of runs of each task, by its name
    robot: Robot
    sensing: Sensing
    rounded: RigidBody | None = None  # Mass and inertia of the robot, rounded as in its configuration

    def __post_init__(self) -> None:
        planar_robot(self.robot)
        self.hardware  # noqa: B018 (refuses unknown hardware)
        for name, number in self.repeats.items():
            if not 0 <= number <= MOST_REPEATS:
                expected = f"0 (left out) to {MOST_REPEATS}"
                raise InputError(f"land.tasks.{name}.repeats", str(number), expected, "correct it")
        for name in self.settings.single:
            if name not in self.repeats:
                do = did_you_mean(name, self.repeats) or "choose known tasks"
                raise InputError("land.single", name, f"one of {', '.join(self.repeats)}", do)
        if not any(self.names_on(one) for one in self.hardware):
            raise InputError("land", "no hardware or no methods", "one or more of each", "name them")
        known = available(self.methods)
        lists = {"land.methods": self.settings.methods}
        lists |= {f"land.only.{variant}": names for variant, names in self.settings.only.items()}
        for where, names in lists.items():
            for name in names:
                if name not in known:
                    raise InputError(where, name, f"one of {', '.join(sorted(known))}", "choose known methods")
        for name in {name for one in self.hardware for name in self.names_on(one)}:
            known[name].check(name, self.settings)

    @property
    def hardware(self) -> list[Hardware]:
        """The simulated robots that all methods run on."""
        return [hardware_of(self.variants, name) for name in self.settings.hardware]

    def names_on(self, hardware: Hardware) -> list[str]:
        """Names of the methods that run on a hardware."""
        return self.settings.only.get(hardware.variant, self.settings.methods)

    def run(self, runner: TrialRunner) -> list[ScoredRun]:
        """Run every method at every task on every hardware. Results in the runner's cache are not computed again.

        Methods that practise wait for one jump after the other; meanwhile workers make the jumps of other methods.
        """
        jobs = [
            (rig, hardware, name)
            for hardware in self.hardware
            for rig in (self.rig(hardware, runner),)
            for name in self.names_on(hardware)
        ]
        if not runner.side_by_side:
            return [scored for job in jobs for scored in self._run_method(*job)]
        threads = ThreadPoolExecutor(len(jobs))
        try:
            running = [threads.submit(self._run_method, *job) for job in jobs]
            done, _ = wait(running, return_when=FIRST_EXCEPTION)
            for failed in [one for one in running if one in done and one.exception()]:
                failed.result()
            return [scored for one in running for scored in one.result()]
        finally:
            threads.shutdown(wait=False, cancel_futures=True)

    def rig(self, hardware: Hardware, runner: TrialRunner) -> Rig:
        """A hardware, with everything that methods need to be prepared on it."""
        settings, planar = self.settings, planar_robot(self.robot)
        targets = [task.target for task in self.tasks]
        if all(target.z_m for target in targets):
            targets.append(LEVEL)  # practice is on level ground, whatever the tasks are
        references: References = {
            target: reference_to(target, Path(settings.references), planar, settings.schedule) for target in targets
        }
        body = planner_body(self.robot, crouch(references, self.robot), self.rounded)
        world = TrialSetup(self.robot, self.sensing, body=body)
        bench = Bench(hardware.place, hardware.effects, world, references, runner, settings.seed)
        return Rig(settings, available(self.methods), bench, self.tasks, body)

    def _run_method(self, rig: Rig, hardware: Hardware, name: str) -> list[ScoredRun]:
        """Runs of a method at every task; none where it lacks an input."""
        method = rig.method(name)
        if method is None:
            return []
        runs = [(task, number) for task in self.tasks for number in range(self.repeats[task.name])]
        trials = [rig.bench.trial(name, method, task, number, with_log=number == 0) for task, number in runs]
        return [
            ScoredRun(hardware.variant, hardware.place, name, task.name, number, task.jumps, result)
            for (task, number), result in zip(runs, rig.bench.runner.results(trials, last=True), strict=True)
        ]


def hardware_of(variants: Mapping[str, Mapping[str, Any]], name: str) -> Hardware:
    """The hardware of a name; ``random:3`` is number 3 of the robots drawn from the variant ``random``."""
    variant, _, number = name.partition(":")
    if variant not in variants or not (number or "0").isdigit():
        raise InputError("land.hardware", name, f"one of {', '.join(variants)}", "choose a known variant")
    return Hardware(name.replace(":", "_"), variant, Variant(**variants[variant]).draw(int(number or 0)))


def remove_figures(out: Path) -> None:
    """Remove the results of an earlier call, so that none are left if this one fails."""
    for name in (FIGURES, TABLE, PAGE):
        (out / name).unlink(missing_ok=True)


def run_landings(experiment: LandingExperiment, executor: Executor, out: Path) -> list[ScoredRun]:
    """Run an experiment with its results kept in a folder, and in that of its practice."""
    cache, earlier = ResultCache(out / RUNS), ResultCache(Path(experiment.settings.practised or out) / RUNS)
    with executor.pool() as pool:
        runner = TrialRunner(cache, pool.map, print_trial, pool.map_last, side_by_side=True, earlier=earlier)
        scored = experiment.run(runner)
    cache.sweep()
    return scored


def write_landings(scored: Sequence[ScoredRun], settings: LandSettings, out: Path) -> dict[str, float]:
    """Write figures and table; the mean errors by hardware and method, cm, which are printed too."""
    seed, rows = settings.seed, [row for one in scored for row in one.rows()]
    figures: dict[str, Any] = {**tables(scored, seed), **mean_over_tasks(scored, settings.single, seed), "seed": seed}
    write_csv(out / TABLE, list(rows[0]) if rows else ["hardware"], (row.values() for row in rows))
    write_json(out / FIGURES, figures)
    if settings.metrics is not None:
        write_metrics(Path(settings.metrics), figures)
    for key, value in figures["mean_abs_error_cm"].items():
        print(f"{key}: {value:.2f} cm over {', '.join(settings.single)}")
    return {f"mean_abs_error_cm/{name}": value for name, value in figures["mean_abs_error_cm"].items()}


@dataclass(frozen=True)
class PractiseSettings:
    """Section ``practise`` of the configuration; what is practised stands in ``land``."""

    out: str | None


def run_practice(experiment: LandingExperiment, executor: Executor, out: Path) -> dict[str, dict[str, Any]]:
    """Make the rounds of every method that practises, on all hardware, and write its model; figures by hardware/method.

    Rounds that are there are kept.
    """
    cache, figures = ResultCache(out / RUNS), dict[str, dict[str, Any]]()
    with executor.pool() as pool:
        runner = TrialRunner(cache, pool.map, print_trial)
        for hardware in experiment.hardware:
            rig = experiment.rig(hardware, runner)
            for name in experiment.names_on(hardware):
                method = rig.known[name]
                if not isinstance(method, PractisedMpcSettings) or not method.practises:
                    continue
                found, path = method.practise(name, rig), out / f"{hardware.place}/{name}.npz"
                path.parent.mkdir(parents=True, exist_ok=True)
                write_npz(path, found.model.arrays())
                rounds = [asdict(one) for one in found.rounds]
                kept: dict[str, Any] = {
                    one: [round_value(of[one]) for of in rounds] for one in ("landed_cm", "predicted_cm", "pitch_deg")
                }
                kept["jumps"] = sum(one.jumps for one in found.rounds if not one.simulated)
                kept["rounds_kept"] = found.kept
                for figure, values in kept.items():
                    figures.setdefault(figure, {})[f"{hardware.place}/{name}"] = values
    cache.sweep()
    return figures


def print_trial(trial: TrialSpec, result: TrialResult) -> None:
    """Print where the jumps of a trial landed."""
    landings = ", ".join(f"{one.error_cm:+.1f} cm{'' if one.success else ' fell'}" for one in result.landings)
    print(f"{trial.place}: {landings or 'no jump'}", flush=True)
