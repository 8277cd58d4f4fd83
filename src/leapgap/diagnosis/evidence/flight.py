"""Where the centre of mass is, and how fast it falls, by the longest flight of each log."""

from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from leapgap.diagnosis.evidence.base import LEAST_LOGS, Evidence, Source, agree, slopes
from leapgap.effects.com_offset import ComOffset
from leapgap.logs.contacts import has_feet_in_world, in_flight, longest_run
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot

SHORTEST_S = 0.15
"""A shorter flight turns the robot too little to tell where its centre of mass is."""
MARGIN_S = 0.02
"""So much at both ends of a flight is left out: a foot may still touch."""
STRAIGHT_M = 0.001
"""A flight in which the centre of mass leaves its parabola by more, rms, had a contact."""


class Flight(Source):
    """In the air nothing but gravity moves the centre of mass: forward evenly, up and down by a parabola.

    A trunk that turns while it flies would bend that path, were its centre of mass elsewhere than the model has it.
    """

    name: ClassVar[str] = "flight"

    def gather(self, logs: Sequence[Log], robot: Robot) -> list[Evidence]:
        """Fit g and the offset of the trunk's centre of mass to the longest flight of each log."""
        if not all(has_feet_in_world(log, robot) for log in logs):
            return []
        found = {log.name: fit for log in logs if (fit := fit_flight(log, robot)) is not None}
        if len(found) < LEAST_LOGS:
            return []
        names = ["gravity", *(f"{ComOffset.name}.{p.name}" for p in ComOffset.parameters(robot))]
        units = ["m/s²", *(p.unit for p in ComOffset.parameters(robot))]
        told = []
        for k, (quantity, unit) in enumerate(zip(names, units, strict=True)):
            per_log = {log: float(fit[k]) for log, fit in found.items()}
            value, spread = agree(per_log)
            size = f"{value:.3f} ± {spread:.3f} m/s²" if k == 0 else f"{1000 * value:.1f} ± {1000 * spread:.1f} mm"
            what = "the centre of mass falls with" if k == 0 else f"the trunk's centre of mass is off by ({quantity})"
            told.append(Evidence(self.name, quantity, value, spread, unit, per_log, f"in flight {what} {size}"))
        return told


def fit_flight(log: Log, robot: Robot) -> np.ndarray | None:
    """Gravity, then the parameters of ``com_offset``, by least squares; None where the log has no clean flight."""
    flight = longest_run(in_flight(log, robot))
    margin = log.info.rows(MARGIN_S)
    rows = slice(flight.start + margin, flight.stop - margin)
    if rows.stop - rows.start < log.info.rows(SHORTEST_S):
        return None
    qpos = motion_of(log, robot, rows).qpos

    def centres(model: mujoco.MjModel) -> np.ndarray:
        return centre_of_mass(model, robot.base_body, qpos)[:, [0, 2]]

    _, path, by = slopes(ComOffset, robot, centres)
    time = log.time[rows] - log.time[rows].mean()
    one, none = np.ones_like(time), np.zeros_like(time)
    # Unknown: two places, two velocities, g, then the offsets, which the path must not contain.
    forward = np.column_stack([one, time, none, none, none, -by[:, 0]])
    upward = np.column_stack([none, none, one, time, -(time**2) / 2, -by[:, 1]])
    matrix, right = np.concatenate([forward, upward]), np.concatenate([path[:, 0], path[:, 1]])
    found, *_ = np.linalg.lstsq(matrix, right, rcond=None)
    straight = np.sqrt(np.mean((right - matrix @ found) ** 2)) < STRAIGHT_M
    return found[4:] if straight else None


def centre_of_mass(model: mujoco.MjModel, body: int, qpos: np.ndarray) -> np.ndarray:
    """Centre of mass of all that hangs on a body, m, world frame, (rows, 3)."""
    data, found = mujoco.MjData(model), np.empty((len(qpos), 3))
    for row, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        found[row] = data.subtree_com[body]
    return found
