"""Closed-loop runs of every landing method at every task, on each simulated hardware."""

from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from leapgap.effects.base import Effect
from leapgap.errors import InputError, did_you_mean
from leapgap.jumping.experiments.bench import Bench, TrialRunner
from leapgap.jumping.experiments.method import Method, References, crouch
from leapgap.jumping.experiments.method_registry import available
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.methods.practised_mpc import PractisedMpcSettings
from leapgap.jumping.experiments.on_policy import Practised
from leapgap.jumping.experiments.rig import LandSettings, Rig
from leapgap.jumping.experiments.scores import ScoredRun, landing_figures, round_value, write_rows
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.experiments.trial_spec import TrialResult, TrialSpec
from leapgap.jumping.learning.npz_files import write_npz
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import planner_body
from leapgap.jumping.planning.reference_store import reference_to
from leapgap.jumping.task import Target
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import whole_file, write_json, write_metrics
from leapgap.runtime.cache import ResultCache
from leapgap.runtime.executor import Executor
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.presets import Variant

RUNS, FIGURES, TABLE, PAGE = "runs", "landing.json", "landings.csv", "report.html"
MOST_REPEATS = 10_000
"""Of a task; all runs of an experiment are listed before the first one begins."""
LEVEL = Target(0.6)
"""A jump to the ground, which is planned where no task has one."""


@dataclass(frozen=True)
class Hardware:
    """A simulated robot with effects that no controller knows."""

    place: str
    """Its name in paths."""
    variant: str
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class LandingExperiment:
    """Grid of hardware, methods and tasks. Creating one with an unknown name is an ``InputError``."""

    settings: LandSettings
    methods: Mapping[str, MethodSettings]
    """Settings in ``land.method_settings``, by name."""
    variants: Mapping[str, Mapping[str, Any]]
    """Simulated hardware by name, each with the effects it has: the section ``collect.variants``."""
    tasks: Sequence[JumpTask]
    repeats: Mapping[str, int]
    """Number of runs of each task, by its name."""
    robot: Robot
    sensing: Sensing
    rounded: RigidBody | None = None
    """Mass and inertia of the robot, rounded as in its configuration."""

    def __post_init__(self) -> None:
        """Refuse unknown names, and a robot that cannot jump, before any work starts."""
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
        trials = [trial for _, trial in all_trials(rig.bench, {name: method}, self.tasks, self.repeats)]
        results = rig.bench.runner.results(trials, last=True)
        return [scored_run(hardware, name, trial, result) for trial, result in zip(trials, results, strict=True)]


def hardware_of(variants: Mapping[str, Mapping[str, Any]], name: str) -> Hardware:
    """The hardware of a name; ``random:3`` is number 3 of the robots drawn from the variant ``random``."""
    variant, _, number = name.partition(":")
    if variant not in variants or not (number or "0").isdigit():
        raise InputError("land.hardware", name, f"one of {', '.join(variants)}", "choose a known variant")
    return Hardware(name.replace(":", "_"), variant, Variant(**variants[variant]).draw(int(number or 0)))


def all_trials(
    bench: Bench, methods: Mapping[str, Method], tasks: Sequence[JumpTask], repeats: Mapping[str, int]
) -> list[tuple[str, TrialSpec]]:
    """Trials of every method at every task with the name of the method; the first run of each keeps its log."""
    return [
        (name, bench.trial(name, method, task, number, with_log=number == 0))
        for name, method in methods.items()
        for task in tasks
        for number in range(repeats[task.name])
    ]


def scored_run(hardware: Hardware, method: str, trial: TrialSpec, result: TrialResult) -> ScoredRun:
    """The result of a trial with the names that its figures are grouped by."""
    task = trial.task
    return ScoredRun(hardware.variant, hardware.place, method, task.name, trial_number(trial), task.jumps, result)


def trial_number(trial: TrialSpec) -> int:
    """Number of a trial among the runs of its task, from 0."""
    return int(trial.place.rpartition("_")[2])


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
    figures = landing_figures(scored, settings.single, settings.seed)
    write_rows([row for one in scored for row in one.rows()], out / TABLE)
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
                with whole_file(path) as beside:
                    write_npz(beside, found.model.arrays())
                for figure, values in practice_figures(found).items():
                    figures.setdefault(figure, {})[f"{hardware.place}/{name}"] = values
    cache.sweep()
    return figures


def practice_figures(found: Practised) -> dict[str, Any]:
    """Figures by round, and what was kept."""
    rounds = [asdict(one) for one in found.rounds]
    counted = ("jumps", "simulated")
    by_round = {name: [round_value(one[name]) for one in rounds] for name in rounds[0] if name not in counted}
    jumps = sum(one.jumps for one in found.rounds if not one.simulated)
    return by_round | {"jumps": jumps, "rounds_kept": found.kept}


def print_trial(trial: TrialSpec, result: TrialResult) -> None:
    """Print where the jumps of a trial landed."""
    landings = ", ".join(f"{one.error_cm:+.1f} cm{'' if one.success else ' fell'}" for one in result.landings)
    print(f"{trial.place}: {landings or 'no jump'}", flush=True)
