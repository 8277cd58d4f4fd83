"""The two files of a model, as trained or as exported: ``<model>.json`` beside the arrays in ``<model>.npz``."""

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.npz_files import check_finite, read_npz
from leapgap.runtime.atomic_io import read_json

Content = TypeVar("Content")


def read_model(
    folder: Path,
    name: str,
    format_version: int,
    build: Callable[[Mapping[str, Any], dict[str, np.ndarray]], Content],
    infinite: Callable[[Mapping[str, Any]], Iterable[str]] = lambda _: (),
) -> Content:
    """Build a model from its JSON object and its arrays; ``InputError`` where they are absent, broken or of another
    version, lack what ``build`` asks for, or hold numbers that are not finite.

    ``infinite`` names arrays that may be infinite, from the JSON object.
    """
    path, again = folder / f"{name}.json", "run stages.train again"
    about = read_json(path)
    if about.get("format_version") != format_version:
        raise InputError(path, f"format_version {about.get('format_version')}", str(format_version), again)
    arrays = read_npz(folder / f"{name}.npz")
    if not is_finite(about):
        raise InputError(path, "a number that is not finite", "finite numbers", again)
    try:
        check_finite(arrays, folder / f"{name}.npz", again, infinite(about))
        return build(about, arrays)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        found = f"a model that does not fit ({error!r})"
        raise InputError(path, found, "a model of this version", again) from None


def is_finite(value: Any) -> bool:
    """Whether all numbers of a JSON value are finite; JSON has no others, but Python reads them."""
    if isinstance(value, Mapping):
        return all(map(is_finite, value.values()))
    if isinstance(value, list):
        return all(map(is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)
