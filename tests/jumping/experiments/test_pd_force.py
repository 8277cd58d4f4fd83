"""Forces that stand for the torques of a joint PD, against virtual work at one pose, and where there are none."""

import numpy as np
import pytest

from leapgap.jumping.experiments.trial import with_pd_force
from leapgap.robot.model import Robot
from tests.conftest import CROUCH, standing


def pulled(robot: Robot, leg: tuple[float, float, float], kinds: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Columns of 20 rows with these joints in every leg; some set points (hip 0, thigh 1, calf 2) are 0.01 rad off."""
    columns = {}
    for i, joint in enumerate(robot.joints):
        columns[f"joint_pos/{joint}"] = np.full(20, leg[i % 3])
        columns[f"cmd_pos/{joint}"] = np.full(20, leg[i % 3] + (0.01 if i % 3 in kinds else 0.0))
    return columns


def test_a_torque_of_the_calf_is_a_force_that_points_at_the_hip(robot: Robot) -> None:
    """Torques of the calves do no work where the feet turn about the hips, so that their force points at the hip."""
    log = with_pd_force(standing(robot, 20, **pulled(robot, CROUCH, (2,))), robot, (0.0,))
    along = np.array([log["pd_force/front_x"][0], log["pd_force/front_z"][0]])
    thigh, calf = CROUCH[1], CROUCH[2]
    upper, lower = 0.2, 0.2
    foot = -np.array(
        [upper * np.sin(thigh) + lower * np.sin(thigh + calf), upper * np.cos(thigh) + lower * np.cos(thigh + calf)]
    )
    assert abs(along @ foot / np.linalg.norm(foot)) == pytest.approx(np.linalg.norm(along), rel=1e-3), "through the hip"


def test_a_foot_as_high_as_its_hip_counts_for_nothing(robot: Robot) -> None:
    """A robot that has fallen may fold its legs so: nothing at the foot pushes sideways, whatever the hip does."""
    calf = -1.0
    folded = (0.0, (np.pi - calf) / 2 + 1e-9, calf)
    log = with_pd_force(standing(robot, 20, **pulled(robot, folded, (0, 1))), robot, (0.0,))
    assert all(np.abs(log[f"pd_force/{axis}"]).max() == 0.0 for axis in ("front_x", "front_z", "rear_x", "rear_z"))
