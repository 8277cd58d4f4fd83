"""Contact parameters of the feet on the ground, and how an effect sets them."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.robot.model import Robot
from leapgap.robot.terrain import ground_geoms


@dataclass(frozen=True)
class FootContacts:
    """MuJoCo's contact parameters of some feet on the ground, one row a foot."""

    condim: np.ndarray
    friction: np.ndarray
    """(feet, 3): sliding, torsional, rolling."""
    solref: np.ndarray
    """(feet, 2)"""
    solimp: np.ndarray
    """(feet, 5)"""


def foot_geoms(model: mujoco.MjModel, robot: Robot, location: str) -> np.ndarray:
    """Geoms of the feet at a location, by name: terrain and other parts shift the robot's own numbers."""
    return np.array([model.geom(robot.foot_geom_names[foot]).id for foot in robot.feet_at(location)], dtype=int)


def foot_contacts(robot: Robot, location: str) -> FootContacts:
    """Contact parameters of the feet at a location on the ground of the robot's model file."""
    model = robot.model
    mixed = [mixed_contact(model, int(foot)) for foot in robot.foot_geoms[robot.feet_at(location)]]
    return FootContacts(*(np.array(of_all) for of_all in zip(*mixed, strict=True)))


def mixed_contact(model: mujoco.MjModel, foot: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Condim, friction, solref and solimp of a foot on the first part of the world that it can touch.

    The geom of higher priority decides; of equal ones MuJoCo takes the larger friction and condim and mixes the rest.
    """
    ground = ground_under(model, foot)
    if ground is None or model.geom_priority[foot] > model.geom_priority[ground]:
        return contact_of(model, foot)
    if model.geom_priority[foot] < model.geom_priority[ground]:
        return contact_of(model, ground)
    own, other = contact_of(model, foot), contact_of(model, ground)
    share = solver_mix(float(model.geom_solmix[foot]), float(model.geom_solmix[ground]))
    both_standard = own[2][0] > 0 and other[2][0] > 0
    solref = share * own[2] + (1 - share) * other[2] if both_standard else np.minimum(own[2], other[2])
    solimp = share * own[3] + (1 - share) * other[3]
    return max(own[0], other[0]), np.maximum(own[1], other[1]), solref, solimp


def ground_under(model: mujoco.MjModel, foot: int) -> int | None:
    """The first geom of the ground that a foot can touch; None where the model has no ground."""
    for geom in ground_geoms(model):
        contype, conaffinity = model.geom_contype, model.geom_conaffinity
        if contype[foot] & conaffinity[geom] or contype[geom] & conaffinity[foot]:
            return int(geom)
    return None


def contact_of(model: mujoco.MjModel, geom: int) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Condim, friction, solref and solimp of one geom."""
    friction, solref, solimp = model.geom_friction[geom], model.geom_solref[geom], model.geom_solimp[geom]
    return int(model.geom_condim[geom]), friction.copy(), solref.copy(), solimp.copy()


def solver_mix(own: float, other: float) -> float:
    """Weight of the first geom when MuJoCo mixes by ``solmix``; it treats weights below 1e-15 as zero."""
    least = 1e-15
    if own >= least and other >= least:
        return own / (own + other)
    return 0.5 if own < least and other < least else float(own >= least)


def decide_contact(model: mujoco.MjModel, robot: Robot, location: str) -> None:
    """Give the feet at a location the highest priority, so that their own contact parameters hold on any ground.

    The parameters of the contacts stay as they are: a foot that did not have the highest priority gets the parameters
    that MuJoCo mixed for it.
    """
    feet = foot_geoms(model, robot, location)
    others = np.setdiff1d(np.arange(model.ngeom), foot_geoms(model, robot, "all"))
    highest = int(model.geom_priority[others].max(initial=-1))
    for foot in feet[model.geom_priority[feet] <= highest]:
        fields = (model.geom_condim, model.geom_friction, model.geom_solref, model.geom_solimp)
        for values, mixed in zip(fields, mixed_contact(model, int(foot)), strict=True):
            values[foot] = mixed
        model.geom_priority[foot] = highest + 1
