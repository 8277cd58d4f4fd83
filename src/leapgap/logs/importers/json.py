"""Importer of JSON files: records one after another, or columns; records a line (``.jsonl``) too."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size, flat

BYTES_A_VALUE = 2  # a digit and a comma: no file holds more values than its size over this


class Json(TableFormat):
    """Lists of records with the same keys, or objects of columns; keys of objects in them are joined by dots.

    Objects in a list in a record are there by their numbers: ``motors.0.q``.
    """

    name = "json"
    suffixes = (".json", ".jsonl")
    holds = "JSON"

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The wanted columns; a list in a record is a row of an array.

        Lists beside one with the same names in every record are also there by these names: ``position[elbow]``.
        """
        check_size(path, path.stat().st_size / BYTES_A_VALUE)
        text = path.read_text(encoding="utf-8")
        lines = [line for line in text.splitlines() if line.strip()]
        columns = columns_of(list(map(json.loads, lines)) if path.suffix == ".jsonl" else json.loads(text), path)
        arrays = {name: as_array(values, f"{path}, {name}") for name, values in columns.items() if wanted(name)}
        labels = {name: values[0] for name, values in columns.items() if has_names(values)}
        for label, names in labels.items():
            for name in [name for name in columns if name not in labels]:
                keys = [f"{name}[{one}]" for one in names]
                if label.rpartition(".")[0] == name.rpartition(".")[0] and any(map(wanted, keys)):
                    values = as_array(columns[name], f"{path}, {name}")
                    if values.ndim == 2 and values.shape[1] == len(names):
                        arrays |= {key: own for key, own in zip(keys, values.T, strict=True) if wanted(key)}
        return arrays


def has_names(values: list[Any]) -> bool:
    """Whether every record has the same list of texts."""
    first = values[0] if values else None
    is_list = isinstance(first, list) and len(first) > 0 and all(isinstance(one, str) for one in first)
    return is_list and all(one == first for one in values)


def columns_of(held: Any, path: Path) -> dict[str, list[Any]]:
    """Columns by name: of records their keys, of an object the lists in it; one list of records is taken from it."""
    if isinstance(held, Mapping):
        lists = [one for one in held.values() if isinstance(one, list) and one and isinstance(one[0], Mapping)]
        if len(lists) == 1:
            held = lists[0]
    if isinstance(held, Mapping):
        return {name: one for name, one in flat(held, path).items() if isinstance(one, list)}
    if not isinstance(held, list) or not held or not isinstance(held[0], Mapping):
        raise InputError(path, "neither records nor columns", "a list of objects, or an object of lists", "export it")
    names = list(flat(held[0], path, is_of_objects))
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for row, record in enumerate(held):
        values = flat(record, path, is_of_objects) if isinstance(record, Mapping) else {}
        lacking = next((name for name in names if name not in values), None)
        if lacking is not None:
            raise InputError(f"{path}, record {row}", f"no {lacking}", "the keys of record 0", "export it again")
        for name in names:
            columns[name].append(values[name])
    return columns


def is_of_objects(value: Any) -> bool:
    """Whether a list holds objects alone, which are there by their numbers: ``motors.0.q``."""
    return len(value) > 0 and all(isinstance(one, Mapping) for one in value)


def as_array(values: list[Any], where: str) -> np.ndarray:
    """Numbers as float64, of shape (rows,) or (rows, n); anything else as it is, for text may cut a log."""
    if all(value is None or isinstance(value, str) for value in values) or has_names(values):
        return np.array(values, dtype=object)
    try:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(where, "values that are no numbers", "numbers, or lists of one length", "export it") from None
