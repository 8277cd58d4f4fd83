"""Trained models on disk: ``<model>.npz`` (arrays) beside ``<model>.json`` (settings, and what they were made for)."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning import models
from leapgap.jumping.learning.model import Model, ResidualModel
from leapgap.jumping.learning.model_files import check_finite, is_finite, read_model, write_npz
from leapgap.jumping.learning.recipe import DeviationRecipe, ModelRecipe, ModelSettings
from leapgap.jumping.learning.windows import Purpose, RolloutInputs
from leapgap.jumping.models.rigid_body import KNOWN
from leapgap.registry import classes_by_name
from leapgap.runtime.atomic_io import whole_file, write_json

ENTRY_POINTS = "leapgap.learned_models"  # Entry-point group under which other packages provide recipes
DEVIATION_ENTRY_POINTS = "leapgap.deviation_models"


@cache
def recipes() -> dict[str, ModelRecipe]:
    """The recipe of every model by the model's name, in alphabetical order."""
    kinds = classes_by_name(models, ModelRecipe, ENTRY_POINTS)  # type: ignore[type-abstract]
    return {name: kind() for name, kind in kinds.items()}


@cache
def deviation_recipes() -> dict[str, DeviationRecipe]:
    """The recipes of models of the deviation from a plan, by their names."""
    kinds = classes_by_name(models, DeviationRecipe, DEVIATION_ENTRY_POINTS)  # type: ignore[type-abstract]
    return {name: kind() for name, kind in kinds.items()}


def find_recipe(name: str, where: Path | str) -> ModelRecipe:
    """The recipe of a model's name; ``InputError`` where there is none."""
    if name not in recipes():
        raise InputError(where, f"a model named {name}", f"some of {', '.join(recipes())}", "run stages.train again")
    return recipes()[name]


def settings_by_section() -> dict[str, type[ModelSettings]]:
    """Classes of the models' settings by their section of the configuration, in alphabetical order."""
    kinds = {recipe.settings for recipe in recipes().values() if recipe.settings}
    sections: dict[str, type[ModelSettings]] = {}
    for kind in sorted(kinds, key=lambda kind: (kind.section, kind.__module__)):
        if kind.section in sections:
            where = f"{kind.__module__}.{kind.__qualname__}"
            raise InputError(where, f"the section {kind.section}", "a section of its own", "choose another")
        sections[kind.section] = kind
    return sections


def model_class(kind: str) -> type[Model]:
    """The class of a stored model; ``KeyError`` where no recipe fits such models."""
    return {recipe.model.kind: recipe.model for recipe in recipes().values()}[kind]


FORMAT_VERSION = 1


@dataclass(frozen=True)
class StoredModel:
    """A model with the record of what it was made of and what it is for."""

    model: Model
    purpose: Purpose
    trained_on: tuple[str, ...]
    key: str  # Hash of everything the model was made of


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
    write_npz(folder / f"{name}.npz", arrays)
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


def stored_model(about: Mapping[str, Any], arrays: dict[str, np.ndarray]) -> StoredModel:
    """The model and its record from the content of its files."""
    model = model_class(about["kind"]).from_parts(arrays, about["settings"])
    purpose = Purpose.from_json(about)
    # Arrays that do not fit together show in the prediction of one window of zeros.
    steps, contact = purpose.grid.steps, np.arange(purpose.grid.steps)[None] < purpose.grid.steps // 2
    times, of_step = np.zeros((1, steps)), np.zeros((1, steps, 4))
    lengths = times + purpose.grid.contact_step_s
    window = RolloutInputs(np.zeros((1, 6)), of_step, of_step, contact, times, lengths, np.zeros(1, int))
    found = model.predict(window).shape
    if found != (1, steps + 1, 6):
        raise ValueError(f"predictions of shape {found}")
    return StoredModel(model, purpose, tuple(about["trained_on"]), about["key"])


EXPORT_VERSION = 2


def export_model(stored: StoredModel, folder: Path, name: str, deviation: np.ndarray | None = None) -> None:
    """Write ``<name>.npz``, ``<name>.onnx`` and, last, ``<name>.json``.

    ``deviation``: of predicted states by start of the prediction and step, (starts, K, 6), where known.
    """
    phases = stored.model.flatten()
    assert isinstance(stored.model, ResidualModel)  # else ``flatten`` has refused it
    arrays = {} if deviation is None else {"deviation": deviation}
    for phase, flat in phases.items():
        arrays |= {f"{phase}/constant": flat.constant, f"{phase}/feet": flat.feet}
        for i, part in enumerate(flat.parts):
            arrays |= {f"{phase}/{i}/{key}": array for key, array in part.arrays.items()}
    about = {
        "format_version": EXPORT_VERSION,
        "model": name,
        "key": stored.key,
        "curvature": stored.model.curvature,
        "inputs": list(getattr(stored.model, "names", ())),
        "trained_on": list(stored.trained_on),
        **asdict(stored.purpose),
        "parts": {phase: [part.kind for part in flat.parts] for phase, flat in phases.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_npz(folder / f"{name}.npz", arrays)
    from leapgap.jumping.learning import onnx_graph  # onnx is imported only where it is written

    with whole_file(folder / f"{name}.onnx") as beside:
        beside.write_bytes(onnx_graph.serialise(phases, about, KNOWN))
    write_json(folder / f"{name}.json", about)
