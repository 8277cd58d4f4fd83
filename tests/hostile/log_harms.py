"""Logs that are harmed in one way each, in columns, metadata or file, or that are made to harm from the start."""

import shutil
from pathlib import Path

import numpy as np

from tests.hostile.base_logs import Columns, Format
from tests.hostile.column_harms import HARMS
from tests.hostile.file_harms import FILE_HARMS, main_file
from tests.hostile.harmful_files import SPECIALS
from tests.hostile.metadata_harms import write_with_metadata


def write_case(layout: Format, harm: str, name: str, path: Path, rng: np.random.Generator, log: int) -> Columns:
    """Write one harmed log; the columns that it would have had."""
    columns = layout.log(log)
    if harm == "special":
        SPECIALS[name][1](path)
    elif harm == "metadata":
        write_with_metadata(name, columns, path)
    elif harm == "columns":
        layout.write(HARMS[name](columns, rng), path)
    else:
        layout.write(columns, path)
        FILE_HARMS[name](main_file(path, rng), rng)
    return columns


def clear(path: Path) -> None:
    """Remove what a case left, whatever it is."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    elif path.is_symlink() or path.exists():
        path.unlink()
