"""Limbs, joint groups, pairs and feet of a robot: read from the tree of its bodies, or as the user names them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from leapgap.errors import InputError, did_you_mean

SPHERE = int(mujoco.mjtGeom.mjGEOM_SPHERE)


@dataclass(frozen=True)
class Feet:
    """The feet of a compiled model, in their order."""

    geoms: np.ndarray  # geom of each foot that touches the ground, (feet,): the foot, or its body's nearest to it
    sites: np.ndarray  # site of each foot that is one, (feet,); −1 for a foot that is a geom
    height: np.ndarray  # height of the foot's point above its sole in the rest pose, m, (feet,): the radius of a sphere

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
        found = f"the foot {foot} on a body without a geom that touches"
        do = "name a foot on the link that stands on the ground"
        raise InputError("robot", found, "feet that can touch the ground", do)
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


FRONT, REAR = PAIRS = ("front", "rear")
SEPARATORS = "_-./ "


@dataclass(frozen=True)
class PartNames:
    """A user's names of the parts of a robot; empty entries are read from the model."""

    limbs: Mapping[str, Sequence[str]] = field(default_factory=dict)  # limb → its joints
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)  # group → joints that are alike, one of each limb
    feet: Sequence[str] = ()  # geoms or sites that are feet


@dataclass(frozen=True)
class Topology:
    """Limbs, groups and pairs of a robot's joints and feet: the locations at which an effect can act."""

    joints: tuple[str, ...]
    feet: tuple[str, ...]
    limbs: Mapping[str, tuple[str, ...]]  # limb → its joints, in the order of the model
    feet_of_limb: Mapping[str, tuple[str, ...]]
    groups: Mapping[str, tuple[str, ...]]  # ``hip``, ``thigh``, … → the joints of that place in several limbs
    pairs: Mapping[str, tuple[str, ...]]
    """``front`` and ``rear`` → limbs with feet, by where they are fixed to a free base; empty for other robots."""

    def limb_of(self, joint_or_foot: str) -> str:
        """The limb a joint or foot belongs to; ``InputError`` where it belongs to none."""
        for limb, joints in self.limbs.items():
            if joint_or_foot in joints or joint_or_foot in self.feet_of_limb[limb]:
                return limb
        raise self._unknown(joint_or_foot)

    @property
    def sides(self) -> dict[str, str]:
        """Joint → the first joint of its group in its pair: left and right legs of a pair taken as one."""
        found: dict[str, str] = {}
        for limbs in self.pairs.values():
            for alike in self.groups.values():
                of_pair = [joint for limb in limbs for joint in self.limbs[limb] if joint in alike]
                found |= dict.fromkeys(of_pair, of_pair[0]) if of_pair else {}
        return found

    def feet_of_pair(self, pair: str) -> tuple[str, ...]:
        """Feet of the ``front`` or ``rear`` pair."""
        return tuple(f for f in self.feet if any(f in self.feet_of_limb[limb] for limb in self.pairs.get(pair, ())))

    def joints_at(self, location: str) -> tuple[str, ...]:
        """Joints of a location: all, front, rear, a joint group, a limb or a joint."""
        if location == "all":
            return self.joints
        found = {joint for limb in self.pairs.get(location, ()) for joint in self.limbs[limb]}
        found |= {*self.limbs.get(location, ()), *self.groups.get(location, ())} | ({location} & {*self.joints})
        if not found:
            raise self._unknown(location)
        return tuple(joint for joint in self.joints if joint in found)

    def feet_at(self, location: str) -> tuple[str, ...]:
        """Feet of a location: all, front, rear, a limb or a foot."""
        limbs = (*self.pairs.get(location, ()), location)
        found = tuple(
            foot
            for foot in self.feet
            if location in ("all", foot) or any(foot in self.feet_of_limb.get(limb, ()) for limb in limbs)
        )
        if not found:
            raise self._unknown(location)
        return found

    def _unknown(self, location: str) -> InputError:
        known = dict.fromkeys(("all", *self.pairs, *self.groups, *self.limbs, *self.joints, *self.feet))
        return InputError(
            "location",
            location,
            f"one of {', '.join(known)}",
            did_you_mean(location, known) or "name a place this robot has and the effect can act at",
        )


def topology_of(
    model: mujoco.MjModel,
    joints: Mapping[str, int],
    base_body: int,
    has_free_base: bool,
    names: PartNames | None = None,
) -> Topology:
    """The parts of a compiled model; ``joints`` are its single joints, name → joint index, in order.

    A limb is a chain of bodies without a branch: it begins at the base, or where the tree branches.
    """
    named = names or PartNames()
    body_of = {name: int(model.jnt_bodyid[joint]) for name, joint in joints.items()}
    feet = tuple(named.feet) or sphere_feet(model)
    check_names(named, tuple(joints), feet, model)
    limbs = {limb: tuple(of) for limb, of in named.limbs.items()} or limbs_by_tree(
        model, body_of, base_body if has_free_base else 0
    )
    bodies = {limb: {body_of[joint] for joint in of} for limb, of in limbs.items()}
    feet_of_limb = {
        limb: tuple(foot for foot in feet if carrier(model, foot, set(body_of.values())) in own)
        for limb, own in bodies.items()
    }
    return Topology(
        tuple(joints),
        feet,
        limbs,
        feet_of_limb,
        {group: tuple(of) for group, of in named.groups.items()} or groups_by_name(limbs),
        pairs_by_place(model, limbs, feet_of_limb, joints, base_body) if has_free_base else {},
    )


def sphere_feet(model: mujoco.MjModel) -> tuple[str, ...]:
    """Named spheres that may touch the ground, in the order of the model.

    A sphere on a link from which several limbs branch off is no foot, such as a helmet on a trunk with arms.
    """
    link, carrying = model.body_weldid[1:], model.body_weldid[model.body_parentid[1:]]
    links_on = np.bincount(carrying[link != carrying], minlength=model.nbody)
    return tuple(
        model.geom(g).name
        for g in range(model.ngeom)
        if model.geom_type[g] == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        and model.geom_conaffinity[g] | model.geom_contype[g]
        and model.geom(g).name
        and links_on[model.body_weldid[model.geom_bodyid[g]]] < 2
    )


def check_names(named: PartNames, joints: Sequence[str], feet: Sequence[str], model: mujoco.MjModel) -> None:
    """Raise ``InputError`` for parts with joints, geoms or sites that the model does not have."""
    parts = {model.geom(g).name for g in range(model.ngeom)} | {model.site(s).name for s in range(model.nsite)}
    unknown = [j for of in (*named.limbs.values(), *named.groups.values()) for j in of if j not in joints]
    unknown += [foot for foot in feet if not foot or foot not in parts]
    if unknown:
        found = f"parts made of {', '.join(part or '(no name)' for part in unknown)}"
        expected = f"joints among {', '.join(joints)}; feet among the named geoms and sites"
        raise InputError("robot", found, expected, "correct limbs, groups or feet of the robot's configuration")


def carrier(model: mujoco.MjModel, foot: str, moved: set[int]) -> int:
    """The body, among those that joints move, that carries a foot; the world where none does."""
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, foot)
    body = int(model.geom_bodyid[geom] if geom >= 0 else model.site(foot).bodyid[0])
    while body not in moved and body != 0:
        body = int(model.body_parentid[body])
    return body


def limbs_by_tree(model: mujoco.MjModel, body_of: Mapping[str, int], root: int) -> dict[str, tuple[str, ...]]:
    """Chains of joints below a root body (the base, or the world), each with a name of its own."""
    moved = set(body_of.values())
    carries = set(moved)
    for body in range(model.nbody - 1, 0, -1):  # children have higher numbers than their parents
        if body in carries:
            carries.add(int(model.body_parentid[body]))
    children: dict[int, list[int]] = {}
    for body in range(1, model.nbody):
        if body in carries and body != root:
            children.setdefault(int(model.body_parentid[body]), []).append(body)
    limbs: dict[str, tuple[str, ...]] = {}
    starts = list(children.get(root, []))
    while starts:
        chain = [starts.pop(0)]
        while len(below := children.get(chain[-1], [])) == 1:
            chain += below
        starts = children.get(chain[-1], []) + starts
        joints = tuple(joint for joint, body in body_of.items() if body in chain)
        if joints:
            limbs[limb_name(joints, model.body(chain[0]).name, limbs)] = joints
    return limbs


def limb_name(joints: Sequence[str], body: str, known: Mapping[str, tuple[str, ...]]) -> str:
    """Common prefix of the joints' names; the name of the first body where there is none or it is taken."""
    shared = joints[0]
    while len(joints) > 1 and not all(joint.startswith(shared) and shared[-1] in SEPARATORS for joint in joints):
        shared = shared[:-1]
        if not shared:
            break
    name = shared.rstrip(SEPARATORS) or body or joints[0]
    return name if name not in known else body or f"{name}_{len(known)}"


def groups_by_name(limbs: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Joints with the same name in several limbs, after the name of the limb is removed."""
    groups: dict[str, list[str]] = {}
    for limb, joints in limbs.items():
        for joint in joints:
            rest = joint.removeprefix(limb).removesuffix("_joint").strip(SEPARATORS)
            groups.setdefault(rest or joint, []).append(joint)
    alike = {group: tuple(of) for group, of in groups.items() if len(of) > 1}
    return alike if len(limbs) > 1 else {}


def pairs_by_place(
    model: mujoco.MjModel,
    limbs: Mapping[str, tuple[str, ...]],
    feet_of_limb: Mapping[str, tuple[str, ...]],
    joints: Mapping[str, int],
    base_body: int,
) -> dict[str, tuple[str, ...]]:
    """Limbs with feet before and behind the base's origin along x, by where their first joint sits."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ahead = {
        limb: float(data.xanchor[joints[of[0]], 0] - data.xpos[base_body, 0])
        for limb, of in limbs.items()
        if feet_of_limb[limb]
    }
    found = {
        FRONT: tuple(limb for limb, x in ahead.items() if x > 0),
        REAR: tuple(limb for limb, x in ahead.items() if x <= 0),
    }
    return {pair: of for pair, of in found.items() if of}


def indices(names: Sequence[str], among: Sequence[str]) -> np.ndarray:
    """Indices of names in ``among``, int, (names,)."""
    return np.array([among.index(name) for name in names], dtype=int)
