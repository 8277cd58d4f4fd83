"""The planner's robot with the effects that a diagnosis found, as far as plans can account for them."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.jumping.models.rigid_body_model import rigid_body_of
from leapgap.robot.model import Robot

IN_PLANS = ("armature", "com_offset", "joint_damping", "leg_mass", "payload", "trunk_inertia")
"""Effects that plans can account for; the planar robot has no parameter for the others."""


def plannable(found: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that plans can account for."""
    return tuple(effect for effect in found if effect.name in IN_PLANS and effect.location == "all")


def unplannable_effects(found: Sequence[Effect]) -> list[str]:
    """The effects that plans cannot account for, each with its location, as text."""
    return [f"{effect.name} at {effect.location}" for effect in found if effect not in plannable(found)]


def planar_robot_with(robot: Robot, found: Sequence[Effect]) -> PlanarRobot:
    """The planar robot with effects; one that plans cannot account for is an ``InputError`` with its name."""
    return planar_robot(robot, model_with(robot, found))


def body_with(robot: Robot, found: Sequence[Effect], joint_pos: np.ndarray) -> RigidBody:
    """``rigid_body_of`` the robot with effects that plans can account for, at joint angles (joints,), rad."""
    return rigid_body_of(robot, joint_pos, model_with(robot, found))


def model_with(robot: Robot, found: Sequence[Effect]) -> mujoco.MjModel:
    """A copy of the robot's MuJoCo model with effects that plans can account for."""
    refused = unplannable_effects(found)
    if refused:
        raise InputError(
            "effects in planning",
            ", ".join(refused),
            f"one of {', '.join(IN_PLANS)}, at all",
            "leave it out of the planned robot (effects.json); the simulation can have it",
        )
    model = copy.copy(robot.model)
    for effect in found:
        effect.change_model(model, robot)
    return model
