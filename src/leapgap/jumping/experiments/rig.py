"""One simulated robot with everything that methods need to be prepared on it, and the settings of the experiment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from leapgap.errors import InputError
from leapgap.jumping.control.mpc import MpcConfig
from leapgap.jumping.experiments.bench import Bench
from leapgap.jumping.experiments.goal_directed_jump import AIMED_LIMITS
from leapgap.jumping.experiments.method import Method, References, crouch
from leapgap.jumping.experiments.methods.base import MethodSettings, PlanSource
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.training_jumps import PracticeConfig
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.corrected_robot import beyond_plans, body_with, planned_with
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.planning.problem import Limits
from leapgap.jumping.planning.reference_store import planned, reference_to
from leapgap.logs.log import Log
from leapgap.logs.segments import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import read_corrected


@dataclass(frozen=True)
class AdaptConfig:
    """How an offset a task is learned from its own jumps."""

    jumps: int = 4
    """Of each task, one after the other."""
    rate: float = 0.7
    """Share of a surprise that is believed."""


@dataclass(frozen=True)
class LandSettings:
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
    grids: dict[str, Any]
    """Steps of the MPC by name, each the fields of a ``TimeGrid``."""
    method_settings: dict[str, Any]
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    mpc: MpcConfig = field(default_factory=MpcConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    limits: Limits = AIMED_LIMITS
    """Of the plans of `ours`."""

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
        """An entry of ``grids`` or ``models``; a method that names one that is not there is refused."""
        entries = getattr(self, part)
        if key not in entries:
            where, expected = f"land.method_settings.{method}", f"a key of land.{part}: {', '.join(entries)}"
            raise InputError(where, key, expected, "add it there")
        return entries[key]

    def check_plans(self, source: PlanSource) -> None:
        """Plans for a corrected robot need the folder of a diagnosis."""
        if source is PlanSource.corrected and self.corrected is None:
            raise InputError("land.corrected", "no folder", "a folder 'corrected' of a diagnosis", "name one")


@dataclass(frozen=True)
class Plans:
    """Plans to all targets, and the rigid body of the robot that they are made for."""

    references: References
    body: RigidBody


@dataclass
class Rig:
    """One hardware; methods are prepared when they are asked for, each once."""

    settings: LandSettings
    known: Mapping[str, MethodSettings]
    """Methods by name."""
    bench: Bench
    tasks: Sequence[JumpTask]
    body: RigidBody
    """What controllers take the nominal robot for."""
    _prepared: dict[str, Method | None] = field(default_factory=dict)

    @property
    def robot(self) -> Robot:
        """The robot that controllers believe in."""
        return self.bench.robot

    def method(self, name: str) -> Method | None:
        """The method of that name, prepared; None where something that it needs is not there."""
        if name not in self._prepared:
            self._prepared[name] = self.known[name].prepare(name, self)
        return self._prepared[name]

    def plan(self, target: Target) -> Log:
        """A plan of the nominal robot from level ground."""
        return reference_to(target, Path(self.settings.references), planar_robot(self.robot), self.settings.schedule)

    def plans(self, source: PlanSource) -> Plans | None:
        """Those of a source; None where a corrected robot has an effect that no plan can reckon with."""
        makers: dict[PlanSource, Callable[[], Plans | None]] = {
            PlanSource.own: lambda: Plans(self.bench.references, self.body),
            PlanSource.published: lambda: self._published,
            PlanSource.corrected: lambda: self._corrected,
        }
        return makers[source]()

    @cached_property
    def _published(self) -> Plans:
        """Plans for the masses of the published planner; who predicts with a body still takes the robot's own."""
        folder, schedule = Path(self.settings.published), self.settings.schedule
        found = {target: reference_to(target, folder, PlanarRobot(), schedule) for target in self.bench.references}
        return Plans(found, self.body)

    @cached_property
    def _corrected(self) -> Plans | None:
        """Plans for the robot that a diagnosis corrected, and its rigid body in the crouch they begin in."""
        self.settings.check_plans(PlanSource.corrected)
        robot, found = read_corrected(Path(str(self.settings.corrected)))
        beyond = beyond_plans(found)
        if beyond:
            print(f"no plan can reckon with {', '.join(beyond)}: methods _corrected are left out", flush=True)
            return None
        planar = planned_with(robot, found)
        references = {target: planned(target, planar, self.settings.schedule) for target in self.bench.references}
        return Plans(references, body_with(robot, found, crouch(references, robot)))
