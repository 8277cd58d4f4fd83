"""How far the soft ground of a model gives way under a robot that stands on it."""

import mujoco
import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE

DEEPEST_M = 0.015
"""Ground that bears the weight of a robot no sooner than at this depth does not: the motors give way instead."""
HALVINGS = 9
"""Number of times that this depth is halved: to 0.03 mm."""


def sinking_depths(robot: Robot, qpos: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """How far the base is lower than in each given pose where the ground bears the weight, m, (poses,).

    ``qpos`` is (poses, nq), with the lowest soles just at the ground; ``torque`` (poses, nv) are the torques of the
    motors. At the depth that is found, the model's ground pushes up as much as the robot weighs, at rest. It is NaN
    where the model has no ground, or the motors do not hold the robot up.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weight = robot.total_mass * float(-model.opt.gravity[2])
    up = POSITION_SLICE.stop - 1
    found = np.full(len(qpos), np.nan)

    def bears(pose: np.ndarray, motors: np.ndarray, depth: float) -> bool:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        data.qpos[up] -= depth
        data.qfrc_applied[:] = motors
        mujoco.mj_forward(model, data)
        return bool(data.qfrc_constraint[up] >= weight)

    for k, (pose, motors) in enumerate(zip(qpos, torque, strict=True)):
        low, high = 0.0, DEEPEST_M
        if not bears(pose, motors, high):
            continue
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if bears(pose, motors, middle) else (middle, high)
        found[k] = (low + high) / 2
    return found
