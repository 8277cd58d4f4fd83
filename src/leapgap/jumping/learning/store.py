"""Trained models on disk: ``<model>.npz`` (arrays) beside ``<model>.json`` (settings, and what they were made for)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.atomic_io import whole_file, write_json
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.model_files import read_model
from leapgap.jumping.learning.registry import model_class
from leapgap.jumping.learning.windows import Purpose, write_npz

FORMAT_VERSION = 1


@dataclass(frozen=True)
class StoredModel:
    """A model with the record of what it was made of and what it is for."""

    model: Model
    purpose: Purpose
    trained_on: tuple[str, ...]
    key: str
    """Hash of everything the model was made of."""


def save(stored: StoredModel, folder: Path, name: str) -> None:
    """Write both files; the JSON last, so that a model without it was never finished."""
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / f"{name}.npz") as beside:
        write_npz(beside, stored.model.arrays())
    write_json(
        folder / f"{name}.json",
        {
            "format_version": FORMAT_VERSION,
            "kind": stored.model.kind,
            "key": stored.key,
            "trained_on": list(stored.trained_on),
            **asdict(stored.purpose),
            "settings": stored.model.settings(),
        },
    )


def load(folder: Path, name: str) -> StoredModel:
    """Read a model; ``InputError`` where it is absent, broken or of another version."""
    return read_model(folder, name, FORMAT_VERSION, stored_model)


def stored_model(about: Mapping[str, Any], arrays: dict[str, np.ndarray]) -> StoredModel:
    """The model and its record from the content of its files."""
    model = model_class(about["kind"]).from_parts(arrays, about["settings"])
    return StoredModel(model, Purpose.from_json(about), tuple(about["trained_on"]), about["key"])


def is_stored(folder: Path, name: str) -> bool:
    """Whether both files of a model are there."""
    return (folder / f"{name}.json").is_file() and (folder / f"{name}.npz").is_file()
