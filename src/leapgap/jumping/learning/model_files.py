"""The two files of a model, as trained or as exported: ``<model>.json`` beside the arrays in ``<model>.npz``."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from leapgap.atomic_io import read_json
from leapgap.errors import InputError
from leapgap.jumping.learning.windows import read_npz

Content = TypeVar("Content")


def read_model(
    folder: Path,
    name: str,
    format_version: int,
    build: Callable[[Mapping[str, Any], dict[str, np.ndarray]], Content],
) -> Content:
    """Build a model from its JSON object and its arrays; ``InputError`` where they are absent, broken or of another
    version, or lack what ``build`` asks for.
    """
    path, again = folder / f"{name}.json", "run stages.train anew"
    about = read_json(path)
    if about.get("format_version") != format_version:
        raise InputError(path, f"format_version {about.get('format_version')}", str(format_version), again)
    arrays = read_npz(folder / f"{name}.npz")
    try:
        return build(about, arrays)
    except (KeyError, TypeError) as error:
        found = f"a model that does not fit ({error!r})"
        raise InputError(path, found, "a model of this version", again) from None
