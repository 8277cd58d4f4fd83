"""Writing a robot as one plain MJCF with its meshes and textures beside it, which MuJoCo loads anywhere."""

import ctypes
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco

from leapgap.atomic_io import write_text
from leapgap.robot.model_file import asset_file

ASSETS = "assets"
"""Folder of meshes, height fields and textures beside the file."""
DIGITS = 17
"""Significant digits with which a number read back is the number written."""


def write_mjcf(spec: mujoco.MjSpec, path: Path) -> None:
    """Write a specification that compiles as one MJCF; it is changed: its assets are those beside the file."""
    for part in (*spec.meshes, *spec.hfields):
        if part.file:
            part.file = copy_asset(asset_file(spec, spec.meshdir, part.file), path.parent / ASSETS)
    for texture in spec.textures:
        if texture.file:
            texture.file = copy_asset(asset_file(spec, spec.texturedir, texture.file), path.parent / ASSETS)
        texture.cubefiles = [
            copy_asset(asset_file(spec, spec.texturedir, file), path.parent / ASSETS) if file else ""
            for file in texture.cubefiles
        ]
    spec.meshdir = spec.texturedir = ASSETS
    spec.strippath, spec.modelfiledir, spec.compiler.saveinertial = False, str(path.parent), True
    with all_digits():
        spec.compile()
        write_text(path, spec.to_xml())


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
