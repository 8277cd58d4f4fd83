"""One simulated robot with everything that methods need to be prepared, and the settings of the experiment."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

from leapgap.errors import InputError
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS
from leapgap.jumping.experiments.learned_config import LearnedMpcConfig
from leapgap.jumping.experiments.method import Method, PlanSource, References, crouch
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.training_jumps import PracticeConfig
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.corrected_robot import body_with, planar_robot_with, unplannable_effects
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.planning.problem import Limits
from leapgap.jumping.planning.reference_store import is_same_robot, plan_reference, reference_to
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import read_corrected


@dataclass(frozen=True)
class AdaptConfig:
    """How the offset of each task is learned from its own jumps."""

    jumps: int = 4
    """Jumps of each task, one after the other."""
    rate: float = 0.7
    """Learning rate: share of the prediction error that is added to the offset after each jump."""


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
    pages: bool
    """Whether the page is written at once; stage ``land_page`` writes it of what is there."""
    single: list[str]
    tasks: dict[str, Any]
    practised: str | None
    """Folder of stage ``practise``."""
    grids: dict[str, Any]
    """Steps of the MPC by name, each the fields of a ``TimeGrid``."""
    method_settings: dict[str, Any]
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    mpc: MpcConfig = field(default_factory=MpcConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    learned: LearnedMpcConfig = field(default_factory=LearnedMpcConfig)
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    limits: Limits = AIMING_LIMITS
    """Limits of the plans of ``ours``."""

    def grid(self, key: str, method: str) -> TimeGrid:
        """The steps that a method names."""
        values = self.known("grids", key, method)
        try:
            return TimeGrid(**values)
        except (TypeError, ValueError) as error:
            expected = "contact_step_s, flight_step_s and steps that fit together"
            raise InputError(f"land.grids.{key}", str(error), expected, "correct it") from None

    def folder(self, key: str, method: str) -> Path:
        """The folder of trained models that a method names."""
        return Path(self.known("models", key, method))

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


@dataclass(frozen=True)
class Plans:
    """Plans to all targets, and the rigid body of the robot that they are made for."""

    references: References
    body: RigidBody


class Preparable(Protocol):
    """What a rig asks of the settings of a method (``methods.base.MethodSettings``)."""

    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Train the method on one simulated robot, where it needs that, and return it."""


@dataclass
class Rig:
    """One simulated robot. Each method is prepared once, when it is first asked for, by whichever thread asks."""

    settings: LandSettings
    known: Mapping[str, Preparable]
    """Settings of every method that can be prepared on this robot, by the method's name."""
    bench: Bench
    tasks: Sequence[JumpTask]
    body: RigidBody
    """Rigid body that controllers assume for the nominal robot."""
    _prepared: dict[str, Method | None] = field(default_factory=dict)
    _locks: dict[str, Any] = field(default_factory=dict)
    """Lock of each method, by its name."""
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

    def plan(self, target: Target) -> Log:
        """A plan of the nominal robot from level ground."""
        settings, planar = self.settings, planar_robot(self.robot)
        planned: Log = self.bench.runner.call(
            reference_to, target, Path(settings.references), planar, settings.schedule
        )
        return planned

    def plans(self, source: PlanSource) -> Plans | None:
        """Plans for the robot of a source; None, with a printed reason, where there are none."""
        makers: dict[PlanSource, Callable[[], Plans | None]] = {
            PlanSource.own: lambda: Plans(self.bench.references, self.body),
            PlanSource.published: lambda: self._published,
            PlanSource.corrected: lambda: self._corrected,
        }
        with self._plans_lock:
            return makers[source]()

    @cached_property
    def _published(self) -> Plans | None:
        """Plans for the published planar robot; the rigid body remains that of the nominal robot."""
        if not is_same_robot(planar_robot(self.robot), PlanarRobot()):
            print(f"no published plans are of {self.robot.path}: methods _published are left out", flush=True)
            return None
        folder, schedule = Path(self.settings.published), self.settings.schedule
        found = {target: reference_to(target, folder, PlanarRobot(), schedule) for target in self.bench.references}
        return Plans(found, self.body)

    @cached_property
    def _corrected(self) -> Plans | None:
        """Plans for the robot that a diagnosis corrected, and its rigid body in the crouch in which they begin."""
        self.settings.check_plans(PlanSource.corrected)
        robot, found = read_corrected(Path(str(self.settings.corrected)))
        left_out = unplannable_effects(found)
        if left_out:
            print(f"no plan can reckon with {', '.join(left_out)}: methods _corrected are left out", flush=True)
            return None
        planar = planar_robot_with(robot, found)
        targets, schedule = list(self.bench.references), self.settings.schedule
        plan = partial(plan_reference, planar=planar, schedule=schedule)
        references = dict(zip(targets, self.bench.runner.map(plan, targets), strict=True))
        return Plans(references, body_with(robot, found, crouch(references, robot)))
