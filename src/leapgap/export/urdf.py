"""The corrected robot as a URDF: a URDF of the user's with other numbers, or the tree of an MJCF without its shapes."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from leapgap.export.base import BODY_FIELDS, CorrectedRobot, Export
from leapgap.robot.mjcf import copy_asset
from leapgap.robot.model_file import is_urdf, parsed
from leapgap.robot.rotations import matrix_of
from leapgap.runtime.atomic_io import write_text

FILE, MESHES = "robot.urdf", "meshes"
UNKNOWN = 1e6  # limit of effort or speed where none is known, which a URDF must state: N·m, rad/s
WEIGHTLESS_KG, WEIGHTLESS_KGM2 = 1e-9, 1e-12
CHANGED = 1e-9  # share of a number by which it must differ to be written into a user's URDF
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Urdf(Export):
    """Folder with a URDF."""

    name = "urdf"
    says = (
        "`robot.urdf`: masses, centres of mass, inertias, damping, friction and limits; your URDF with the corrected "
        "numbers, or the links and joints of your MJCF without shapes. A URDF has no armature and no delay"
    )

    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write the URDF, with copies of the meshes of a user's own."""
        robot, numbers = corrected.robot, corrected.corrected
        text = robot.path.read_text(encoding="utf-8", errors="replace")
        if is_urdf(text):
            root = parsed(text)
            change_links(root, corrected)
            copy_meshes(root, robot.path.resolve().parent, folder / self.name)
        else:
            root = tree_of(corrected)
        # Put damping, friction and scaled limits of effort into the joints of a URDF
        joints = {joint.get("name"): joint for joint in root.iterfind("joint")}
        for i, name in enumerate(robot.joints):
            if (joint := joints.get(name)) is None:
                continue  # one of the three that MuJoCo makes of a planar joint, which has one damping for all
            of = {key: float(numbers[key][i]) for key in ("damping", "friction", "torque_limit")}
            dynamics, limit = joint.find("dynamics"), joint.find("limit")
            dynamics = ElementTree.SubElement(joint, "dynamics") if dynamics is None else dynamics
            dynamics.attrib |= {key: number(of[key]) for key in ("damping", "friction")}
            if limit is not None and of["torque_limit"] != robot.torque_limits[i] and np.isfinite(of["torque_limit"]):
                limit.set("effort", number(of["torque_limit"]))
        ElementTree.indent(root)
        write_text(folder / self.name / FILE, ElementTree.tostring(root, encoding="unicode") + "\n")


def change_links(root: ElementTree.Element, corrected: CorrectedRobot) -> None:
    """Put the inertia of the bodies that differ into the links of a URDF.

    MuJoCo joins links that fixed joints hold to one body, unless the file forbids it: its link then gets all of the
    inertia, and they none.
    """
    nominal, numbers = corrected.bare, corrected.corrected
    links = {link.get("name"): link for link in root.iterfind("link")}
    fixed: dict[str, list[str]] = {}
    for joint in root.iterfind("joint[@type='fixed']"):
        ends = [joint.find(end) for end in ("parent", "child")]
        above, below = ("" if end is None else end.get("link", "") for end in ends)
        if below not in corrected.body_names:
            fixed.setdefault(above, []).append(below)
    for body in corrected.robot.bodies:
        pairs = [(getattr(nominal, field)[body], numbers[field][body]) for field in BODY_FIELDS]
        name = corrected.body_names[body]
        if name not in links or all(np.allclose(*pair, rtol=CHANGED, atol=0) for pair in pairs):
            continue
        set_inertia(links[name], numbers, body)
        held = list(fixed.get(name, []))
        for one in held:  # grows
            held += fixed.get(one, [])
            for inertial in links[one].findall("inertial"):
                links[one].remove(inertial)


def copy_meshes(root: ElementTree.Element, source: Path, folder: Path) -> None:
    """Copy the meshes with relative paths beside a URDF; those of packages stay as they are."""
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        path = source / name
        if "://" in name or not path.is_file():
            continue
        mesh.set("filename", f"{MESHES}/{copy_asset(path, folder / MESHES)}")


def tree_of(corrected: CorrectedRobot) -> ElementTree.Element:
    """Links and joints of a model as a URDF.

    A link's frame is at the joint that moves it; several joints of one body get links without mass between them. A
    position of 0 is the model's: what its joint has as reference is turned into the frames.
    """
    robot, model = corrected.robot, corrected.bare
    root = ElementTree.Element("robot", {"name": robot.name or "robot"})
    offset = np.zeros((model.nbody, 3))  # of each link's frame in the frame of its body, m
    if not robot.has_free_base:
        ElementTree.SubElement(root, "link", {"name": "world"})
    for body in robot.bodies:
        name, parent = corrected.body_names[body], int(model.body_parentid[body])
        above = corrected.body_names[parent] if parent else "world"
        place, turn = model.body_pos[body] - offset[parent], matrix_of(model.body_quat[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = [j for j in range(first, first + count) if model.jnt_type[j] != FREE]
        for j in joints:
            below = name if j == joints[-1] else f"{name}_{model.joint(j).name}"
            place = place + turn @ (model.jnt_pos[j] - offset[body])
            add_joint(root, model, j, (above, below), place, turn)
            if j != joints[-1]:
                # Add a link between two joints of one body; simulators refuse one without any mass
                inertial = ElementTree.SubElement(ElementTree.SubElement(root, "link", {"name": below}), "inertial")
                ElementTree.SubElement(inertial, "mass", {"value": number(WEIGHTLESS_KG)})
                add_tensor(inertial, WEIGHTLESS_KGM2 * np.eye(3))
            above, place, turn, offset[body] = below, np.zeros(3), np.eye(3), model.jnt_pos[j]
        if not joints and not (robot.has_free_base and body == robot.base_body):
            # Add a fixed joint between two links
            links = (above, name)
            joint = ElementTree.SubElement(root, "joint", {"name": f"{links[1]}_fixed", "type": "fixed"})
            add_links(joint, links)
            add_origin(joint, place, turn)
        set_inertia(ElementTree.SubElement(root, "link", {"name": name}), corrected.corrected, body, offset[body])
    return root


def add_joint(
    root: ElementTree.Element,
    model: mujoco.MjModel,
    j: int,
    links: tuple[str, str],
    place: np.ndarray,
    turn: np.ndarray,
) -> None:
    """Add a hinge or slide between two links; ``place`` and ``turn`` are those of its frame in the link above."""
    slides = model.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    axis, limited = model.jnt_axis[j], bool(model.jnt_limited[j])
    reference = -float(model.qpos0[model.jnt_qposadr[j]])
    if slides:
        place = place + turn @ (reference * axis)
    else:
        turned = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turned, axis, reference)
        turn = turn @ matrix_of(turned)
    kind = "prismatic" if slides else "revolute" if limited else "continuous"
    joint = ElementTree.SubElement(root, "joint", {"name": model.joint(j).name, "type": kind})
    add_links(joint, links)
    add_origin(joint, place, turn)
    ElementTree.SubElement(joint, "axis", {"xyz": vector(axis)})
    low, high = model.jnt_range[j] if limited else (-UNKNOWN, UNKNOWN)
    ends = {} if kind == "continuous" else {"lower": number(low), "upper": number(high)}
    # The largest torque or force of the actuator at a joint
    of = np.flatnonzero(model.actuator_trnid[:, 0] == j)
    limits = [abs(model.actuator_forcerange[a]).max() for a in of if model.actuator_forcelimited[a]]
    ends |= {"effort": number(max(limits, default=UNKNOWN)), "velocity": number(UNKNOWN)}
    ElementTree.SubElement(joint, "limit", ends)


def add_links(joint: ElementTree.Element, links: tuple[str, str]) -> None:
    """Name the links above and below a joint."""
    for end, name in zip(("parent", "child"), links, strict=True):
        ElementTree.SubElement(joint, end, {"link": name})


def add_origin(element: ElementTree.Element, place: np.ndarray, turn: np.ndarray) -> None:
    """Place and rotation, the latter as roll, pitch and yaw about fixed axes."""
    pitch = np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0]))
    if np.hypot(turn[0, 0], turn[1, 0]) > 1e-9:
        roll, yaw = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    else:  # only their sum or difference is determined
        roll, yaw = np.arctan2(-turn[1, 2], turn[1, 1]), 0.0
    ElementTree.SubElement(element, "origin", {"xyz": vector(place), "rpy": vector([roll, pitch, yaw])})


def set_inertia(
    link: ElementTree.Element, numbers: Mapping[str, np.ndarray], body: int, offset: np.ndarray | float = 0.0
) -> None:
    """Give a link the mass, centre of mass and inertia of a body; ``offset`` is its frame's in that of the body, m."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ElementTree.Element("inertial")
    link.insert(0, inertial)
    ElementTree.SubElement(inertial, "origin", {"xyz": vector(numbers["body_ipos"][body] - offset), "rpy": "0 0 0"})
    ElementTree.SubElement(inertial, "mass", {"value": number(numbers["body_mass"][body])})
    turn = matrix_of(numbers["body_iquat"][body])
    tensor = turn @ np.diag(numbers["body_inertia"][body]) @ turn.T
    add_tensor(inertial, tensor)


def add_tensor(inertial: ElementTree.Element, tensor: np.ndarray) -> None:
    """Add a tensor of inertia, (3, 3)."""
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ElementTree.SubElement(inertial, "inertia", {name: number(tensor[at]) for name, at in names.items()})


def number(value: float) -> str:
    """A number with all digits that count."""
    return f"{float(value) + 0.0:.12g}"


def vector(values: np.ndarray | list[float]) -> str:
    """Numbers with spaces between them."""
    return " ".join(number(one) for one in values)
