"""Trained models on disk: ``<model>.npz`` (arrays) beside ``<model>.json`` (settings, and what they were made for)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.model_files import is_finite, read_model
from leapgap.jumping.learning.npz_files import check_finite, write_npz
from leapgap.jumping.learning.registry import model_class
from leapgap.jumping.learning.windows import Purpose, RolloutInputs, TimeGrid
from leapgap.runtime.atomic_io import whole_file, write_json

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
    """Write both files; the JSON last, so that a model without it was never finished.

    ``InputError`` for a model with numbers that are not finite: such a one is never stored.
    """
    arrays, settings = stored.model.arrays(), stored.model.settings()
    do = "look for outliers in the windows, or choose calmer settings of this model in conf/train"
    check_finite(arrays, f"model {name}", do, stored.model.infinite)
    if not is_finite(settings):
        raise InputError(f"model {name}", "a setting that is not finite", "finite numbers", do)
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / f"{name}.npz") as beside:
        write_npz(beside, arrays)
    write_json(
        folder / f"{name}.json",
        {
            "format_version": FORMAT_VERSION,
            "kind": stored.model.kind,
            "key": stored.key,
            "trained_on": list(stored.trained_on),
            **asdict(stored.purpose),
            "settings": settings,
        },
    )


def load(folder: Path, name: str) -> StoredModel:
    """Read a model; ``InputError`` where it is absent, broken or of another version."""
    return read_model(folder, name, FORMAT_VERSION, stored_model, lambda about: model_class(about["kind"]).infinite)


def check_predicts(model: Model, grid: TimeGrid) -> None:
    """Raise ``ValueError`` for a model whose arrays do not fit together, by a prediction of one window of zeros."""
    steps = grid.steps
    zeros = np.zeros((1, steps))
    window = RolloutInputs(
        state=np.zeros((1, 6)),
        force=np.zeros((1, steps, 4)),
        foot=np.zeros((1, steps, 4)),
        contact=np.arange(steps)[None] < steps // 2,
        time_s=zeros,
        step_s=zeros + grid.contact_step_s,
        start=np.zeros(1, int),
    )
    found = model.predict(window).shape
    if found != (1, steps + 1, 6):
        raise ValueError(f"predictions of shape {found}")


def stored_model(about: Mapping[str, Any], arrays: dict[str, np.ndarray]) -> StoredModel:
    """The model and its record from the content of its files."""
    model = model_class(about["kind"]).from_parts(arrays, about["settings"])
    purpose = Purpose.from_json(about)
    check_predicts(model, purpose.grid)
    return StoredModel(model, purpose, tuple(about["trained_on"]), about["key"])


def is_stored(folder: Path, name: str) -> bool:
    """Whether both files of a model are there."""
    return (folder / f"{name}.json").is_file() and (folder / f"{name}.npz").is_file()
