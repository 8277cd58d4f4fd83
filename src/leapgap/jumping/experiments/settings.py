"""Settings of the landing experiment: section ``land`` of the configuration."""

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.border import JointGains
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.mpc import MpcConfig, StateWeights
from leapgap.jumping.control.tracking import Excitation, PhaseGains
from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS, AimConfig
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.planning.problem import Limits
from leapgap.jumping.task import ContactSchedule


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
