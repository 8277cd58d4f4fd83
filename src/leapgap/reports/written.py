"""What a saved report holds, as lines for a person."""

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path

from leapgap.export import exports
from leapgap.reports.diagnosis import BEST, CORRECTED, PAGE, RECORDING, REPORT
from leapgap.robot.mjcf import ASSETS
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import CORRECTED_HOLDS, MODEL, NOMINAL, PARAMETERS, README, placed_in_words

HOLDS = {
    PAGE: "the report to read in a browser",
    REPORT: "the same as data",
    RECORDING: "one log and its replays, for the Rerun viewer",
    BEST: "the model with every number fitted: for prediction, not for explanation",
    CORRECTED: "the model with the identified causes:",
}
"""What each file and folder of a report holds."""
VIEWER = "the viewer's package rerun-sdk is not installed (pip install 'leapgap[view]')"


def what_was_written(folder: Path) -> list[str]:
    """What a report's folder holds, file by file, what it lacks and why, and of each identified effect where it is."""
    inside = corrected_holds()
    lines = [f"written to {folder}:", *named(folder, HOLDS, "  "), *named(folder / CORRECTED, inside, "    ")]
    if not (folder / RECORDING).exists():
        lines.append(f"  no {RECORDING}: {VIEWER if find_spec('rerun') is None else 'none was asked for'}")
    if (folder / CORRECTED / README).is_file():
        lacking = [name for name in inside if name != ASSETS and not (folder / CORRECTED / name).exists()]
        lines += [f"  no {CORRECTED}/{name}: {CORRECTED}/{README} says why" for name in lacking]
    return [*lines, *effects_of(folder)]


def corrected_holds() -> Mapping[str, str]:
    """What each file and folder of a corrected robot holds."""
    own = {**CORRECTED_HOLDS, ASSETS: "the meshes and pictures of these models"}
    return own | {name: kind.says.replace("`", "") for name, kind in exports().items()}


def named(folder: Path, holds: Mapping[str, str], indent: str) -> list[str]:
    """The files of a folder that are there, with what each holds."""
    there = [name for name in holds if (folder / name).exists()]
    width = max((len(name) for name in there), default=0)
    return [f"{indent}{name:<{width}}  {holds[name]}" for name in there]


def effects_of(folder: Path) -> Iterator[str]:
    """Of each effect in ``corrected`` where it is."""
    corrected = folder / CORRECTED
    if (corrected / PARAMETERS).is_file():
        missing = [name for name in (MODEL, NOMINAL) if not (corrected / name).is_file()]
        for line in placed_in_words(read_json(corrected / PARAMETERS), missing):
            yield f"  {line}"
