"""Terrain: what of a model is ground, and boxes on it."""

from dataclasses import dataclass

import mujoco
import numpy as np


def ground_bodies(model: mujoco.MjModel) -> np.ndarray:
    """The world, and the bodies of every branch in which nothing moves: no joint, no mocap body. Indices, rising."""
    moves = (model.body_jntnum > 0) | (model.body_mocapid >= 0)
    moving = np.unique(model.body_rootid[np.flatnonzero(moves)])
    return np.flatnonzero(~np.isin(model.body_rootid, moving))


def ground_of_spec(spec: mujoco.MjSpec) -> list[mujoco.MjsGeom]:
    """The same geoms of a specification, in the order of the compiled model."""

    def still(body: mujoco.MjsBody) -> bool:
        return not body.joints and not body.mocap and all(map(still, body.bodies))

    def below(body: mujoco.MjsBody) -> list[mujoco.MjsGeom]:
        return [*body.geoms, *(geom for child in body.bodies for geom in below(child))]

    return [*spec.worldbody.geoms, *(geom for body in spec.worldbody.bodies if still(body) for geom in below(body))]


def ground_geoms(model: mujoco.MjModel) -> np.ndarray:
    """The geoms that belong to the ground, whether they can be touched or not; indices, rising."""
    return np.flatnonzero(np.isin(model.geom_bodyid, ground_bodies(model)))


@dataclass(frozen=True)
class Box:
    """A block on the floor: centre (x, y), edge lengths and height of the upper face, m, world frame."""

    x_m: float
    y_m: float
    size_m: tuple[float, float, float]
    top_m: float
    estimated: bool = False  # true where the height was inferred from the log, not measured
