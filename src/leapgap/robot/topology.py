"""Limbs, joint groups, feet and pairs of a robot: read from the tree of its bodies, or as the user names them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from leapgap.errors import InputError, did_you_mean

FRONT, REAR = PAIRS = ("front", "rear")
SEPARATORS = "_-./ "


@dataclass(frozen=True)
class PartNames:
    """A user's names of the parts of a robot; empty entries are read from the model."""

    limbs: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Limb → its joints."""
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Group → joints that are alike, one of each limb."""
    feet: Sequence[str] = ()
    """Geoms or sites that are feet."""


@dataclass(frozen=True)
class Topology:
    """Limbs, groups and pairs of a robot's joints and feet: the locations at which an effect can act."""

    joints: tuple[str, ...]
    feet: tuple[str, ...]
    limbs: Mapping[str, tuple[str, ...]]
    """Limb → its joints, in the order of the model."""
    feet_of_limb: Mapping[str, tuple[str, ...]]
    groups: Mapping[str, tuple[str, ...]]
    """``hip``, ``thigh``, … → the joints of that place in several limbs."""
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
        raise InputError(
            "robot",
            f"parts made of {', '.join(part or '(no name)' for part in unknown)}",
            f"joints among {', '.join(joints)}; feet among the named geoms and sites",
            "correct limbs, groups or feet of the robot's configuration",
        )


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
