"""Reading a robot's model file (MJCF, URDF, a robot of Menagerie) into MuJoCo's specification, to edit and compile.

Robots of Menagerie are found by the package ``mujoco-menagerie`` (extra ``menagerie``), which holds a list of them. It
takes their files from the folder that ``MENAGERIE_ROOT`` names, a checkout of Menagerie, or from its own cache, which
it fills by a download when a robot is first asked for."""

from itertools import takewhile
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from leapgap.errors import InputError, did_you_mean, needs
from leapgap.robot.model_count import LARGEST_MODEL_BYTES
from leapgap.robot.model_guard import check_model_file, check_text

PREFIX = "menagerie:"
"""Before the name of a robot: ``menagerie:unitree_go2`` is its scene with a floor, where its makers have one.
``menagerie:unitree_go2/go2`` names one of its files without ``.xml``."""


def model_file(model: Path | str) -> Path:
    """The model file that a path or a name in Menagerie stands for; ``InputError`` where Menagerie does not have it."""
    given = str(model)
    if not given.startswith(PREFIX):
        return Path(model)
    robot, _, entry = given.removeprefix(PREFIX).partition("/")
    with needs("menagerie"):
        import mujoco_menagerie as menagerie
    try:
        return Path(menagerie.get(robot).xml(entry or None))
    except menagerie.UnknownRobotError:
        found = f"no robot {robot}" if robot else "no name of a robot"
        do = did_you_mean(robot, menagerie.names()) or "mujoco-menagerie names, in a shell, lists them"
        raise InputError(given, found, f"one of the {len(menagerie.names())} robots of MuJoCo Menagerie", do) from None
    except menagerie.UnknownEntryPointError:
        known = ", ".join(menagerie.get(robot).entry_names)
        raise InputError(given, f"no file {entry}", f"one of {known}", f"name one: {PREFIX}{robot}/<file>") from None
    except (menagerie.MenagerieError, OSError) as error:
        raise InputError(
            given,
            f"no files of that robot ({' '.join(str(error).split())})",
            "a checkout of MuJoCo Menagerie in the folder that MENAGERIE_ROOT names, or a network to download from",
            f"set MENAGERIE_ROOT, or run 'mujoco-menagerie prefetch {robot}' where there is a network",
        ) from None


MESHES = (".stl", ".obj", ".msh")  # mesh files that MuJoCo reads
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
    # Make paths of meshes absolute, and remove the shapes whose meshes cannot be read; their names
    left_out = []
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            # The file of a mesh, looked for beside the URDF and, for ``package://``, in every folder above it
            name = mesh.get("filename", "")
            folder = path.resolve().parent
            inside = name.removeprefix(PACKAGE).removeprefix("file://")
            if name.startswith(PACKAGE):
                below = Path(*Path(inside).parts[1:])
                tries = [above / part for above in (folder, *folder.parents) for part in (inside, below)]
            else:
                tries = [folder / inside]
            found = next((one for one in tries if one.suffix.lower() in MESHES and one.is_file()), None)
            if found is None:
                left_out.append(mesh.get("filename", ""))
                link.remove(shape)
            else:
                mesh.set("filename", str(found))
    compiler = root.find("mujoco/compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root.find("mujoco") or ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)
    compiler.attrib.setdefault("discardvisual", "false")
    notes = [f"{len(left_out)} shapes are left out, for want of meshes that MuJoCo reads: {one} …" for one in left_out]
    return ElementTree.tostring(root, encoding="unicode"), tuple(notes[:1])


BOUNDED = (
    *("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat", "qpos0", "jnt_axis", "jnt_pos"),
    *("geom_size", "geom_pos", "geom_friction", "dof_armature", "dof_damping", "dof_frictionloss", "jnt_stiffness"),
    *("actuator_gear", "actuator_forcerange", "actuator_gainprm", "actuator_biasprm"),
)
BOUNDED_OPTIONS = ("gravity", "wind", "density", "viscosity", "timestep")
LARGEST, SHORTEST_STEP_S, LONGEST_STEP_S = 1e9, 2e-5, 0.1
"""Largest absolute value of a number of a model, SI units, and bounds of the time step of the simulation."""
ITERATIONS = ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations", "sdf_iterations")
MOST_ITERATIONS = 2e7  # largest number of iterations of a solver in a second of a log
REFUSALS = (ValueError, MemoryError, mujoco.FatalError)  # what MuJoCo raises for a model that it cannot read or compile
MOST_NAMED = 3  # missing files that a note names
POSE, TWIST = 7, 6  # numbers of a free joint in ``qpos`` and in ``qvel``


def read_spec(path: Path, fix_base: bool | None) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Specification of a model file, and notes on what of the file is left out; ``InputError`` where it is invalid.

    ``fix_base`` holds a floating robot at the pose of its model file. False gives a robot of a URDF a free base; None
    leaves the base as the file has it.
    """
    text = check_model_file(path)
    try:
        if is_urdf(text):
            readable, notes = readable_urdf(text, path)
            check_text(readable, path)
            spec = mujoco.MjSpec.from_string(readable)
        else:
            spec, notes = mujoco.MjSpec.from_file(str(path)), ()
    except REFUSALS as error:
        raise invalid(path, error) from None
    notes = (*notes, *drop_missing_meshes(spec, path))
    if fix_base:
        hold_base(spec)
    elif fix_base is False and is_urdf(text):
        # Give the one root body that has joints below it, and none of its own, a free joint
        roots = [body for body in spec.worldbody.bodies if not body.joints]
        if len(roots) == 1:
            roots[0].add_freejoint()
    return spec, notes


def compile_spec(spec: mujoco.MjSpec, where: object) -> mujoco.MjModel:
    """The compiled model; ``InputError`` where MuJoCo refuses it, or it is none of a robot."""
    try:
        model = spec.compile()
    except REFUSALS as error:
        raise invalid(where, error) from None
    # Refuse a compiled model with numbers that no robot can have; MuJoCo lets NaN pass
    arrays = {name: np.asarray(getattr(model, name)) for name in BOUNDED}
    arrays |= {f"option {name}": np.asarray(getattr(model.opt, name)) for name in BOUNDED_OPTIONS}
    for name, values in arrays.items():
        if not (np.abs(values) <= LARGEST).all():  # false for NaN, too
            found = f"{name} with values that are not finite or above {LARGEST:g}"
            raise InputError(where, found, "numbers of a robot, in SI units", "correct them")
    for name in [name for name in dir(model) if not name.startswith("_")]:
        values = getattr(model, name)
        if isinstance(values, np.ndarray) and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(where, f"{name} with values that are not finite", "numbers of a robot", "correct them")
    if not SHORTEST_STEP_S <= model.opt.timestep <= LONGEST_STEP_S:
        found = f"a time step of {model.opt.timestep:g} s"
        raise InputError(where, found, f"{SHORTEST_STEP_S:g} to {LONGEST_STEP_S:g} s", "correct option timestep")
    # Refuse a compiled model that takes more memory, or more work a second of log, than a robot
    size = int(model.nbuffer) + int(model.narena)
    if size > LARGEST_MODEL_BYTES:
        expected = f"{LARGEST_MODEL_BYTES >> 20} MiB at most, with its working memory"
        raise InputError(where, f"a model of {size >> 20} MiB", expected, "make it smaller")
    for name in ITERATIONS:
        a_second = getattr(model.opt, name) / model.opt.timestep
        if not a_second <= MOST_ITERATIONS:
            found = f"option {name}={getattr(model.opt, name)} at a time step of {model.opt.timestep:g} s"
            expected = f"{MOST_ITERATIONS:g} a second of the simulation at most"
            raise InputError(where, found, expected, "choose fewer, or a longer step")
    return model


def keep_inertia_changeable(spec: mujoco.MjSpec) -> None:
    """Compile bodies so that their masses, centres and inertias may be changed in the compiled model.

    MuJoCo drops the off-diagonal inertia of a body whose centre lies on the axis of its only joint, and refuses to let
    the centre of such a *simple* body move.
    """
    for body in spec.bodies[1:]:  # the first is the world
        body.simple = False


def discard_visual(spec: mujoco.MjSpec, where: object) -> None:
    """Take away what only shows; ``InputError`` where the specification does not compile, as MuJoCo needs for it."""
    try:
        spec.discard_visual()
    except REFUSALS as error:
        raise invalid(where, error) from None


def gravity_of(model: mujoco.MjModel) -> np.ndarray:
    """Gravity that acts in a model, m/s², (3,): zero where a flag switches it off."""
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return np.zeros(3) if off else model.opt.gravity.copy()


def invalid(where: object, error: Exception) -> InputError:
    """The refusal of a model file that MuJoCo cannot read or compile."""
    said = " ".join(str(error).split())
    return InputError(where, f"no valid MuJoCo model ({said})", "a model that compiles", "repair it")


def drop_missing_meshes(spec: mujoco.MjSpec, where: object) -> tuple[str, ...]:
    """Remove visual geoms whose mesh files are not there, with a note.

    ``InputError`` for a missing mesh that collides, or from which MuJoCo would compute the mass of a body.
    """
    missing = {}
    for mesh in [mesh for mesh in spec.meshes if mesh.file]:
        name = Path(mesh.file).name if spec.strippath else mesh.file
        if not (Path(spec.modelfiledir or ".") / mesh.compiler.meshdir / name).is_file():
            missing[mesh.name] = mesh.file
    if not missing or compiles(spec):  # MuJoCo knows more places, such as those of attached models
        return ()
    for geom in [geom for geom in spec.geoms if geom.meshname in missing]:
        if geom.contype or geom.conaffinity or not geom.parent.explicitinertial:
            body = geom.parent.name
            found = f"no file {missing[geom.meshname]}, of a mesh that collides or gives the body {body} its mass"
            raise InputError(where, found, "the files of such meshes", "put them in the folder of the model file")
        spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in missing]:
        spec.delete(mesh)
    names = ", ".join(list(missing.values())[:MOST_NAMED])
    more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
    return (f"{len(missing)} visual meshes are left out, since their files are missing: {names}{more}",)


def compiles(spec: mujoco.MjSpec) -> bool:
    """Whether MuJoCo compiles a specification."""
    try:
        spec.copy().compile()
    except REFUSALS:
        return False
    return True


def hold_base(spec: mujoco.MjSpec) -> None:
    """Remove the free joint, so that the base is held at the pose of the model file; keyframes lose its numbers."""
    earlier = list(takewhile(lambda joint: joint.type != mujoco.mjtJoint.mjJNT_FREE, spec.joints))
    if len(earlier) == len(spec.joints):
        return
    balls = sum(joint.type == mujoco.mjtJoint.mjJNT_BALL for joint in earlier)
    position, velocity = len(earlier) + 3 * balls, len(earlier) + 2 * balls  # where the free joint's numbers begin
    for key in spec.keys:
        if len(key.qpos):
            key.qpos = np.delete(np.array(key.qpos), slice(position, position + POSE))
        if len(key.qvel):
            key.qvel = np.delete(np.array(key.qvel), slice(velocity, velocity + TWIST))
    free = spec.joints[len(earlier)]
    base = free.parent
    spec.delete(free)
    # Forbid contacts of a held base with the links at it
    held, links = [base], list[mujoco.MjsBody]()
    for body in held:  # grows: bodies without a joint are held with the base
        for child in body.bodies:
            (links if child.joints else held).append(child)
    for number, body in enumerate([*held, *links]):
        body.name = body.name or f"held_{number}"
    for body in held:
        for link in links:
            spec.add_exclude(bodyname1=body.name, bodyname2=link.name)
