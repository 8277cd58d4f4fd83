"""URDF files as MuJoCo can read them: mesh paths resolved, links that only other readers know added."""

from pathlib import Path
from xml.etree import ElementTree

from leapgap.errors import InputError

MESHES = (".stl", ".obj", ".msh")
"""Mesh files that MuJoCo reads."""
PACKAGE, WORLD = "package://", "world"
XACRO = "xacro"


def is_urdf(text: str) -> bool:
    """Whether a model file is a URDF: its top element is ``robot``."""
    try:
        return parsed(text).tag == "robot"
    except ElementTree.ParseError:
        return False


def parsed(text: str) -> ElementTree.Element:
    """The tree of a URDF without the namespace that some generators put it into; parts of others keep theirs."""
    root = ElementTree.fromstring(text)
    own = root.tag[: root.tag.rfind("}") + 1]
    for element in root.iter():
        element.tag = element.tag.removeprefix(own)
    return root


def readable_urdf(text: str, path: Path) -> tuple[str, tuple[str, ...]]:
    """The text of a URDF that MuJoCo reads as its makers meant it, and notes on what is left out.

    ``package://`` and relative paths of meshes become absolute ones. Shapes whose mesh is missing or of another format
    are left out. A parent link ``world`` that is not declared is added. ``InputError`` for a template of xacro.
    """
    root = parsed(text)
    for element in root.iter():
        namespace, _, element.tag = element.tag.rpartition("}")
        if XACRO in namespace:
            do = "write it out: xacro robot.urdf.xacro > robot.urdf"
            raise InputError(path, f"a template with xacro:{element.tag}", "a URDF", do)
    links = {link.get("name") for link in root.iter("link")}
    if WORLD not in links and any(parent.get("link") == WORLD for parent in root.iterfind("joint/parent")):
        root.insert(0, ElementTree.Element("link", {"name": WORLD}))
    left_out = resolve_meshes(root, path)
    compiler = root.find("mujoco/compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root.find("mujoco") or ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)
    compiler.attrib.setdefault("discardvisual", "false")
    readable = ElementTree.tostring(root, encoding="unicode")
    if not left_out:
        return readable, ()
    return readable, (f"{len(left_out)} shapes are left out, for want of meshes that MuJoCo reads: {left_out[0]} …",)


def resolve_meshes(root: ElementTree.Element, path: Path) -> list[str]:
    """Make paths of meshes absolute, and remove the shapes whose meshes cannot be read; their names."""
    left_out = []
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            found = mesh_file(mesh.get("filename", ""), path.resolve().parent)
            if found is None:
                left_out.append(mesh.get("filename", ""))
                link.remove(shape)
            else:
                mesh.set("filename", str(found))
    return left_out


def mesh_file(name: str, folder: Path) -> Path | None:
    """The file of a mesh, looked for beside the URDF and, for ``package://``, in every folder above it."""
    inside = name.removeprefix(PACKAGE).removeprefix("file://")
    if name.startswith(PACKAGE):
        below = Path(*Path(inside).parts[1:])
        tries = [above / part for above in (folder, *folder.parents) for part in (inside, below)]
    else:
        tries = [folder / inside]
    return next((one for one in tries if one.suffix.lower() in MESHES and one.is_file()), None)
