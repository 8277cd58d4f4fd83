"""Writing a robot as one plain MJCF with its meshes and textures beside it, which MuJoCo loads anywhere."""

import ctypes
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from leapgap.atomic_io import write_text
from leapgap.errors import InputError
from leapgap.robot.model_hash import asset_paths, hash_model

ASSETS = "assets"
"""Folder of meshes, height fields and textures beside the file."""
DIGITS = 17
"""Significant digits with which a number read back is the number written."""


def write_mjcf(spec: mujoco.MjSpec, path: Path) -> None:
    """Write a specification that compiles as one MJCF, with copies of its assets beside it.

    The file is read back: ``InputError`` where MuJoCo cannot save the model so that it is the same again, or where the
    specification does not compile.
    """
    spec.compiler.saveinertial = True  # what MuJoCo computed from shapes is not computed anew
    try:
        model = spec.compile()
    except ValueError as error:
        found = f"a model that MuJoCo does not compile ({' '.join(str(error).split())})"
        raise InputError(path.name, found, "bodies as they can be", "correct the effects or the model") from None
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
                element.attrib |= {"name": name, "file": copy_asset(file, path.parent / ASSETS)}
    for compiler in root.iterfind("compiler"):
        for setting in ("assetdir", "strippath"):
            compiler.attrib.pop(setting, None)
        compiler.attrib |= {"meshdir": ASSETS, "texturedir": ASSETS}
    write_text(path, ElementTree.tostring(root, encoding="unicode") + "\n")
    check_file(path, model)


def check_file(path: Path, model: mujoco.MjModel) -> None:
    """Raise ``InputError``, and remove the file, unless it is read back as the model that was written."""
    try:
        found = "" if hash_model(mujoco.MjModel.from_xml_path(str(path))) == hash_model(model) else "another model"
    except ValueError as error:
        found = " ".join(str(error).split())
    if found:
        path.unlink()
        raise InputError(
            path.name,
            f"a model that MuJoCo does not save as it is ({found})",
            "names that are unique in the whole model",
            "give each attached model a prefix, or write the model as one file",
        )


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
    library = ctypes.CDLL(mujoco.__file__ and mujoco_library())
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


def mujoco_library() -> str:
    """Path of MuJoCo's own library, which the Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    return str(next(path for path in sorted(folder.glob("*mujoco*")) if ".so" in path.name or path.suffix in LIBRARIES))


LIBRARIES = (".dll", ".dylib")
