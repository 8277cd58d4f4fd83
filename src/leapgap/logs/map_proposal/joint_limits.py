"""Limits of a robot's joints, and whether positions may lie within them."""

import math

import numpy as np

from leapgap.robot.model import Robot

MARGIN_RAD = 0.1
"""Positions may lie beyond the limits by this much: play, soft stops."""
TURN_RAD = 2 * math.pi - 0.2
"""Limits that are further apart are no stops: the joint may turn over, whatever the model file says."""
SPUN_RAD = 3 * math.pi
"""A joint without stops that is further from zero is rather one of another unit."""


def real_limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Limits of each joint, rad (m of a slide), (joints, 2), and whether they are stops; without, ±3π stand there."""
    limits, real = np.full((len(robot.joints), 2), [-SPUN_RAD, SPUN_RAD]), np.zeros(len(robot.joints), dtype=bool)
    for i, name in enumerate(robot.joints):
        joint = robot.model.joint(name)
        if joint.limited[0] and np.ptp(joint.range) < TURN_RAD:
            limits[i], real[i] = joint.range, True
    return limits, real


def inside(low: np.ndarray, high: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Whether each range of positions, from ``low`` to ``high``, lies within its limits."""
    return (low > limits[..., 0] - MARGIN_RAD) & (high < limits[..., 1] + MARGIN_RAD)
