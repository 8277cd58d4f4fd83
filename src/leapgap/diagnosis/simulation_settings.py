"""Settings of the simulation that a robot knows nothing of: its integrator and how it computes contacts."""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from leapgap.effects.base import Effect
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class SimulationSettings(Effect):
    """The simulation's own integrator and contacts; it is no cause, and no registry has it."""

    name = "simulation_settings"

    integrator: int | None = None
    other_cone: bool = False
    """Whether the friction cone is the pyramid where the model has the ellipse, and the other way round."""
    friction_impedance: float = 1.0  # Factor on ``impratio``, which stays at least 1
    slack: float = 1.0  # Factor on one minus the impedances of all contacts (``solimp``)
    width: float = 1.0  # Factor on the depth over which that impedance rises

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Put the settings into a model."""
        if self.integrator is not None:
            model.opt.integrator = self.integrator
        if self.other_cone:
            pyramid = model.opt.cone == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
            model.opt.cone = int(mujoco.mjtCone.mjCONE_ELLIPTIC if pyramid else mujoco.mjtCone.mjCONE_PYRAMIDAL)
        model.opt.impratio = max(1.0, model.opt.impratio * self.friction_impedance)
        for solimp in (model.geom_solimp, model.pair_solimp):
            solimp[:, :2] = 1 - np.clip((1 - solimp[:, :2]) * self.slack, 1e-4, 0.9999)
            solimp[:, 2] *= self.width

    def has(self, name: str) -> bool:
        """Whether a setting is changed."""
        return bool(getattr(self, name) != getattr(SimulationSettings(), name))

    def changed(self, name: str, by: float) -> "SimulationSettings":
        """The same with one setting times a factor, or with the other cone."""
        changed: dict[str, Any] = {name: not self.other_cone if name == "other_cone" else by * getattr(self, name)}
        return replace(self, **changed)

    @property
    def in_words(self) -> str:
        """What is changed of contacts, in the terms of a model file."""
        factors = {
            "impratio": self.friction_impedance,
            "1 − solimp's impedance": self.slack,
            "solimp's width": self.width,
        }
        changes = [f"{name} × {by:.3g}" for name, by in factors.items() if by != 1]
        return ", ".join([*(["the other friction cone"] if self.other_cone else []), *changes])
