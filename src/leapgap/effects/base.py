"""What an effect is: something the nominal robot leaves out, with a place, parameters and a way into the simulation."""

from abc import ABC
from collections.abc import Hashable
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import mujoco
import numpy as np

from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: its unit, the value at which the effect is absent, and the range that is searched."""

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    moderate: float
    """A value that a person would notice in the motion: where signatures are taken and searches begin."""


def parameter(nominal: float, unit: str, lower: float, upper: float, moderate: float | None = None) -> Any:
    """Declare a dataclass field as a parameter; its default is the nominal value, where the effect is absent."""
    if moderate is None:
        moderate = nominal + max(upper - nominal, lower - nominal, key=abs) / 10
    return field(default=nominal, metadata={"unit": unit, "lower": lower, "upper": upper, "moderate": moderate})


@dataclass(frozen=True)
class Commands:
    """What the computer sends to the joints: shape (rows, joints) each, joint order of the robot."""

    torque: np.ndarray
    """Feed-forward, N·m."""
    position: np.ndarray
    """Set point of the joint PD, rad."""
    velocity: np.ndarray
    """Set point of the joint PD, rad/s."""


@dataclass(frozen=True)
class Effect(ABC):
    """One unmodelled effect; ``collect`` injects it and ``diagnose`` looks for it, through the same methods.

    At its nominal parameters it changes nothing, bit for bit. A subclass is one file with one frozen dataclass:
    its parameters (declared with ``parameter``), ``name``, and whichever of the methods ``change_…`` it acts through.
    Effects that act together do so in any order.
    """

    location: str = "all"
    """Where it acts: all, front, rear, a joint group, a leg, a joint, a foot."""

    name: ClassVar[str]
    differs_per_log: ClassVar[bool] = False
    """Whether its value may differ from jump to jump."""
    needs_base: ClassVar[bool] = False
    """Whether it says nothing about a robot that is fixed to the ground."""
    places: ClassVar[str] = "none"
    """What ``location`` chooses among: ``joints``, ``feet``, or ``none`` (acts on the robot as a whole)."""

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of their declaration."""
        return tuple(
            Parameter(f.name, nominal=f.default, **f.metadata)  # type: ignore[arg-type]
            for f in fields(cls)
            if "unit" in f.metadata
        )

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name."""
        return {p.name: getattr(self, p.name) for p in self.parameters()}

    @property
    def is_nominal(self) -> bool:
        """Whether every parameter has the value at which the effect is absent."""
        return all(getattr(self, p.name) == p.nominal for p in self.parameters())

    def changing(self, profile: tuple[float, ...]) -> "Effect":
        """The same where its value changes within a log: shares of it, evenly spaced from first row to last."""
        return self

    @property
    def structure(self) -> Hashable | None:
        """Names what ``change_spec`` adds, whatever its size; None where the model keeps its parts.

        Models of equal structure share one batch and are compiled once.
        """
        return None

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:  # noqa: B027
        """Add the parts that ``structure`` names; ``change_model`` then gives them their size."""

    def change_period(self, period_s: float) -> float:
        """True length of a control period, s, of what is believed."""
        return period_s

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """True lengths of the rows of a log, in true control periods, (rows,), of what is believed."""
        return lengths

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """The motors and the joint PD that are, of those that are believed."""
        return drive

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:  # noqa: B027
        """Put the effect into a model that is the caller's own; period and motors are already in it."""

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """What reaches the joints of what was sent, one row a control period of ``period_s`` true seconds."""
        return commands

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """What the log reports of a true motion."""
        return motion

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """The true state behind a reported one that a motion starts from: the inverse of ``change_measured``."""
        return start


def recompute_constants(model: mujoco.MjModel) -> None:
    """Renew what MuJoCo derives from masses, armatures and shapes, after a change of them."""
    mujoco.mj_setConst(model, mujoco.MjData(model))


def foot_geoms(model: mujoco.MjModel, robot: Robot, location: str) -> np.ndarray:
    """Geoms of the feet at a location, by name: terrain and other parts shift the robot's own numbers."""
    return np.array([model.geom(robot.feet[foot]).id for foot in robot.feet_at(location)], dtype=int)


def decide_contact(model: mujoco.MjModel, geoms: np.ndarray) -> None:
    """Let friction and compliance of these geoms hold in their contacts, whatever they touch.

    MuJoCo takes both from the geom of higher priority, and mixes those of equal ones.
    """
    others = np.setdiff1d(np.arange(model.ngeom), geoms)
    highest = int(model.geom_priority[others].max(initial=-1))
    model.geom_priority[geoms] = np.maximum(model.geom_priority[geoms], highest + 1)
