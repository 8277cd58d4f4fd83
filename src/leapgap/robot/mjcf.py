"""A robot as one plain MJCF with its meshes beside it, and the hash of its compiled model (its layout is no part)."""

import ctypes
import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.model_file import compile_spec, discard_visual
from leapgap.runtime.atomic_io import write_text

if TYPE_CHECKING:
    from leapgap.robot.model import Robot

HASHED_DIGITS = 9  # significant digits that count: compilers of different machines differ after the fifteenth
LEFT_OUT = (
    *("mesh_", "bvh_", "oct_", "hfield_", "tex_", "mat_", "light_", "cam_", "skin_", "vis", "stat", "text_", "paths"),
    *("geom_rgba", "site_rgba", "tendon_rgba", "geom_matid", "site_matid", "tendon_matid", "key_", "signature"),
    *("body_invweight0", "dof_invweight0", "dof_M0", "tendon_invweight0", "tendon_length0", "actuator_acc0"),
    *("actuator_length0", "dof_length", "body_subtreemass", "flex", "names_map", "name_"),
    *("nbuffer", "narena", "npaths"),
)
"""Beginnings of the names of fields that do not count: pictures, and what MuJoCo derives from other fields.

Meshes count by the bytes of their files.
"""


def hash_model(model: mujoco.MjModel, motors: MotorConstants | None = None) -> str:
    """SHA-256 of the compiled model and of motors that are stated beside it, the same on every machine."""
    hashed = hashlib.sha256()
    for name, value in fields(model):
        hashed.update(f"{name} {value.shape};".encode() + canonical(value))
    hashed.update(model.names)
    for path in (*asset_paths(model, model.mesh_pathadr), *asset_paths(model, model.hfield_pathadr)):
        if path is not None:
            hashed.update(hashlib.sha256(path.read_bytes()).digest())
    if motors is not None:
        hashed.update(repr(motors).encode())
    return hashed.hexdigest()


def asset_paths(model: mujoco.MjModel, addresses: np.ndarray) -> list[Path | None]:
    """Files of meshes, height fields or textures of a compiled model, None for those without a file."""
    ends = [model.paths.find(b"\0", address) for address in addresses]
    return [
        Path(model.paths[address:end].decode()) if address >= 0 else None
        for address, end in zip(addresses, ends, strict=True)
    ]


def fields(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """The fields that count, in the order of their names, with their values."""
    for owner, prefix in ((model, ""), (model.opt, "opt.")):
        for name in sorted(dir(owner)):
            if name.startswith(("_", *LEFT_OUT)):
                continue
            value = getattr(owner, name)
            if isinstance(value, np.ndarray | int | float):
                yield f"{prefix}{name}", np.asarray(value)


def canonical(values: np.ndarray) -> bytes:
    """Bytes of an array: whole numbers as they are, others rounded to the significant digits that count."""
    if values.dtype.kind != "f":
        return np.ascontiguousarray(values, dtype="<i8").tobytes()
    return " ".join(f"{value + 0.0:.{HASHED_DIGITS - 1}e}" for value in values.ravel().tolist()).encode()


ASSETS = "assets"  # folder of meshes, height fields and textures beside the file
DIGITS = 17  # significant digits with which a number read back is the number written


RELATIVE, OF_LARGEST, ABSOLUTE = 1e-9, 1e-12, 1e-15
"""Largest error of a number that is read back: as a share of it, of the largest one of its field, and in SI units."""
NAMED = ("body", "jnt", "geom", "site", "actuator", "sensor", "tendon", "eq")
"""Kinds of parts that keep their names; those of pictures may change."""
UNSEEN = ("site_", "nmat", "ntex", "ncam", "nlight", "nkey", "nname", "nskin", "nuser", "ntuple")
"""Beginnings of the names of fields that change no motion, beside those that a robot's hash leaves out."""


def write_mjcf(spec: mujoco.MjSpec, path: Path) -> None:
    """Write a specification that compiles as one MJCF, with copies of its assets beside it.

    The file is read back: ``InputError`` where MuJoCo cannot save the model so that it moves the same again, or where
    the specification does not compile. Where default classes of one name are in the way, they are resolved.
    """
    spec.compiler.saveinertial = True  # what MuJoCo computed from shapes is not computed anew
    try:
        model = spec.compile()
    except ValueError as error:
        found = f"a model that MuJoCo does not compile ({' '.join(str(error).split())})"
        raise InputError(path.name, found, "bodies as they can be", "correct the effects or the model") from None
    root = as_xml(spec, model, path.parent)
    if problem := write_and_compare(root, path, model):
        # Put every element into the default class of all, so that it states whatever it has from a class of its own
        kinds = "geoms joints sites cameras lights meshes materials pairs equalities tendons actuators"
        for kind in kinds.split():
            for element in getattr(spec, kind):
                element.classname = spec.default
        # An MJCF without default classes but that of all
        root = as_xml(spec, model, path.parent)
        for top in root.iterfind("default"):
            for own in top.findall("default"):
                top.remove(own)
        for element in root.iter():
            element.attrib.pop("childclass", None)
        if write_and_compare(root, path, model):
            path.unlink()
            found = f"a corrected model that MuJoCo changes when it saves it ({problem})"
            do = "give each attached model a prefix, or write the model as one file"
            raise InputError(path.name, found, "unique names in the model", do)


def as_xml(spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> ElementTree.Element:
    """A specification and its compiled model as MJCF; its assets are copied into ``ASSETS`` in a folder."""
    with all_digits():
        root = ElementTree.fromstring(spec.to_xml())
    for kind, part, count, addresses in (
        ("mesh", model.mesh, model.nmesh, model.mesh_pathadr),
        ("hfield", model.hfield, model.nhfield, model.hfield_pathadr),
        ("texture", model.tex, model.ntex, model.tex_pathadr),
    ):
        files = {part(i).name: file for i, file in zip(range(count), asset_paths(model, addresses), strict=True)}
        for element in root.iterfind(f"asset/{kind}[@file]"):
            name = element.get("name") or Path(element.get("file", "")).stem
            if (file := files.get(name)) is not None:
                element.attrib |= {"name": name, "file": copy_asset(file, folder / ASSETS)}
    for compiler in root.iterfind("compiler"):
        for setting in ("assetdir", "strippath"):
            compiler.attrib.pop(setting, None)
        compiler.attrib |= {"meshdir": ASSETS, "texturedir": ASSETS}
    return root


def write_and_compare(root: ElementTree.Element, path: Path, model: mujoco.MjModel) -> str:
    """Write an MJCF; by what it differs from the model when it is read back, empty where they move the same."""
    write_text(path, ElementTree.tostring(root, encoding="unicode") + "\n")
    try:
        return difference(model, mujoco.MjModel.from_xml_path(str(path)))
    except ValueError as error:
        return " ".join(str(error).split())


def difference(one: mujoco.MjModel, other: mujoco.MjModel) -> str:
    """The first field in which two models differ by more than rounding, in words; empty where they move the same."""
    for kind in NAMED:
        names = [
            [model.names[at : model.names.find(b"\0", at)] for at in getattr(model, f"name_{kind}adr")]
            for model in (one, other)
        ]
        if names[0] != names[1]:
            return f"other names of {kind}"
    read = dict(fields(other))
    for name, value in fields(one):
        if name.removeprefix("opt.").startswith(UNSEEN):
            continue
        again = read[name]
        if value.shape != again.shape:
            return f"{name} of other size"
        size = float(np.abs(value[np.isfinite(value)]).max(initial=0.0))
        alike = np.isclose(again, value, RELATIVE, OF_LARGEST * size + ABSOLUTE, equal_nan=True)
        if value.dtype.kind != "f":
            alike = again == value
        if not alike.all():
            return f"{name} is {again[~alike].flat[0]:.9g}, not {value[~alike].flat[0]:.9g}"
    return ""


def copy_asset(file: Path, folder: Path) -> str:
    """Copy a file into a folder; its name there, with a number where another file has that name."""
    folder.mkdir(parents=True, exist_ok=True)
    content = file.read_bytes()
    names = (f"{file.stem}{f'_{number}' if number else ''}{file.suffix}" for number in range(10**6))
    name = next(name for name in names if not (folder / name).exists() or (folder / name).read_bytes() == content)
    if not (folder / name).exists():
        shutil.copyfile(file, folder / name)
    return name


@contextmanager
def all_digits() -> Iterator[None]:
    """MuJoCo writes numbers of an XML with all their digits.

    It writes six by default, and only a function outside its documented interface changes that; a MuJoCo without the
    function writes six.
    """
    loaded = sorted(Path(mujoco.__file__).parent.glob("*mujoco*"))
    library = ctypes.CDLL(str(next(one for one in loaded if ".so" in one.name or one.suffix in (".dll", ".dylib"))))
    try:
        read, write = library._mjPRIVATE__get_xml_precision, library._mjPRIVATE__set_xml_precision
    except AttributeError:
        yield
        return
    before = read()
    write(DIGITS)
    try:
        yield
    finally:
        write(before)


OWN_MODEL = "robot.xml"  # file beside the logs of a withheld case with its robot; without, that of the pipeline


def own_model(logs: Path) -> Path | None:
    """The model of their own that lies in a folder of logs."""
    path = logs / OWN_MODEL
    return path if path.is_file() else None


def self_contained(robot: "Robot") -> str:
    """MJCF of a robot with its makers' actuators, its base held where it is, without what only shows.

    ``InputError`` where parts of it collide that are described by further files, meshes or heightfields.
    """
    spec = robot.published_spec()
    discard_visual(spec, robot.path)
    others = [part.name or part.file for part in (*spec.meshes, *spec.hfields, *spec.skins)]
    if others:
        expected = "colliding parts of primitive shapes, which one text can hold"
        raise InputError(robot.path, f"the meshes or heightfields {', '.join(others)}", expected, "replace them")
    compile_spec(spec, robot.path)
    return str(spec.to_xml())
