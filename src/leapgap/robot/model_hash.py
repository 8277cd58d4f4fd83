"""Hash of a robot: of its compiled model, so that included files and meshes count and the layout of a file does not."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from leapgap.robot.motors import MotorConstants

DIGITS = 9
"""Significant digits of numbers that count: compilers of different machines differ after the fifteenth."""
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
    for part in content(model):
        hashed.update(part)
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


def content(model: mujoco.MjModel) -> Iterator[bytes]:
    """Names and values of the fields that count, in the order of their names."""
    for name, value in fields(model):
        yield f"{name} {value.shape};".encode() + canonical(value)
    yield model.names


def fields(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """The fields that count, with their values."""
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
    return " ".join(f"{value + 0.0:.{DIGITS - 1}e}" for value in values.ravel().tolist()).encode()
