"""Dataclasses of arrays in a form that a JSON file can hold."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np


@dataclass(frozen=True)
class ArrayRecord:
    """Base of a dataclass whose fields are arrays of numbers alone."""

    def to_json(self) -> dict[str, Any]:
        """The arrays as lists; what is not finite becomes null."""
        return {one.name: null_where_not_finite(getattr(self, one.name)) for one in fields(self)}

    @classmethod
    def from_json(cls, raw: Mapping[str, Any]) -> Self:
        """The inverse of ``to_json``: numbers in JSON keep all their digits, and null becomes NaN."""
        return cls(**{name: np.array(values, dtype=float) for name, values in raw.items()})


def null_where_not_finite(values: np.ndarray) -> Any:
    """Nested lists of the values, with None for those that are not finite."""
    found = values.astype(object)
    found[~np.isfinite(values)] = None
    return found.tolist()
