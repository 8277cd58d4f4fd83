"""Contact stiffness of feet and ground."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, Parameter, mean_of, parameter
from leapgap.effects.contact import decide_contact, foot_contacts, foot_geoms
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class FootCompliance(Effect):
    """Time constant of the feet's contacts (MuJoCo's ``solref``), in place of the model's own; damping ratios stay.

    Where the model has feet of different time constants this is their mean, and each foot keeps its ratio to it.
    """

    name = "foot_compliance"
    places = "feet"

    time_constant_s: float | None = parameter(None, "s", 0.0, inf, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a fifth of the model's own time constant to five times it."""
        own = mean_of(time_constants(foot_contacts(robot, location).solref))
        unit = cls.declarations()["time_constant_s"].unit
        return (Parameter("time_constant_s", unit, own, own / 5, 5 * own, 2 * own, own),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the time constant of the feet."""
        if self.time_constant_s is None or self.is_nominal_for(robot):
            return
        solref = foot_contacts(robot, self.location).solref
        own = time_constants(solref)
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, robot, self.location)
        wanted = self.time_constant_s * (own / mean_of(own))
        direct = solref[:, 0] <= 0
        others = np.divide(model.geom_solref[feet], solref, out=np.ones_like(solref), where=solref != 0)  # have done
        model.geom_solref[feet[~direct], 0] = (wanted * others[:, 0])[~direct]
        ratio = (wanted / own)[direct]
        model.geom_solref[feet[direct]] = solref[direct] * others[direct] / np.column_stack([ratio**2, ratio])


def time_constants(solref: np.ndarray) -> np.ndarray:
    """Time constant of contacts, s, (places,), of ``solref`` (places, 2) in either of MuJoCo's two forms.

    The form of two negative numbers is −stiffness, −damping, and its time constant 2 / damping; without any damping
    it is that of critical damping, 1 / √stiffness.
    """
    stiffness, damping = np.maximum(-solref[:, 0], 1e-12), np.maximum(-solref[:, 1], 0.0)
    of_direct = np.where(damping > 0, 2 / np.maximum(damping, 1e-12), 1 / np.sqrt(stiffness))
    return np.where(solref[:, 0] > 0, solref[:, 0], of_direct)
