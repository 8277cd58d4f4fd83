"""The nominal rigid body: computed from a robot's model, and used as a prediction model of the MPC."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.jumping.models.affine_model import AffineModel, PredictionModel, Situation
from leapgap.jumping.models.rigid_body import GRAVITY, RigidBody
from leapgap.robot.model import Robot

ROUNDING_TOLERANCE = 0.005
"""Largest relative difference between figures rounded to three digits and those of the model."""


@dataclass(frozen=True)
class RigidBodyModel(PredictionModel):
    """Accelerations by gravity and the forces of the feet; in flight by gravity alone."""

    body: RigidBody

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        """Accelerations at n moments of contact or flight (bool, (n,)), as ``PredictionModel`` defines them."""
        bias = np.tile([0.0, -GRAVITY, 0.0], (len(contact), 1))
        return AffineModel(bias, self.body.force_rows(situation.foot) * np.asarray(contact)[:, None, None])


def rigid_body_of(robot: Robot, joint_pos: np.ndarray, model: mujoco.MjModel | None = None) -> RigidBody:
    """Mass and composite pitch inertia about the centre of mass, with level trunk and joint angles (joints,), rad.

    ``model`` is the robot's own unless another one with the same bodies is given.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    data.qpos[3:7] = [1, 0, 0, 0]
    data.qpos[robot.joint_qpos] = joint_pos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    arm = data.xipos - data.subtree_com[robot.base_body]
    rotation = data.ximat.reshape(-1, 3, 3)
    own = np.einsum("bi,bi->b", rotation[:, 1] ** 2, model.body_inertia)  # about y of the world, through its own centre
    inertia = own + model.body_mass * (arm[:, 0] ** 2 + arm[:, 2] ** 2)
    return RigidBody(float(model.body_mass.sum()), float(inertia.sum()))


def planner_body(robot: Robot, joint_pos: np.ndarray, rounded: RigidBody | None) -> RigidBody:
    """The rigid body that controllers assume: ``rounded`` where it fits this model, else the model's own.

    A ``rounded`` body that differs by more than rounding belongs to another robot and is ignored. A model file given by
    hand is therefore never controlled with the mass of the robot in the configuration.
    """
    own = rigid_body_of(robot, joint_pos)
    if rounded is None:
        return own
    here = np.array([own.mass_kg, own.pitch_inertia_kgm2])
    stated = np.array([rounded.mass_kg, rounded.pitch_inertia_kgm2])
    return rounded if (np.abs(stated / here - 1) <= ROUNDING_TOLERANCE).all() else own
