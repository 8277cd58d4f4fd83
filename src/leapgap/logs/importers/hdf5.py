"""Importer of HDF5 files; arrays in groups are named by their path, such as ``observations/qpos``."""

from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError, needs
from leapgap.logs.importers.table_format import TableFormat
from leapgap.logs.importers.tables import Arrays, Wanted, check_size


class Hdf5(TableFormat):
    """Datasets of an HDF5 file."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".hdf")

    def read_table(self, path: Path, options: Any, wanted: Wanted) -> Arrays:
        """The wanted datasets of numbers; links to other files are not followed."""
        return hdf5_arrays(path, wanted)


def hdf5_arrays(path: Path, wanted: Wanted) -> dict[str, np.ndarray]:
    """Datasets by their path in the file; a compound one gives an array a field."""
    with needs("logs"):
        import h5py

    arrays: dict[str, np.ndarray] = {}

    def take(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return
        names = [name] if item.dtype.names is None else [f"{name}.{one}" for one in item.dtype.names]
        if not any(map(wanted, names)) or item.dtype.hasobject:
            return
        if item.external or item.is_virtual:
            raise InputError(f"{path}, {name}", "data in another file", "data in this file", "copy them into it")
        check_size(f"{path}, {name}", item.size * item.dtype.itemsize / 8 + sum(one.size for one in arrays.values()))
        values = item[()]
        arrays.update(
            {name: values} if item.dtype.names is None else {f"{name}.{f}": values[f] for f in values.dtype.names}
        )

    try:
        with h5py.File(path, "r") as file:
            file.visititems(take)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise InputError(path, f"no whole HDF5 file ({error})", "datasets of numbers", "save it anew") from None
    return arrays
