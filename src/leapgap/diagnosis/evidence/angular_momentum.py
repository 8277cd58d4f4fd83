"""How hard the trunk turns, by the longest flight of each log."""

from collections.abc import Sequence
from typing import ClassVar

import mujoco

from leapgap.diagnosis.evidence.base import LEAST_LOGS, Evidence, Source, agree, sure, told_model
from leapgap.diagnosis.evidence.flight import clean_flight
from leapgap.effects.bodies import TrunkInertia
from leapgap.logs.contacts import has_feet_in_world
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import momenta
from leapgap.robot.model import Robot

RATES = ("base_angvel_x", "base_angvel_y", "base_angvel_z")
EXPLAINED = 0.5
"""The trunk's own part has to explain so large a share of how the angular momentum of the others changes."""
TOLD = 0.15  # The scale of the inertia is told where it scatters by less over the logs


class AngularMomentum(Source):
    """In the air the angular momentum about the centre of mass stays: legs that turn one way turn the trunk the other.

    How much the trunk turns for it tells its inertia, in units of the legs'. Where the legs are and where the trunk's
    centre of mass is has to be right, so evidence of these is taken first.
    """

    name: ClassVar[str] = "angular_momentum"
    place: ClassVar[int] = 1

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Fit the scale of the trunk's inertia to the longest flight of each log."""
        if not all(has_feet_in_world(log, robot) and RATES[1] in log for log in logs):
            return []
        model = told_model(robot, before)
        fits = {log.name: fit for log in logs if (fit := inertia_in_flight(log, robot, model)) is not None}
        if len(fits) < LEAST_LOGS:
            return []
        value, spread = agree(fits)
        if spread > TOLD:
            return []
        says = f"in flight the trunk turns against the legs as with {value:.2f} ± {spread:.2f} times its inertia"
        (parameter,) = TrunkInertia.parameters(robot)
        value = value if sure(value - parameter.nominal, spread) else parameter.nominal
        return [Evidence(self.name, f"{TrunkInertia.name}.{parameter.name}", value, spread, "1", fits, says)]


def inertia_in_flight(log: Log, robot: Robot, model: mujoco.MjModel) -> float | None:
    """Scale of the trunk's inertia that keeps the angular momentum, by least squares; None without a clean flight.

    Only the axes of which the rate of the trunk was logged count.
    """
    rows = clean_flight(log, robot)
    if rows is None:
        return None
    motion = motion_of(log, robot, rows)
    heavier = model.__copy__()
    TrunkInertia(scale=2.0).change_model(heavier, robot)
    axes = [k for k, rate in enumerate(RATES) if rate in log]
    whole = momenta(robot, motion, model)[1][:, axes]
    trunk = momenta(robot, motion, heavier)[1][:, axes] - whole
    changes, by_trunk = (part - part.mean(axis=0) for part in (whole, trunk))
    departs = -float((by_trunk * changes).sum() / max((by_trunk**2).sum(), 1e-300))
    left, others = changes + departs * by_trunk, changes - by_trunk
    return 1 + departs if (left**2).sum() < (1 - EXPLAINED) * (others**2).sum() else None
