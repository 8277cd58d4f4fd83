"""One simulated robot with everything that methods need to be prepared, and the settings of the section ``land``."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.mpc import MpcConfig, StateWeights
from leapgap.jumping.control.tracking import Excitation, PhaseGains
from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS, AimConfig, JumpPlanner
from leapgap.jumping.experiments.method import JumpTask, Method, References, crouch
from leapgap.jumping.experiments.trial import TrialResult, TrialSetup, TrialSpec
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.planar import PlanarRobot, body_with, planar_robot, planar_robot_with, unplannable_effects
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.planning.problem import Limits
from leapgap.jumping.planning.reference import is_same_robot, plan_reference, reference_to
from leapgap.jumping.task import ContactSchedule, JointGains, Target
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key
from leapgap.simulation.corrected import read_corrected


class PlanSource(Enum):
    """Which robot a method's jumps are planned for."""

    own = "own"  # The robot as its model file describes it, without any correction
    published = "published"  # The planar robot of the published planner
    corrected = "corrected"  # The robot that a diagnosis corrected


@dataclass(frozen=True)
class PracticeRounds:
    """How many jumps are made, to which targets, and with which random forces; all on flat ground."""

    distances_m: tuple[float, ...] = (0.35, 0.45, 0.55, 0.65, 0.75)
    first_jumps: int = 2  # Jumps to each target by the nominal MPC
    rounds: int = 7  # Of one jump to each target by the learned MPC
    first: Excitation = field(default_factory=lambda: Excitation(40.0))
    later: Excitation = field(default_factory=lambda: Excitation(15.0))
    on_policy_weight: float = 5.0  # How much a jump of the learned MPC counts beside one of the nominal MPC
    block_m: tuple[float, float] = (0.0, 0.0)  # Height of a block under the front feet in every second jump
    slope_rad: tuple[float, float] = (-0.005, 0.005)
    trusted_cm: float = 5.0
    """Largest mean |landing − prediction| of the last round with which the model of all jumps is kept; beyond, that of
    the round whose landings were predicted best."""

    def __post_init__(self) -> None:
        if self.first_jumps < 1 or self.rounds < 0 or not self.distances_m:
            raise ValueError(
                "one distance, and one jump to each of them by the nominal MPC, or more; rounds not below 0"
            )


@dataclass(frozen=True)
class LearnedMpcConfig:
    """Control, model and practice of the learned MPC."""

    model: str = "deviation_kernel"  # Name of a recipe in ``learning/models``
    gains: PhaseGains = field(
        default_factory=lambda: PhaseGains(JointGains(100.0, 2.0), JointGains(300.0, 3.0), JointGains(100.0, 2.0))
    )
    mpc: MpcConfig = field(
        default_factory=lambda: MpcConfig(
            weights=StateWeights(50.0, 100.0, 5.0, 10.0, 10.0, 1.0),
            landing_weights=StateWeights(5000.0, 500.0, 50.0, 0.0, 0.0, 5.0),
            force_weight=1e-5,
            limits=ForceLimits(from_plan_n=120.0),
        )
    )
    practice: PracticeRounds = field(default_factory=PracticeRounds)


@dataclass(frozen=True)
class GoalOffsets:
    """Ranges of uniform random offsets that are added to a chosen goal."""

    x_m: tuple[float, float] = (0.0, 0.0)
    z_m: tuple[float, float] = (0.0, 0.0)
    pitch_rad: tuple[float, float] = (0.0, 0.0)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """One offset (x, z, pitch), (3,), m, m, rad."""
        return rng.uniform(*np.transpose([self.x_m, self.z_m, self.pitch_rad]))


@dataclass(frozen=True)
class PracticeConfig:
    """How many training jumps are made, and to which targets; all of them are on flat ground, never on a box."""

    identify_jumps: int = 4  # Number of the first jumps, which identify effects in the joints for all later plans
    random_jumps: int = 16
    rounds: tuple[int, ...] = (10, 10)  # Jumps of each later round, to goals chosen with the model of all jumps before
    distance_m: tuple[float, float] = (0.32, 0.78)
    block_m: tuple[float, float] = (0.01, 0.07)  # Height of a block under the front feet in every second jump
    slope_rad: tuple[float, float] = (-0.005, 0.005)  # Slope of the ground, drawn evenly
    random_beyond: GoalOffsets = field(default_factory=lambda: GoalOffsets((-0.1, 0.1), (-0.04, 0.14), (-0.15, 0.15)))
    """Offsets of the goals of the first jumps. On flat ground a goal may be high above it."""
    later_beyond: GoalOffsets = field(default_factory=lambda: GoalOffsets((-0.03, 0.03), (-0.03, 0.03), (-0.05, 0.05)))
    """Offsets of the goals of all later jumps."""
    aim: AimConfig = field(default_factory=AimConfig)

    def __post_init__(self) -> None:
        if self.identify_jumps < 1 or self.random_jumps < 1 or min(self.rounds, default=0) < 0:
            jumps = f"identify_jumps {self.identify_jumps}, random_jumps {self.random_jumps}"
            raise ValueError(f"{jumps}, rounds {list(self.rounds)}: 1 or more, 1 or more, 0 or more each")


@dataclass(frozen=True)
class AdaptConfig:
    """How the offset of each task is learned from its own jumps."""

    jumps: int = 4  # Jumps of each task, one after the other
    rate: float = 0.7  # Learning rate: share of the prediction error that is added to the offset after each jump


@dataclass(frozen=True)
class LandSettings:
    """Section ``land`` of the configuration."""

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
    pages: bool  # Whether the page is written at once; stage ``land_page`` writes it of what is there
    single: list[str]
    tasks: dict[str, Any]
    practised: str | None  # Folder of stage ``practise``
    grids: dict[str, Any]  # Steps of the MPC by name, each the fields of a ``TimeGrid``
    method_settings: dict[str, Any]
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    mpc: MpcConfig = field(default_factory=MpcConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    learned: LearnedMpcConfig = field(default_factory=LearnedMpcConfig)
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    limits: Limits = AIMING_LIMITS  # Limits of the plans of ``ours``

    def grid(self, key: str, method: str) -> TimeGrid:
        """The steps that a method names."""
        values = self.known("grids", key, method)
        try:
            return TimeGrid(**values)
        except (TypeError, ValueError) as error:
            expected = "contact_step_s, flight_step_s and steps that fit together"
            raise InputError(f"land.grids.{key}", str(error), expected, "correct it") from None

    def known(self, part: str, key: str, method: str) -> Any:
        """The entry ``key`` of ``grids`` or ``models`` (``part``); a key that is not there is an ``InputError``."""
        entries = getattr(self, part)
        if key not in entries:
            where, expected = f"land.method_settings.{method}", f"a key of land.{part}: {', '.join(entries)}"
            raise InputError(where, key, expected, "add it there")
        return entries[key]

    def check_plans(self, source: PlanSource) -> None:
        """Refuse plans for a corrected robot where no folder of a diagnosis is named."""
        if source is PlanSource.corrected and self.corrected is None:
            raise InputError("land.corrected", "no folder", "a folder 'corrected' of a diagnosis", "name one")


Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
"""Applies a function to items, possibly in parallel; results come in the order of the items."""


@dataclass(frozen=True)
class TrialRunner:
    """Runs the trials whose results are not in the cache: ``<place>.json``, and ``<place>.parquet`` of a log.

    Threads may share it where they may share ``map``; what one of them computes another waits for.
    """

    cache: ResultCache
    map: Mapper
    progress: Callable[[TrialSpec, TrialResult], None] | None = None  # Called after every trial that was run, in order
    map_last: Mapper | None = None  # ``map`` for trials whose results no further trial waits for; None: ``map``
    side_by_side: bool = False  # Whether threads may share ``map``, so that methods are prepared side by side
    earlier: ResultCache | None = None  # Of another stage: results that are there are read, and none is written
    _running: "dict[str, Future[None]]" = field(default_factory=dict)  # Places that a thread computes
    _lock: Any = field(default_factory=threading.Lock)

    def results(self, trials: Sequence[TrialSpec], last: bool = False) -> list[TrialResult]:
        """Results in the order of the trials. New ones are read back from the cache, like earlier ones.

        ``last``: no further trial waits for them.
        """
        keys = {trial.place: result_key(TrialSpec.run, trial) for trial in trials}
        with self._claimed(keys) as claimed:
            missing = [trial for trial in trials if trial.place in claimed]
            new = ((last and self.map_last) or self.map)(TrialSpec.run, missing)
            for trial, result in zip(missing, new, strict=True):
                self._store(trial, result, keys[trial.place])
                if self.progress is not None:
                    with self._lock:
                        self.progress(trial, result)
        return [self._read(trial, keys[trial.place]) for trial in trials]

    def value(self, place: str, make: Callable[..., Mapping[str, Any]], *inputs: Any) -> Mapping[str, Any]:
        """``make(*inputs)``, from the cache where it is there; JSON must be able to hold it."""
        key = result_key(make, inputs)
        with self._claimed({place: key}) as claimed:
            if claimed:
                made = self.call(make, *inputs)
                with self.cache.store(place, key) as folder:
                    write_json(folder / f"{Path(place).name}.json", made)
        return read_json(self._path(place, key).with_suffix(".json"))

    def call(self, make: Callable[..., Any], *inputs: Any) -> Any:
        """``make(*inputs)``, on a worker where threads share them, so that this process is free to give them work."""
        if not self.side_by_side:
            return make(*inputs)
        (made,) = self.map(apply_to, [(make, inputs)])
        return made

    @contextmanager
    def _claimed(self, wanted: Mapping[str, str]) -> Iterator[set[str]]:
        """Yield those places, of a mapping to their keys, that are not in the cache, nor computed by another thread.

        The block has to compute them. It ends when those are there, too, that others compute.
        """
        done: Future[None] = Future()
        with self._lock:
            missing = [place for place, key in wanted.items() if self._found(place, key) is None]
            others = {self._running[place] for place in missing if place in self._running}
            claimed = {place for place in missing if place not in self._running}
            self._running.update(dict.fromkeys(claimed, done))
        try:
            yield claimed
        except BaseException as error:
            done.set_exception(error)
            raise
        else:
            done.set_result(None)
        finally:
            with self._lock:
                for place in claimed:
                    del self._running[place]
        for other in others:
            other.result()

    def _store(self, trial: TrialSpec, result: TrialResult, key: str) -> None:
        with self.cache.store(trial.place, key) as folder:
            path = folder / f"{Path(trial.place).name}.json"
            write_json(path, result.to_json())
            if result.log is not None:
                jump_log.write_log(result.log, path.with_suffix(".parquet"))

    def _read(self, trial: TrialSpec, key: str) -> TrialResult:
        path = self._path(trial.place, key)
        log = jump_log.read_log(path.with_suffix(".parquet")) if trial.with_log else None
        return TrialResult.from_json(read_json(path.with_suffix(".json")), log)

    def _path(self, place: str, key: str) -> Path:
        found = self._found(place, key)
        assert found is not None, f"{place} was made"
        return found

    def _found(self, place: str, key: str) -> Path | None:
        """Path of a result without its ending, where it is."""
        own = self.cache.get(place, key)
        return own if own or self.earlier is None else self.earlier.get(place, key)


def apply_to(call: tuple[Callable[..., Any], Sequence[Any]]) -> Any:
    """The value of a function at its inputs."""
    function, inputs = call
    return function(*inputs)


@dataclass(frozen=True)
class Bench:
    """One simulated robot, and everything that its trials have in common."""

    hardware: str  # Its name in the places of its trials; it must be a valid file name
    effects: tuple[Effect, ...]
    world: TrialSetup
    references: Mapping[Any, Log]
    runner: TrialRunner
    seed: int = 0

    @property
    def robot(self) -> Robot:
        """The nominal robot, which controllers assume."""
        return self.world.robot

    @cached_property
    def level(self) -> Log:
        """The first plan to the ground itself: practice starts from its first pose, and on no box."""
        return next(plan for target, plan in self.references.items() if target.z_m == 0)

    def trial(self, name: str, method: Method, task: JumpTask, number: int, with_log: bool = False) -> TrialSpec:
        """A trial of a method. Only task and number decide its seed: all methods get the same ground and noise."""
        seed = int(np.random.SeedSequence([self.seed, number, *task.name.encode()]).generate_state(1)[0])
        place = f"{self.hardware}/{name}/{task.name}_{number}"
        level = self.references[task.target]
        return TrialSpec(place, task, method, level, self.effects, self.world, seed, with_log)


@dataclass(frozen=True)
class Plans:
    """Plans to all targets, and the rigid body of the robot that they are made for."""

    references: References
    body: RigidBody


@dataclass(frozen=True)
class MethodSettings(ABC):
    """How a method is configured. To add a method, add a subclass in a file of this package.

    An entry of ``land.method_settings`` names the class by ``kind`` and gives its fields; a class whose fields all
    have defaults can be asked for by its own name, without an entry.
    """

    name: ClassVar[str]

    def check(self, name: str, settings: LandSettings) -> None:
        """Raise an ``InputError`` where the settings cannot work, before anything is run; ``name`` is the method's."""
        del name, settings

    @abstractmethod
    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Train the method on one simulated robot, where it needs that, and return it.

        Where an input is missing, one line is printed and None returned; the method is then left out.
        """


@dataclass
class Rig:
    """One simulated robot. Each method is prepared once, when it is first asked for, by whichever thread asks."""

    settings: LandSettings
    known: Mapping[str, MethodSettings]  # Settings of every method that can be prepared on this robot, by the name
    bench: Bench
    tasks: Sequence[JumpTask]
    body: RigidBody  # Rigid body that controllers assume for the nominal robot
    _prepared: dict[str, Method | None] = field(default_factory=dict)
    _locks: dict[str, Any] = field(default_factory=dict)  # Lock of each method, by its name
    _plans: dict[PlanSource, Plans | None] = field(default_factory=dict)
    _plans_lock: Any = field(default_factory=threading.RLock)

    @property
    def robot(self) -> Robot:
        """The nominal robot, which controllers assume."""
        return self.bench.robot

    def method(self, name: str) -> Method | None:
        """The method of that name, prepared; None where something that it needs is not there."""
        with self._locks.setdefault(name, threading.RLock()):
            if name not in self._prepared:
                self._prepared[name] = self.known[name].prepare(name, self)
            return self._prepared[name]

    @property
    def planner(self) -> JumpPlanner:
        """Plans of the nominal robot from any stance to any goal, before anything was learned of it."""
        return JumpPlanner(planar_robot(self.robot), self.settings.schedule, self.settings.limits)

    def plan(self, target: Target) -> Log:
        """A plan of the nominal robot from level ground."""
        settings, planar = self.settings, planar_robot(self.robot)
        planned: Log = self.bench.runner.call(
            reference_to, target, Path(settings.references), planar, settings.schedule
        )
        return planned

    def plans(self, source: PlanSource) -> Plans | None:
        """Plans for the robot of a source; None, with a printed reason, where there are none."""
        with self._plans_lock:
            if source not in self._plans:
                self._plans[source] = self._plans_of(source)
            return self._plans[source]

    def _plans_of(self, source: PlanSource) -> Plans | None:
        settings, targets = self.settings, list(self.bench.references)
        if source is PlanSource.own:
            return Plans(self.bench.references, self.body)
        if source is PlanSource.published:  # the rigid body remains that of the nominal robot
            if not is_same_robot(planar_robot(self.robot), PlanarRobot()):
                print(f"no published plans are of {self.robot.path}: methods _published are left out", flush=True)
                return None
            folder, schedule = Path(settings.published), settings.schedule
            return Plans({one: reference_to(one, folder, PlanarRobot(), schedule) for one in targets}, self.body)
        settings.check_plans(source)
        robot, found = read_corrected(Path(str(settings.corrected)))
        left_out = unplannable_effects(found)
        if left_out:
            print(f"no plan can reckon with {', '.join(left_out)}: methods _corrected are left out", flush=True)
            return None
        plan = partial(plan_reference, planar=planar_robot_with(robot, found), schedule=settings.schedule)
        references = dict(zip(targets, self.bench.runner.map(plan, targets), strict=True))
        return Plans(references, body_with(robot, found, crouch(references, robot)))
