"""What the robot weighs, by the forces of its feet while it stands still."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.evidence.base import LEAST_LOGS, Evidence, Source, agree, sure
from leapgap.effects.bodies import Payload
from leapgap.logs.base_estimate import columns_of_feet
from leapgap.logs.contacts import runs_of
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

STILL_M_PER_S, STILL_RAD_PER_S = 0.02, 0.2  # A robot whose base and joints are slower than this stands still
SHORTEST_S = 0.1  # Shorter stances tell little
BELIEVED = 0.3
"""Feet that bear another weight than the model's by a larger share, or logs that scatter by it, are not in newtons."""


CALIBRATED = 0.03  # Standard deviation of the scale of force sensors, by which their weight only leads a fit


class Standing(Source):
    """Feet that stand still bear the weight of the robot, where their forces are in newtons."""

    name: ClassVar[str] = "standing"

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Take the mass that the feet bear over that of the model; forces in another unit are told, and say no more."""
        if not robot.has_free_base:
            return []
        borne = {log.name: mass for log in logs if (mass := mass_borne(log, robot)) is not None}
        if len(borne) < LEAST_LOGS:
            return []
        mass, spread = agree(borne)
        own = float(robot.model.body_subtreemass[robot.base_body])
        bears = (
            f"feet bear {mass:.2f} ± {spread:.2f} kg where the robot stands still, and the model weighs {own:.2f} kg"
        )
        scatter = float(np.std(list(borne.values())))
        if max(abs(mass - own), scatter) > BELIEVED * own:
            says = f"{bears}: their forces are not in newtons, so they do not show its mass"
            return [Evidence(self.name, "weight_borne", mass, spread, "kg", borne, says)]
        (parameter,) = Payload.parameters(robot)
        spread = float(np.hypot(spread, CALIBRATED * own))
        added = mass - own if sure(mass - own, spread) else parameter.nominal
        per_log = {name: value - own for name, value in borne.items()}
        quantity = f"{Payload.name}.{parameter.name}"
        return [Evidence(self.name, quantity, added, spread, "kg", per_log, bears, held=False)]


def mass_borne(log: Log, robot: Robot) -> float | None:
    """Mass that the forces of the feet bear while the robot stands still, kg; None where it never does, or unlogged."""
    force = columns_of_feet(log, robot, "foot_force")
    speeds = [f"base_linvel_{axis}" for axis in "xyz"]
    joints = [f"joint_vel/{joint}" for joint in robot.joints]
    if force is None or not all(name in log for name in (*speeds, *joints)):
        return None
    still = (np.abs(log.stack(speeds)) < STILL_M_PER_S).all(axis=1)
    still &= (np.abs(log.stack(joints)) < STILL_RAD_PER_S).all(axis=1)
    long_enough = [run for run in runs_of(still) if log.time[run.stop - 1] - log.time[run.start] >= SHORTEST_S]
    if not long_enough:
        return None
    of_rows = np.concatenate([force[run].sum(axis=1) for run in long_enough])
    return float(np.median(of_rows)) / float(np.linalg.norm(gravity_of(robot.model)))
