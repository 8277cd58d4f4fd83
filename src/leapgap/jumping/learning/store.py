"""Trained models on disk: ``<model>.npz`` (arrays) beside ``<model>.json`` (settings, and what they were made for)."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from leapgap.atomic_io import read_json, whole_file, write_json
from leapgap.errors import InputError
from leapgap.jumping.learning.model import Model
from leapgap.jumping.learning.registry import model_class
from leapgap.jumping.learning.windows import Purpose, read_npz, write_npz

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
    path = folder / f"{name}.json"
    about = read_json(path)
    if about.get("format_version") != FORMAT_VERSION:
        raise InputError(
            path, f"format_version {about.get('format_version')}", str(FORMAT_VERSION), "run stages.train anew"
        )
    arrays = read_npz(folder / f"{name}.npz")
    try:
        settings: dict[str, Any] = about["settings"]
        return StoredModel(
            model_class(about["kind"]).from_parts(arrays, settings),
            Purpose.from_json(about),
            tuple(about["trained_on"]),
            about["key"],
        )
    except (KeyError, TypeError) as error:
        raise InputError(
            path, f"a model that does not fit ({error!r})", "a model of this version", "run stages.train anew"
        ) from None


def is_stored(folder: Path, name: str) -> bool:
    """Whether both files of a model are there."""
    return (folder / f"{name}.json").is_file() and (folder / f"{name}.npz").is_file()
