"""The nominal rigid body: of a robot's model, and as a prediction model, what the MPC plans with before learning."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.jumping.models.affine_model import AffineModel, PredictionModel, Situation
from leapgap.jumping.models.rigid_body import GRAVITY, RigidBody
from leapgap.robot.model import Robot

ROUNDED_WITHIN = 0.005
"""Relative: figures of a robot that are rounded to three digits are no farther from those of its model."""


@dataclass(frozen=True)
class RigidBodyModel(PredictionModel):
    """Gravity and the forces of the feet; nothing but gravity in flight."""

    body: RigidBody

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """Accelerations at n moments of contact or flight (bool, (n,)), as ``PredictionModel`` defines them."""
        bias = np.tile([0.0, -GRAVITY, 0.0], (len(contact), 1))
        return AffineModel(bias, self.body.force_rows(situation.foot) * np.asarray(contact)[:, None, None])


def rigid_body_of(robot: Robot, joint_pos: np.ndarray, model: mujoco.MjModel | None = None) -> RigidBody:
    """Mass and composite pitch inertia about the centre of mass, trunk level, joints (joints,) rad as given.

    ``model`` is the robot's own unless another one with the same bodies is given.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    data.qpos[3:7] = [1, 0, 0, 0]
    data.qpos[robot.joint_qpos] = joint_pos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    away = data.xipos - data.subtree_com[robot.base_body]
    turned = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", turned[:, 1] ** 2, model.body_inertia)  # about y of the world, through its own centre
    inertia = own + model.body_mass * (away[:, 0] ** 2 + away[:, 2] ** 2)
    return RigidBody(float(model.body_mass.sum()), float(inertia.sum()))


def planner_body(robot: Robot, joint_pos: np.ndarray, rounded: RigidBody | None) -> RigidBody:
    """What controllers take the robot for: its ``rounded`` figures where they are this model's, else the model's own.

    Rounded figures that belong to another robot (differ by more than rounding) are left aside, so that a model file
    named by hand is never driven with the mass of the robot that the configuration describes.
    """
    own = rigid_body_of(robot, joint_pos)
    if rounded is None:
        return own
    here = np.array([own.mass_kg, own.pitch_inertia_kgm2])
    stated = np.array([rounded.mass_kg, rounded.pitch_inertia_kgm2])
    return rounded if (np.abs(stated / here - 1) <= ROUNDED_WITHIN).all() else own
