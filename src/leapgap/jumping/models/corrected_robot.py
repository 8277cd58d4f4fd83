"""The planner's robot with the effects a diagnosis found in it, as far as a plan can reckon with them."""

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
"""Effects that a plan can reckon with; the others are no part of the planar robot."""


def plannable(found: Sequence[Effect]) -> tuple[Effect, ...]:
    """Those of the effects that a plan can reckon with."""
    return tuple(effect for effect in found if effect.name in IN_PLANS and effect.location == "all")


def unplannable_effects(found: Sequence[Effect]) -> list[str]:
    """The others, with their places."""
    return [f"{effect.name} at {effect.location}" for effect in found if effect not in plannable(found)]


def planar_robot_with(robot: Robot, found: Sequence[Effect]) -> PlanarRobot:
    """The planar robot with effects in it; one that no plan can reckon with is an ``InputError`` by its name."""
    return planar_robot(robot, changed(robot, found))


def body_with(robot: Robot, found: Sequence[Effect], joint_pos: np.ndarray) -> RigidBody:
    """``rigid_body_of`` the robot with effects that a plan can reckon with, joints (joints,) rad as given."""
    return rigid_body_of(robot, joint_pos, changed(robot, found))


def changed(robot: Robot, found: Sequence[Effect]) -> mujoco.MjModel:
    """The robot's model with effects that a plan can reckon with."""
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
