"""Joints that a model ties to others by equality constraints, as the second finger of many grippers is."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Tie:
    """One joint's position as a linear function of another's: rad, or m of a slide."""

    of: str
    """The other joint."""
    slope: float
    offset: float

    def position(self, of_other: np.ndarray) -> np.ndarray:
        """Position from that of the other joint."""
        return self.slope * of_other + self.offset

    def velocity(self, of_other: np.ndarray) -> np.ndarray:
        """Velocity from that of the other joint."""
        return self.slope * of_other


def tied_joints(robot: Robot, without: Collection[str]) -> Mapping[str, Tie]:
    """Ties of those joints ``without`` a column that no motor drives and that follow a joint with one.

    A joint that follows one which is tied itself is none of them, nor is one whose constraint is curved.
    """
    found: dict[str, Tie] = {}
    for joint, tie in ties(robot.model):
        passive = joint in without and joint not in robot.driven_joints
        if passive and tie.of in robot.joints and tie.of not in without:
            found.setdefault(joint, tie)
    return found


def ties(model: mujoco.MjModel) -> list[tuple[str, Tie]]:
    """Active linear equality constraints between two joints, each in both directions, as joint and tie.

    MuJoCo: q1 − r1 = c0 + c1 (q2 − r2) + …, with the joints' positions r in the reference configuration.
    """
    found = []
    for number in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        constant, slope, *curved = (float(value) for value in model.eq_data[number][:5])
        if second < 0 or slope == 0 or any(curved) or not model.eq_active0[number]:
            continue
        at = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (first, second)]
        offset = at[0] + constant - slope * at[1]
        names = [model.joint(joint).name for joint in (first, second)]
        found.append((names[0], Tie(names[1], slope, offset)))
        found.append((names[1], Tie(names[0], 1 / slope, -offset / slope)))
    return found
