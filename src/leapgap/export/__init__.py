"""Files that other simulators read: one file of code a format."""

import sys
from functools import cache
from pathlib import Path

from leapgap.export.base import CorrectedRobot, Export
from leapgap.registry import classes_by_name
from leapgap.runtime.atomic_io import write_text
from leapgap.simulation.corrected import README

ENTRY_POINTS = "leapgap.exports"  # group under which an installed package offers formats


@cache
def exports() -> dict[str, type[Export]]:
    """The known formats by name of the file."""
    return classes_by_name(sys.modules[__name__], Export, ENTRY_POINTS)  # type: ignore[type-abstract]


def write_exports(folder: Path, corrected: CorrectedRobot) -> dict[str, str]:
    """Write every format beside a corrected robot, and name them in its ``README.md``; file → what it holds."""
    written, lines = {}, ["", "## For other simulators", ""]
    for name, kind in exports().items():
        export = kind()
        if lacks := export.lacks(corrected):
            lines.append(f"- no `{name}`: {lacks}.")
            continue
        export.write(folder, corrected)
        written[name] = export.says
        lines.append(f"- `{name}`: {export.says}.")
    readme = folder / README
    write_text(readme, readme.read_text(encoding="utf-8").rstrip() + "\n" + "\n".join(lines) + "\n")
    return written
