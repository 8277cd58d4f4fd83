"""Legs of other lengths, fixed elsewhere to the base, than the model has them."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class LegGeometry(Effect):
    """Extra distance of the hips from the middle of the base, and extra length of the legs' last two links.

    Each leg is fixed ``hip_x_m`` further away from the base's origin along its x axis. ``upper_m`` and ``lower_m``
    lengthen the link above the last joint, and the link below it that ends in the foot. Masses and their places in the
    links stay.
    """

    name = "leg_geometry"
    needs_base = True

    hip_x_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)
    upper_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)
    lower_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A base that floats, and feet on limbs of two joints or more."""
        return super().lacks(robot) or (None if legs_of(robot) else "legs with two joints or more and feet")

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the first bodies of the legs, the bodies of their last joints, and all shapes and sites at the feet."""
        if self.is_nominal:
            return
        for first, last, foot in legs_of(robot):
            model.body_pos[first, 0] += np.copysign(self.hip_x_m, model.body_pos[first, 0])
            model.body_pos[last] += self.upper_m * direction(model.body_pos[last])
            geom = model.geom(robot.foot_geom_names[foot]).id
            way = self.lower_m * direction(model.geom_pos[geom])
            for owner, positions in ((model.geom_bodyid, model.geom_pos), (model.site_bodyid, model.site_pos)):
                there = (owner == last) & np.isclose(positions, model.geom_pos[geom], atol=1e-9).all(axis=1)
                positions[there] += way
        recompute_constants(model)


def legs_of(robot: Robot) -> list[tuple[int, int, int]]:
    """First body, body of the last joint, and index of the foot, of each leg with two joints or more."""
    found = []
    for foot in range(len(robot.feet)):
        joints = robot.topology.limbs[robot.limb_of(robot.feet[foot])]
        if len(joints) > 1:
            bodies = [int(robot.joint_bodies[robot.joints.index(joint)]) for joint in (joints[0], joints[-1])]
            found.append((bodies[0], bodies[1], foot))
    return found


def direction(offset: np.ndarray) -> np.ndarray:
    """Unit vector of an offset (3,)."""
    return np.asarray(offset / np.linalg.norm(offset))
