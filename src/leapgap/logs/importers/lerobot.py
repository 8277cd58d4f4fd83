"""Importer of LeRobot datasets, version 3, by pyarrow alone: one log an episode."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.importers.parquet import parquet_arrays
from leapgap.logs.importers.table_format import TableFormat, TableOptions
from leapgap.logs.importers.tables import Arrays, Table, Wanted, check_size
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

INFO, EPISODE, TIME = "meta/info.json", "episode_index", "timestamp"
LARGEST_INFO = 10_000_000


@dataclass(frozen=True)
class LeRobotOptions(TableOptions):
    """Options of LeRobot datasets. Without a map of its own, ``time`` is their ``timestamp``."""

    cut_by: str | None = EPISODE
    """The column that cuts the dataset into logs."""


class LeRobot(TableFormat):
    """A dataset folder: ``meta/info.json`` beside ``data/``; videos are not read."""

    name = "lerobot"
    suffixes = (".parquet",)
    Options = LeRobotOptions

    def find(self, source: Path) -> dict[str, Path]:
        """The dataset that a folder is, or the datasets in it."""
        folders = [source, *sorted(one for one in source.glob("*") if one.is_dir())]
        return {folder.name: folder for folder in folders if (folder / INFO).is_file()}

    def read_all(self, path: Path, name: str, robot: Robot, options: LeRobotOptions) -> list[Log]:
        """The episodes of a dataset; its ``timestamp`` is the time unless another column is mapped."""
        if "time" not in options.columns:
            options = replace(options, columns={"time": TIME, **options.columns})
        return super().read_all(path, name, robot, options)

    def first_log(self, table: Table) -> Table:
        """The first episode: the time begins anew with each."""
        episode = table.arrays.get(EPISODE)
        if episode is None or not len(episode):
            return table
        return Table(table.path, {name: array[episode == episode[0]] for name, array in table.arrays.items()})

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """Columns of all files of the dataset; those of a vector are also there by the names in ``info.json``."""
        features, files = features_of(path), sorted((path / "data").rglob("*.parquet"))
        if not files:
            raise InputError(path, "no data/**/*.parquet", "the files of a dataset", "copy it whole")

        def needed(name: str) -> bool:
            return wanted(name) or any(wanted(f"{name}.{part}") for part in features.get(name, ()))

        parts, taken = [], 0
        for file in files:
            parts.append(parquet_arrays(file, needed))
            taken += sum(array.size for array in parts[-1].values())
            check_size(path, taken)
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for name in [name for name in arrays if name in features]:
            named = {f"{name}.{part}": arrays[name][:, i] for i, part in enumerate(features[name])}
            arrays |= {key: values for key, values in named.items() if wanted(key)}
        return arrays


def features_of(path: Path) -> dict[str, list[str]]:
    """Names of the components of each vector, from ``meta/info.json``."""
    try:
        if (path / INFO).stat().st_size > LARGEST_INFO:
            raise ValueError(f"more than {LARGEST_INFO} bytes")
        info = json.loads((path / INFO).read_text(encoding="utf-8"))
        version = str(info["codebase_version"])
        features = {name: component_names(one.get("names")) for name, one in info["features"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(path / INFO, f"no readable info ({error!r})", "that of a dataset", "copy it whole") from None
    if not version.startswith("v3"):
        do = "convert it with LeRobot's own converter"
        raise InputError(path / INFO, f"version {version}", "version 3 of the format", do)
    return {name: names for name, names in features.items() if names}


def component_names(names: Any) -> list[str]:
    """Names of components as a flat list; some datasets keep them below a word such as ``motors``."""
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    return [str(name) for name in names] if isinstance(names, list) else []
