"""Where each method lands: closed-loop runs of every method at every task, on each simulated hardware."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.experiments.bench import Bench, TrialRunner
from leapgap.jumping.experiments.method import Method, References, crouch
from leapgap.jumping.experiments.method_registry import available
from leapgap.jumping.experiments.methods.base import MethodSettings
from leapgap.jumping.experiments.rig import LandSettings, Rig
from leapgap.jumping.experiments.scores import Scored
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.experiments.trial_spec import TrialResult, TrialSpec
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import planner_body
from leapgap.jumping.planning.reference_store import reference_to
from leapgap.robot.model import Robot
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.presets import Variant

RUNS, FIGURES, TABLE, PAGE = "runs", "landing.json", "landings.csv", "report.html"


@dataclass(frozen=True)
class Hardware:
    """A simulated robot that no controller knows."""

    place: str
    """Its name in paths."""
    variant: str
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class LandingExperiment:
    """The grid of hardware, methods and tasks; made only if every name in it is known."""

    settings: LandSettings
    methods: Mapping[str, MethodSettings]
    """Those of ``land.method_settings``, by name."""
    variants: Mapping[str, Mapping[str, Any]]
    """Section ``collect.variants``."""
    tasks: Sequence[JumpTask]
    repeats: Mapping[str, int]
    """How often each task is done, by its name."""
    robot: Robot
    sensing: Sensing
    rounded: RigidBody | None = None
    """Figures of the robot as its configuration rounds them."""

    def __post_init__(self) -> None:
        """Refuse what is unknown before any work starts."""
        self.hardware  # noqa: B018 (refuses unknown hardware)
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
        """Everything to run on."""
        return [hardware_of(self.variants, name) for name in self.settings.hardware]

    def names_on(self, hardware: Hardware) -> list[str]:
        """Methods that are tried on a hardware."""
        return self.settings.only.get(hardware.variant, self.settings.methods)

    def run(self, runner: TrialRunner) -> list[Scored]:
        """Every method at every task on every hardware; what its cache holds is not run again."""
        return [scored for hardware in self.hardware for scored in self._run_on(hardware, runner)]

    def rig(self, hardware: Hardware, runner: TrialRunner) -> Rig:
        """One hardware with what methods need."""
        settings, planar = self.settings, planar_robot(self.robot)
        references: References = {
            task.target: reference_to(task.target, Path(settings.references), planar, settings.schedule)
            for task in self.tasks
        }
        body = planner_body(self.robot, crouch(references, self.robot), self.rounded)
        world = TrialSetup(self.robot, self.sensing, body=body)
        bench = Bench(hardware.place, hardware.effects, world, references, runner, settings.seed)
        return Rig(settings, available(self.methods), bench, self.tasks, body)

    def _run_on(self, hardware: Hardware, runner: TrialRunner) -> list[Scored]:
        rig = self.rig(hardware, runner)
        methods = {name: method for name in self.names_on(hardware) if (method := rig.method(name)) is not None}
        named = all_trials(rig.bench, methods, self.tasks, self.repeats)
        results = runner.results([trial for _, trial in named])
        return [
            Scored(hardware.variant, hardware.place, name, trial.task.name, number_of(trial), trial.task.jumps, done)
            for (name, trial), done in zip(named, results, strict=True)
        ]


def hardware_of(variants: Mapping[str, Mapping[str, Any]], name: str) -> Hardware:
    """By name: ``random:3`` is number 3 of the robots drawn from the variant ``random``."""
    variant, _, number = name.partition(":")
    if variant not in variants or not (number or "0").isdigit():
        raise InputError("land.hardware", name, f"one of {', '.join(variants)}", "choose a known variant")
    return Hardware(name.replace(":", "_"), variant, Variant(**variants[variant]).draw(int(number or 0)))


def all_trials(
    bench: Bench, methods: Mapping[str, Method], tasks: Sequence[JumpTask], repeats: Mapping[str, int]
) -> list[tuple[str, TrialSpec]]:
    """Every method, by its name, at every task, as often as the task is done; each first run with its log."""
    return [
        (name, bench.trial(name, method, task, number, with_log=number == 0))
        for name, method in methods.items()
        for task in tasks
        for number in range(repeats[task.name])
    ]


def number_of(trial: TrialSpec) -> int:
    """Which run of its task a trial is."""
    return int(trial.place.rpartition("_")[2])


def tell(trial: TrialSpec, done: TrialResult) -> None:
    """Print one line for a person."""
    landings = ", ".join(f"{one.error_cm:+.1f} cm{'' if one.success else ' fell'}" for one in done.landings)
    print(f"{trial.place}: {landings or 'no jump'}", flush=True)
