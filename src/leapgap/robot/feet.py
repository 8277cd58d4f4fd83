"""Feet of a robot: geoms or sites, where they are, and which geoms of theirs touch the ground."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError

SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)


@dataclass(frozen=True)
class Feet:
    """The feet of a compiled model, in their order."""

    geoms: np.ndarray
    """Geom of each foot that touches the ground, (feet,): the foot itself, or the one nearest to it on its body."""
    sites: np.ndarray
    """Site of each foot that is one, (feet,); −1 for a foot that is a geom."""
    height: np.ndarray
    """Height of the foot's point above its sole in the rest pose, m, (feet,): the radius of a sphere."""

    def positions(self, data: mujoco.MjData) -> np.ndarray:
        """Points of the feet in the world, m, (feet, 3): centres of geoms, origins of sites."""
        if (self.sites < 0).all():
            return np.asarray(data.geom_xpos[self.geoms])
        return np.where(self.sites[:, None] < 0, data.geom_xpos[self.geoms], data.site_xpos[self.sites])


def feet_of(model: mujoco.MjModel, names: Sequence[str]) -> Feet:
    """The feet with these names: geoms, or sites where no geom has the name."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0] if model.nkey else model.qpos0
    mujoco.mj_kinematics(model, data)
    geoms, sites, height = [], [], []
    for name in names:
        geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) if geom < 0 else -1
        point = data.geom_xpos[geom] if site < 0 else data.site_xpos[site]
        body = int(model.geom_bodyid[geom] if site < 0 else model.site_bodyid[site])
        contact = geom if geom >= 0 and touches(model, geom) else nearest_contact(model, data, body, point, name)
        geoms.append(contact)
        sites.append(site)
        is_sphere = contact == geom and model.geom_type[contact] == SPHERE
        height.append(model.geom_size[contact, 0] if is_sphere else point[2] - lowest(model, data, contact))
    return Feet(np.array(geoms, dtype=int), np.array(sites, dtype=int), np.maximum(np.array(height, dtype=float), 0.0))


def touches(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch anything."""
    return bool(model.geom_contype[geom] | model.geom_conaffinity[geom])


def nearest_contact(model: mujoco.MjModel, data: mujoco.MjData, body: int, point: np.ndarray, foot: str) -> int:
    """The geom of a body that can touch the ground and whose centre is nearest to a point."""
    geoms = [int(g) for g in np.flatnonzero(model.geom_bodyid == body) if touches(model, int(g))]
    if not geoms:
        raise InputError(
            "robot",
            f"the foot {foot} on a body without a geom that touches",
            "feet that can touch the ground",
            "name a foot on the link that stands on the ground",
        )
    return int(min(geoms, key=lambda g: float(np.linalg.norm(data.geom_xpos[g] - point))))


def lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of the lowest point of a geom's bounding box, m."""
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    up = data.geom_xmat[geom].reshape(3, 3)[2]
    return float(data.geom_xpos[geom, 2] + up @ centre - np.abs(up) @ half)


def name_contacts(spec: mujoco.MjSpec, feet: Sequence[str]) -> None:
    """Name the geoms without a name that may touch the ground for a foot, so that they are known in changed models."""
    for foot in feet:
        part = spec.geom(foot) or spec.site(foot)
        for i, geom in enumerate(part.parent.geoms if part is not None else ()):
            if not geom.name and (geom.contype or geom.conaffinity):
                geom.name = f"{foot} contact {i}"
