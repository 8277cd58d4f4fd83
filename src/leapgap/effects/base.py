"""What an effect is: something the nominal robot leaves out, with a place, parameters and a way into the simulation."""

from abc import ABC
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import mujoco
import numpy as np

from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: its unit, the value at which the effect is absent, and the range that is searched."""

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float


def parameter(nominal: float, unit: str, lower: float, upper: float) -> Any:
    """Declare a dataclass field as a parameter; its default is the nominal value, where the effect is absent."""
    return field(default=nominal, metadata={"unit": unit, "lower": lower, "upper": upper})


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
    """One unmodelled effect; ``collect`` injects it and ``diagnose`` looks for it, through the same two methods.

    At its nominal parameters it changes nothing, bit for bit. A subclass is one file with one frozen dataclass:
    its parameters (declared with ``parameter``), ``name``, and whichever of the two methods it acts through.
    """

    location: str = "all"
    """Where it acts: all, front, rear, a joint group, a leg, a joint, a foot."""

    name: ClassVar[str]
    differs_per_log: ClassVar[bool] = False
    """Whether its value may differ from jump to jump."""
    places: ClassVar[str] = "none"
    """What ``location`` chooses among: ``joints``, ``feet``, or ``none`` (acts on the robot as a whole)."""

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of their declaration."""
        return tuple(
            Parameter(f.name, f.metadata["unit"], f.default, f.metadata["lower"], f.metadata["upper"])  # type: ignore[arg-type]
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

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:  # noqa: B027
        """Put the effect into a model that is the caller's own; gains and the control period are already in it."""

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """What reaches the joints of what was sent, one row a control period."""
        return commands


def recompute_constants(model: mujoco.MjModel) -> None:
    """Renew what MuJoCo derives from masses and armatures, after a change of them."""
    mujoco.mj_setConst(model, mujoco.MjData(model))
