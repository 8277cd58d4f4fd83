"""Centre of mass of the planar robot, which Newton's law moves."""

import numpy as np

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.dynamics import PITCH, Vector, X, Z, legs, rotate


def centre_of_mass(robot: PlanarRobot, q: np.ndarray) -> np.ndarray:
    """Centre of mass of the whole robot, (x, z), m, at q (7,)."""
    trunk = Vector(q[X], q[Z]) + rotate(robot.trunk_com_x, robot.trunk_com_z, q[PITCH])
    moment = robot.trunk_mass * trunk
    for leg, of in zip(legs(robot, q), robot.legs, strict=True):
        moment = moment + (2 * of.thigh.mass) * (leg.hip + leg.hip_to_thigh_com)
        moment = moment + (2 * of.calf.mass) * (leg.knee + leg.knee_to_calf_com)
    return np.array([float(moment.x), float(moment.z)]) / robot.total_mass
