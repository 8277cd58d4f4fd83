"""A corrected robot on disk: the model and the effects a diagnosis found, ready to simulate and to plan with."""

import copy
import shutil
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.files import read_json, write_json
from leapgap.robot.model import Robot
from leapgap.robot.nominal import rigid_body_of
from leapgap.robot.planar import PlanarRobot, planar_robot
from leapgap.robot.rigid_body import RigidBody

IN_PLANS = ("armature", "com_offset", "joint_damping", "leg_mass", "payload", "trunk_inertia")
"""Effects that a plan can reckon with; the others are no part of the planar robot."""
MODEL, EFFECTS = "robot.xml", "effects.json"


def write_corrected(folder: Path, robot: Robot, found: tuple[Effect, ...]) -> None:
    """Write the nominal model beside the effects to add to it."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(robot.path, folder / MODEL)
    write_json(folder / EFFECTS, {"effects": effects.to_config(found)})


def read_corrected(folder: Path, own: Sequence[type[Effect]] = ()) -> tuple[Robot, tuple[Effect, ...]]:
    """Model and effects of a folder ``corrected``; ``own`` are the user's classes that may be among the effects."""
    entries = read_json(folder / EFFECTS).get("effects")
    if not isinstance(entries, list):
        raise InputError(folder / EFFECTS, "no list of effects", "the key effects", "write it as a diagnosis does")
    return Robot.load(folder / MODEL), effects.from_config(entries, effects.registry(own))


def plannable(found: Sequence[Effect]) -> tuple[Effect, ...]:
    """Those of the effects that a plan can reckon with."""
    return tuple(effect for effect in found if effect.name in IN_PLANS and effect.location == "all")


def beyond_plans(found: Sequence[Effect]) -> list[str]:
    """The others, with their places."""
    return [f"{effect.name} at {effect.location}" for effect in found if effect not in plannable(found)]


def planned_with(robot: Robot, found: Sequence[Effect]) -> PlanarRobot:
    """The planar robot with effects in it; one that no plan can reckon with is an ``InputError`` by its name."""
    return planar_robot(robot, changed(robot, found))


def body_with(robot: Robot, found: Sequence[Effect], joint_pos: np.ndarray) -> RigidBody:
    """``rigid_body_of`` the robot with effects that a plan can reckon with, joints (joints,) rad as given."""
    return rigid_body_of(robot, joint_pos, changed(robot, found))


def changed(robot: Robot, found: Sequence[Effect]) -> mujoco.MjModel:
    """The robot's model with effects that a plan can reckon with."""
    refused = beyond_plans(found)
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
